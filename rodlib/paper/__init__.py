"""What the compendium itself needs: printed numbers, ledger, figures, make reproduce, pages.

What a notebook needs of it comes from here; a name is imported when it is first used.
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
