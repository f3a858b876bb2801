"""Iterative learning control: learning filters with certificates, for any plant.

Each public name is imported when it is first used. A program that uses only a part of the package
therefore does not wait for the import of the other parts.
"""

from collections.abc import Sequence
from importlib import import_module

MODULES = {
    "models": "frequency_response minimal_realisation state_sequence",
    "filters": "LearningFilter zero_phase_butterworth",
    "loop.closed": "ClosedLoop",
    "loop.design": "current_trial_loop",
    "law.notes": "law_of load_law save_law",
    "law.law": "Law",
    "synthesis.design": "synthesise",
    "errors": "InfeasibleError",
    "synthesis.search": "least_gain",
    "evidence.convergence": "convergence",
    "evidence.finite": "trial_map trial_norm trial_operators",
    "evidence.robustness": "worst_case",
    "norm_optimal": "NormOptimal",
    "trials.rms": "rms",
    "trials.run": "run_trials",
    "trials.transfer": "transfer",
    "rigs.controller": "Controller",
    "rigs.experiments": "record shake",
    "rigs.protocol": "Rig",
    "logs.format": "save_log",
    "logs.reader": "load_log",
    "logs.replay": "replay",
    "logs.table": "read_table",
    "measurement.excitation": "multisine",
    "measurement.measurement": "measured_response",
}


def lazily(package: str, modules: dict[str, str], rooms: Sequence[str] = ()):
    """Make ``__getattr__``, ``__dir__`` and ``__all__`` of a package with lazy imports.

    A name is imported when it is first used. `modules` maps each module to the public names that
    the module defines. `rooms` lists modules that are public themselves, such as ``errors``. The
    names in such a module stay there, as in ``errors.LogError``.
    """
    home = {
        name: f"{package}.{module}" for module, names in modules.items() for name in names.split()
    }

    def get(name):
        if name in rooms:
            return import_module(f"{package}.{name}")
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    names = [*home, *rooms]
    return get, lambda: names, names


ROOMS = ("errors",)
__version__ = "0.1.0"  # as in pyproject.toml

__getattr__, __dir__, __all__ = lazily(__name__, MODULES, ROOMS)
