"""Evidence for a learning filter that does not come from the solver.

Each question has a module of its own, which begins with it; a problem and a solution are all that
they are handed, and the function for the singular values of a matrix all that they share with the
solvers. :mod:`~rodlib.ilc.evidence.certificate` puts the answers together that every filter has.
"""

from rodlib.ilc.evidence.certificate import Certificate
from rodlib.ilc.evidence.convergence import Rate, mean_rate, rate, rates
from rodlib.ilc.evidence.finite_trial import trial_map, trial_norm, trial_operators
from rodlib.ilc.evidence.noise import (
    LearnedNoise,
    Spectrum,
    TrialNoise,
    converged_noise,
    noise_bound,
    noise_by_trial,
    trial_noise,
)
from rodlib.ilc.evidence.noisy_trial import noise_on_trial
from rodlib.ilc.evidence.robustness import WorstCase, worst_case
from rodlib.ilc.evidence.scenario import support, violation_probability

__all__ = [
    "Certificate",
    "LearnedNoise",
    "Rate",
    "Spectrum",
    "TrialNoise",
    "WorstCase",
    "converged_noise",
    "mean_rate",
    "noise_bound",
    "noise_by_trial",
    "noise_on_trial",
    "rate",
    "rates",
    "support",
    "trial_map",
    "trial_noise",
    "trial_norm",
    "trial_operators",
    "violation_probability",
    "worst_case",
]
