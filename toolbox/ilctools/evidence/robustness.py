"""How slowly may it converge? The worst case of M over all plants considered possible.

For each frequency: the largest sigma_max(Q (I - (P_k + Delta) L)) over the plants P_k and all Delta
within the radius, an upper bound with a proof, which one Delta reaches.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise

from ilctools import arguments
from ilctools.filters import LearningFilter, check_learning
from ilctools.problem.problem import TIED, Problem, largest_singular_values, tied
from ilctools.signals import check_match

FARTHEST = 40.0  # logarithm of how unequal two shares may be: the smaller is then below rounding


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst case of sigma_max(M) at each frequency. Made by :func:`worst_case`."""

    sigma: np.ndarray  # (n,): an upper bound for all plants and all Delta
    peaks: np.ndarray  # (1 + others,): largest sigma_max(M) of each plant, Delta = 0
    tied: tuple[tuple[int, int], ...]  # plants and indices of frequencies of the peak


def worst_case(problem: Problem, L: LearningFilter) -> WorstCase:
    """Find the worst of all plants of a problem for a learning filter.

    Parameters
    ----------
    problem : Problem
    L : LearningFilter
        In units of `scale`.

    See Also
    --------
    synthesise : bounds for all of them
    Synthesis.check : for one plant

    Notes
    -----
    For a radius r, and rho = |Q| r, the worst case is exactly

        max over unit x of |M x| + rho |L x|
            = min over alpha in (0, 1) of sigma_max([M / sqrt(alpha); rho L / sqrt(1 - alpha)]).

    A Delta of rank one, which turns rho L x against M x, reaches what stands on the left for an x.
    For each alpha the right-hand side is an upper bound, by Cauchy and Schwarz; it is convex in
    alpha, and at the least of them an x exists that attains it, because the pairs
    (|M x|^2, |L x|^2) fill a convex set (Toeplitz and Hausdorff).

    Examples
    --------
    >>> import control
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> import numpy as np
    >>> from ilctools import synthesise, worst_case, zero_phase_butterworth
    >>> omega = np.geomspace(0.1, 100 * np.pi, 60)
    >>> Q = zero_phase_butterworth(2, 40.0, 0.01)
    >>> design = synthesise(P, Q, omega, uncertainty=np.full(60, 0.05))
    >>> worst = worst_case(design.problem, design.filter)
    >>> bool(worst.sigma.max() <= 0.9 * (1 + 1e-6))
    True
    """
    arguments.instance("problem", problem, Problem)
    check_learning(L, problem.channels)
    check_match(problem=problem, L=L)
    response = L.frequency_response(problem.omega)
    plants, every = range(len(problem.plants)), np.arange(len(problem.omega))
    M = [problem.M(response, k) for k in plants]
    nominal = np.array([largest_singular_values(M_k) for M_k in M])
    peaks = nominal.max(axis=1)
    if problem.radius is None:
        sigma = nominal.max(axis=0)
        return WorstCase(sigma, peaks, _tied_pairs(nominal))

    stacked = []
    for k in plants:
        F, T = affine(problem, k, every)
        stacked.append(F + T @ response)  # [M; rho L]
    G = np.array(stacked)
    # The best t of one plant gives upper bounds for the others. Where such a bound is below that
    # of the one, so is the plant.
    first = G[tied(nominal).argmax(axis=0), every]
    t = _best(first)
    bounds = np.array([_bound(G_k, t) for G_k in G])
    possible = bounds >= _bound(first, t) * (1 - TIED)
    sigma = np.zeros(nominal.shape)
    sigma[possible] = _bound(G[possible], _best(G[possible]))
    return WorstCase(sigma.max(axis=0), peaks, _tied_pairs(sigma))


def _tied_pairs(sigma):
    """Plant and index of frequency of all that are tied as the worst, by frequency."""
    ties = tied(sigma.ravel()).reshape(sigma.shape)
    pairs = np.argwhere(ties.T).tolist()
    return tuple((plant, frequency) for frequency, plant in pairs)


def affine(problem: Problem, plant, at) -> tuple[np.ndarray, np.ndarray]:
    """F and T of G = F + T L in :class:`.Cuts`, for plants and frequencies."""
    m = problem.channels
    P, Q = problem.plants[plant, at], problem.Q[at, None, None]
    T = -Q * P
    if problem.radius is not None:
        rho = np.abs(Q) * problem.radius[at, None, None]
        T = np.concatenate([T, rho * np.eye(m)], axis=1)
    F = Q * np.eye(T.shape[1], m)
    return F, T


def _weighted(G, t):
    """[M / sqrt(alpha); rho L / sqrt(1 - alpha)] for alpha = 1 / (1 + exp(t))."""
    alpha = 1 / (1 + np.exp([t, -t]))  # of both parts
    root = np.repeat(np.sqrt(alpha), G.shape[2], axis=0).T
    return G / root[:, :, None]


def _bound(G, t):
    """Its largest singular value."""
    return largest_singular_values(_weighted(G, t))


def _best(G):
    """The t = log((1 - alpha) / alpha) of the least bound."""

    def imbalance(t, i):
        x = np.linalg.svd(_weighted(G[i], t))[2][:, 0].conj()  # the most amplified
        images = (G[i] @ x[..., None]).reshape(len(x), 2, -1)
        Mx, rho_Lx = np.linalg.norm(images, axis=2).T
        balanced = np.nan_to_num(np.log(rho_Lx) - np.log(Mx))
        return t - np.clip(balanced, -FARTHEST, FARTHEST)

    ends = np.full(len(G), FARTHEST + 1)
    numbers = np.arange(len(G))
    # log(0), and a bracket at rounding level, which is halved
    with np.errstate(divide="ignore", invalid="ignore"):
        return elementwise.find_root(imbalance, (-ends, ends), args=(numbers,)).x
