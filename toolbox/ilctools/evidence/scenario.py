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
from scipy.optimize import brentq
from scipy.special import betaln, logsumexp

from ilctools import arguments
from ilctools.problem.problem import Solution

NEEDED = 1e-9  # share of all multipliers from which on a plant is one of support


def scenario_bound(samples: int, support: int, beta: float = 1e-6) -> float:
    """epsilon(k), by the equation divided by its right-hand side."""
    N, k = samples, support
    if k == N:
        return 1.0
    m = np.arange(k, N + 1)
    log_binomials = -betaln(k + 1, m - k + 1) - np.log(m + 1)

    def excess(log_t):  # falls; positive at beta / (N + 1)^2, where the term of N - 1 is too large
        terms = log_binomials + (m - k) * log_t
        return logsumexp(terms - terms[-1]) - np.log((N + 1) / beta)

    return float(-np.expm1(brentq(excess, np.log(beta) - 2 * np.log(N + 1), 0.0)))


def support(solution: Solution) -> np.ndarray:
    """Numbers of the plants, other than the nominal one, with a multiplier that counts.

    Without the others the design stays what it is. Where bounds meet that could stand in for one
    another, fewer may do; counting too many makes epsilon larger, and it still holds.
    """
    cuts = solution.cuts
    if cuts is None:
        return np.empty(0, dtype=int)
    total = np.bincount(cuts.plant, np.linalg.norm(cuts.N, axis=(1, 2)))
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
    synthesise : designs for several plants

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
    solution = arguments.instance("design.solution", getattr(design, "solution", None), Solution)
    beta = arguments.number("beta", beta, "in (0, 1)", 0, 1)
    samples = len(design.problem.plants) - 1
    if not samples:
        raise ValueError(
            "design is for one plant alone: pass synthesise a list, the nominal plant and samples"
        )
    needed = samples if design.problem.base else len(support(solution))  # B is of all of them
    return scenario_bound(samples, needed, beta)
