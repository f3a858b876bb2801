"""Iterative learning control of a heated rod: the module behind the notebooks.

The package contains what the paper is about: the rod, its models, its loop and its rigs, and the
workbench. The toolbox :mod:`ilctools` serves any plant. A name is imported when it is first used.
Code that needs only a part of the package therefore does not wait for all parts. If an argument is
not valid, a ValueError names the argument.
"""

from ilctools import lazily

__version__ = "0.1.0"  # as in pyproject.toml

MODULES = {
    "rod": "Rod exact_response finite_volumes midr",
    "held": "sampled_response",
    "case": "assumed_disturbance assumed_reference paper_choices paper_loop",
    "rigs": "MISMATCHED RestartingRig RigParameters VirtualRig",
    "peltier_rig": "PeltierParameters PeltierRig RestartingPeltierRig",
    "specimens": "Specimen Spread draw responses",
    "boards": "TemperatureControlLab heat_balance",
    "workbench": "open_workbench plot try_out",
}

__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
