"""Evidence for a learning filter that does not come from the solver.

Each question is answered by a module of its own; a problem and a solution are all that they are
handed, and the function for the singular values of a matrix all that they share with the solvers.
:mod:`~rodlib.ilc.evidence.certificate` puts the answers to the first four together.

- *Is it optimal?* :mod:`~rodlib.ilc.evidence.optimality` turns the solver's multipliers, whatever
  their quality, into a bound on the objective that no filter of the same kind can beat.
- *Are the bounds met between the samples?* The constraints of (39) hold on a grid;
  :mod:`~rodlib.ilc.evidence.peak` gives the peak over all frequencies, with a proof for a model.
- *Does the finite trial converge?* Lemma 1 is about signals without end; :func:`trial_norm` is
  the norm of what one trial of the ILC law really does, its two ends included.
- *And for another plant?* :func:`worst_case` finds the worst of all plants for which the bounds are
  to hold, and of all within a radius, with the one that shows it.
- *And for one that was not tried?* If the plants are independent samples,
  :func:`violation_probability` bounds the probability that a new one breaks the bounds.
- *How fast do the trials converge?* :func:`rate` is the gamma of Lemma 1 on a grid.
- *And what does noise do?* :func:`converged_noise` is what is left of the error if noise or a
  disturbance is new in every trial; :func:`noise_bound` holds for every filter within the bounds.
"""

from rodlib.ilc.evidence.certificate import Certificate
from rodlib.ilc.evidence.convergence import Rate, rate, rates
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
    "noise_bound",
    "noise_by_trial",
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
