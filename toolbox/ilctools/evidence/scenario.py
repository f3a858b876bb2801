"""What do sampled plants say about a new one? The scenario bound.

If a design depends on k of N independent samples, what holds for them is violated by a new one with
a probability of at most epsilon(k) = 1 - t(k), which is itself false with a probability of at most
beta. For k < N, t(k) is the only solution in (0, 1) of

    beta / (N + 1) sum_{m=k}^{N} binom(m, k) t^(m-k) = binom(N, k) t^(N-k),

and epsilon(N) = 1. M. C. Campi and S. Garatti, Wait-and-judge scenario optimization, Mathematical
Programming 167 (2018) 155-189, Theorem 1, for convex problems with one solution that are not
degenerate: the plants of support alone lead to the same design, with probability one.
"""

import numpy as np
from scipy.optimize import bisect
from scipy.special import betainc, betaln, expit, log_expit

from ilctools import arguments
from ilctools.problem.problem import Solution

NEEDED = 1e-9  # share of all multipliers from which on a plant is one of support
LOG_ODDS = (-700.0, 36.0)  # of a violation, as far as doubles resolve them


def scenario_bound(samples: int, support: int, beta: float = 1e-6) -> float:
    """Bound on the probability that a new plant violates what holds for independent samples."""
    if support == samples:
        return 1.0
    # The sum is the distribution function of the negative binomial distribution, an incomplete beta
    # function, so that N may be a million.
    after, others = support + 1, samples - support
    log_binomial = -betaln(after, others + 1) - np.log(samples + 1)

    def excess(log_odds):  # of the logarithm of the left-hand side, times epsilon^(k+1)
        with np.errstate(divide="ignore"):
            log_sum = np.log(betainc(after, others + 1, expit(log_odds)))
        left = np.log(beta / (samples + 1)) + log_sum
        in_support, not_in_it = log_expit(log_odds), log_expit(-log_odds)
        return left - log_binomial - after * in_support - others * not_in_it

    return float(expit(bisect(excess, *LOG_ODDS, xtol=1e-13)))


def support(solution: Solution) -> np.ndarray:
    """Numbers of the plants, other than the nominal one, that a design depends on.

    They have a multiplier that is not negligible. Without the others the design stays what it is.
    Where bounds meet that could stand in for one another, fewer may do; counting too many makes
    the bound of :func:`violation_probability` larger, and it still holds.

    See Also
    --------
    violation_probability : what follows from their number

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import support, synthesise, zero_phase_butterworth
    >>> gains = 1 + np.random.default_rng(0).uniform(-0.1, 0.1, 20)  # off by up to 10 %
    >>> lags = [control.tf([400 * gain], [1, 20, 400]) for gain in (1, *gains)]
    >>> P = [control.sample_system(lag, 0.01) for lag in lags]
    >>> design = synthesise(P, zero_phase_butterworth(2, 40.0, 0.01), M_max=0.5, order=20)
    >>> len(support(design.solution)) < 20
    True
    """
    cuts = arguments.instance("solution", solution, Solution).cuts
    if cuts is None:
        return np.empty(0, dtype=int)
    size = np.linalg.norm(cuts.N, axis=(1, 2))
    total = np.bincount(cuts.plant, size)
    needed = np.flatnonzero(total > NEEDED * total.sum())
    return needed[needed > 0]


def violation_probability(design, beta: float = 1e-6) -> float:
    """How likely does a new plant break the bounds that a design keeps for its plants?

    Parameters
    ----------
    design : Synthesis
        For several plants, of which all but the first are independent samples of the distribution
        of the new one, which is not checked.
    beta : float
        In (0, 1): the probability, over the samples, that the answer is false.

    Returns
    -------
    float
        Bound on the probability that sigma_max(M) of the new plant exceeds, at a design frequency,
        the largest that the certificate says.

    See Also
    --------
    support : the plants that count

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import synthesise, violation_probability, zero_phase_butterworth
    >>> gains = 1 + np.random.default_rng(0).uniform(-0.1, 0.1, 20)  # off by up to 10 %
    >>> lags = [control.tf([400 * gain], [1, 20, 400]) for gain in (1, *gains)]
    >>> P = [control.sample_system(lag, 0.01) for lag in lags]
    >>> design = synthesise(P, zero_phase_butterworth(2, 40.0, 0.01), M_max=0.5, order=20)
    >>> 0 < violation_probability(design) < 1
    True
    """
    solution = getattr(design, "solution", None)
    arguments.instance("design.solution", solution, Solution)
    beta = arguments.number("beta", beta, "in (0, 1)", 0, 1)
    samples = len(design.problem.plants) - 1
    if not samples:
        raise ValueError(
            "design is for one plant alone: pass synthesise a list, the nominal plant and samples"
        )
    needed = samples if design.problem.base else len(support(solution))  # B is of all of them
    return scenario_bound(samples, needed, beta)
