"""Iterative learning control of any plant: the toolbox, which knows nothing of the rod.

A name is imported when it is first used, so that what needs only a part does not wait for all.
"""

from importlib import import_module

MODULES = {
    "models": "minimal_realisation",
    "filters": """LearningFilter LearningOperator ZeroPhaseButterworth
        zero_phase_butterworth""",
    "loop.closed": "ClosedLoop CurrentTrialLoop",
    "loop.design": "current_trial_loop",
    "loop.observer": "combinations estimated",
    "law.io": "law_of load_law save_law with_law",
    "law.law": "Law",
    "problem.problem": "Problem",
    "synthesis.design": "synthesise",
    "synthesis.result": "InfeasibleError SolverError Synthesis",
    "synthesis.search": "largest_cutoff least_gain",
    "evidence.certificate": "Certificate",
    "evidence.convergence": "Convergence convergence rate",
    "evidence.finite": "trial_map trial_norm trial_operators",
    "evidence.noise": "Spectrum TrialNoise converged_noise noise_on_trial trial_noise",
    "evidence.robustness": "WorstCase worst_case",
    "evidence.scenario": "support violation_probability",
    "alternatives.inversion": "gradient stable_inversion zero_phase_inversion",
    "alternatives.norm_optimal": "NormOptimal",
    "alternatives.preview": "full_information generalised_plant h_infinity",
    "alternatives.proportional": "p_type pd_type",
    "alternatives.rehearsal": "Rehearsal Tuned lines tune",
    "alternatives.two_sided": "TwoSidedFilter extent two_sided_taps",
    "trials.run": "rms run_trials",
    "trials.transfer": "transfer",
    "rigs.controlled": "Controller",
    "rigs.experiments": "record shake",
    "rigs.protocol": "Rig RigError StoppedError TrialRig",
    "logs.table": "read_table",
    "logs.format": "LogError save_log",
    "logs.reader": "load_log",
    "logs.replay": "replay",
    "logs.notes": "loop_of",
    "measurement.excitation": "Excitation multisine",
    "measurement.estimation": "EstimatedResponse",
    "measurement.measurement": "MeasuredResponse expected_radius measured_response",
    "measurement.tabulated": "TabulatedResponse",
    "workbench": "open_workbench",
    "workbench.outcome": "try_out",
    "workbench.picture": "plot",
    "workbench.plant": "Plant",
    "workbench.settings": "Settings",
}


def lazily(package: str, modules: dict[str, str]):
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package: the names of its modules."""
    home = {
        name: f"{package}.{module}"
        for module, names in modules.items()
        for name in names.split()
    }

    def get(name):
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    return get, lambda: sorted([*vars(import_module(package)), *home]), [*home]


__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
