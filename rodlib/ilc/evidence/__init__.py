"""Evidence for a learning filter that does not come from the solver.

Six questions, each answered by code of its own; a problem and a solution are all that it is
handed, and the function for the singular values of a matrix all that it shares with the solvers:

- *Is it optimal?* :func:`lower_bound` turns the solver's multipliers, whatever their quality, into
  a bound on the objective that no filter of the same structure and order can beat.
- *Are the bounds met between the samples?* The constraints of (39) hold on a grid;
  :func:`peak_gain` gives the peak over all frequencies, with a proof, if the plant is a model.
- *Does the finite trial converge?* Lemma 1 is about signals without end; :func:`trial_norm` is
  the norm of what one trial of the ILC law really does, its two ends included.
- *And for another plant?* :func:`worst_case` finds the worst of all plants for which the bounds are
  to hold, and of all within a radius, with the one that shows it.
- *And for one that was not tried?* If the plants are independent samples,
  :func:`violation_probability` bounds the probability that a new one breaks the bounds.
- *How fast do the trials converge?* :func:`rate` is the gamma of Lemma 1 on a grid, for any plant
  and any learning operator.
- *And what does noise do?* :func:`converged_noise` is what is left of the error if noise or a
  disturbance is new in every trial, of :func:`trial_noise` and of what learning makes of it;
  :func:`noise_bound` holds for every filter within the bounds.

:func:`certify` puts the answers to the first four together.
"""

from rodlib.ilc.evidence.certificate import GAP, VIOLATION, Certificate, certify
from rodlib.ilc.evidence.convergence import Rate, rate, rates
from rodlib.ilc.evidence.finite_trial import (
    impulse_response,
    trial_map,
    trial_norm,
    trial_operators,
)
from rodlib.ilc.evidence.models import error_model, learning_model
from rodlib.ilc.evidence.noise import (
    LearnedNoise,
    Spectrum,
    TrialNoise,
    converged_noise,
    noise_bound,
    noise_by_trial,
    trial_noise,
)
from rodlib.ilc.evidence.optimality import lower_bound
from rodlib.ilc.evidence.peak import peak_gain
from rodlib.ilc.evidence.robustness import WorstCase, worst_case
from rodlib.ilc.evidence.scenario import scenario_bound, support, violation_probability

__all__ = [
    "GAP",
    "VIOLATION",
    "Certificate",
    "LearnedNoise",
    "Rate",
    "Spectrum",
    "TrialNoise",
    "WorstCase",
    "certify",
    "converged_noise",
    "error_model",
    "impulse_response",
    "learning_model",
    "lower_bound",
    "noise_bound",
    "noise_by_trial",
    "peak_gain",
    "rate",
    "rates",
    "scenario_bound",
    "support",
    "trial_map",
    "trial_noise",
    "trial_norm",
    "trial_operators",
    "violation_probability",
    "worst_case",
]
