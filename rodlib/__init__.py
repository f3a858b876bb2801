"""Iterative learning control of a heated rod: the module behind the notebooks.

A name is imported when it is first used, so that what needs only a part does not wait for all.
"""

from importlib import import_module

MODULES = {
    "rod": ("Rod", "exact_response", "midr"),
    "approximations": (
        "balanced_truncation",
        "finite_differences",
        "finite_elements",
        "finite_volumes",
        "modal_series",
    ),
    "held": ("sampled_response",),
    "realisation": ("minimal_realisation",),
    "loop": ("CurrentTrialLoop",),
    "feedback": ("current_trial_loop", "paper_loop"),
    "filters": (
        "LearningFilter",
        "LearningOperator",
        "ZeroPhaseButterworth",
        "update",
        "zero_phase_butterworth",
    ),
    "problem": ("Problem",),
    "evidence": (
        "converged_noise",
        "noise_bound",
        "noise_by_trial",
        "trial_noise",
        "violation_probability",
        "worst_case",
    ),
    "synthesis": (
        "InfeasibleError",
        "SolverError",
        "Synthesis",
        "largest_cutoff",
        "least_gain",
        "synthesise",
    ),
    "trials": ("run_trials",),
    "alternatives": (
        "NormOptimal",
        "Rehearsal",
        "gradient",
        "h_infinity",
        "p_type",
        "pd_type",
        "stable_inversion",
        "tune",
        "zero_phase_inversion",
    ),
    "study": ("Specimen", "Spread", "Study", "draw", "responses", "unstable_poles"),
    "laboratory": (
        "LogError",
        "expected_radius",
        "load_law",
        "load_log",
        "loop_of",
        "measured_response",
        "multisine",
        "record",
        "save_law",
        "save_log",
        "shake",
    ),
}
HOME = {name: module for module, names in MODULES.items() for name in names}

__all__ = [*HOME]


def __getattr__(name):
    if name not in HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{HOME[name]}"), name)


def __dir__():
    return sorted([*globals(), *HOME])
