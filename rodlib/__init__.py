"""Iterative learning control of a heated rod: the module behind the notebooks.

On this floor is what the paper is about: the rod, its models, its loop and its rigs. One floor
below, in :mod:`rodlib.ilc`, is the toolbox for any plant, whose names are at home here, too. A name
is imported when it is first used, so that what needs only a part does not wait for all. What is
passed and does not belong there is a ValueError that names the argument.
"""

from rodlib import ilc

__version__ = "0.1.0"  # as in pyproject.toml

MODULES = {
    "rod": "Rod exact_response midr",
    "held": "sampled_response",
    "case": "assumed_disturbance assumed_reference paper_choices paper_loop",
    "rigs": "MISMATCHED RestartingRig RigParameters VirtualRig",
    "peltier_rig": "PeltierParameters PeltierRig RestartingPeltierRig",
    "specimens": "Specimen Spread draw responses",
    "study": "Study",
    "boards": "TemperatureControlLab fit_heat_balance heat_balance",
}
MODULES |= {f"ilc.{module}": names for module, names in ilc.MODULES.items()}

__getattr__, __dir__, __all__ = ilc.lazily(__name__, MODULES, ["approximations"])
