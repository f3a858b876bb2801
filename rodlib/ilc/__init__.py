"""Iterative learning control of any plant: the toolbox, which knows nothing of the rod.

A name is imported when it is first used, so that what needs only a part does not wait for all.
"""

from importlib import import_module

MODULES = {
    "models": "minimal_realisation",
    "loop": "ClosedLoop CurrentTrialLoop",
    "gains": "current_trial_loop",
    "filters": """LearningFilter LearningOperator ZeroPhaseButterworth update
        zero_phase_butterworth""",
    "problem": "Problem",
    "within_limits": "update_within",
    "trials": "rms run_trials",
    "transfer": "transfer",
    "estimates": "combinations estimated",
    "evidence": """converged_noise mean_rate noise_by_trial noise_on_trial rate rate_within
        rates spectral_rate trial_noise violation_probability worst_case""",
    "synthesis": "InfeasibleError SolverError Synthesis largest_cutoff least_gain synthesise",
    "alternatives": """NormOptimal Rehearsal gradient h_infinity p_type pd_type stable_inversion
        tune zero_phase_inversion""",
    "laboratory": """LogError MeasuredResponse Rig RigError expected_radius load_law load_log
        loop_of measured_response multisine read_table record save_law save_log shake""",
    "plots": "plot",
}


def lazily(package: str, modules: dict[str, str]):
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package: the names of its modules."""
    home = {
        name: f"{package}.{module}" for module, names in modules.items() for name in names.split()
    }

    def get(name):
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    return get, lambda: sorted([*vars(import_module(package)), *home]), [*home]


__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
