"""Evidence for a learning filter that does not come from the solver.

Each question has a module of its own, which begins with it; a problem and a solution are all that
they are handed, and the function for the singular values of a matrix all that they share with the
solvers. :mod:`~rodlib.ilc.evidence.certificate` puts the answers together that every filter has.
"""

from rodlib.ilc import lazily

MODULES = {
    "certificate": "Certificate",
    "check": "Check",
    "convergence": "Rate SpectralRate mean_rate rate rate_within rates spectral_rate",
    "finite_trial": "trial_map trial_norm trial_operators",
    "noise": "LearnedNoise Spectrum TrialNoise converged_noise noise_by_trial trial_noise",
    "noisy_trial": "noise_on_trial",
    "robustness": "WorstCase worst_case",
    "scenario": "support violation_probability",
}
__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
