"""Tools of the compendium itself: printed numbers, ledger, figures, make reproduce, pages.

Notebooks import their tools from here. A name is imported when it is first used.
"""

from ilctools import lazily

MODULES = {
    "figures": """ACCENT BLACK BLACK_DASHED GRAY GRAY_DASHED LOOKS MARK SHADES TALL WIDE
        save""",
    "ledger": "Ledger",
    "parameters": "checked",
    "repository": "ROOT",
    "rig_logs": "PARAMETERS experiment",
}

__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
__all__ += ["published"]
