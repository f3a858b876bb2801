"""How slowly may it converge? The worst case of M over all plants that were not ruled out.

For each frequency: the largest sigma_max(Q (I - (P_k + Delta) L)) over the plants P_k and all Delta
within the radius, an upper bound that holds, and a Delta that shows how sharp it is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningFilter, check_learning
from rodlib.ilc.problem.problem import Problem, largest_singular_values, tied

FARTHEST = 40.0  # logarithm of how unequal two shares may be: the smaller is then below rounding
NEXT = 1e-12  # distance of neighbouring logarithms


@dataclass(frozen=True)
class WorstCase:
    """The worst case of sigma_max(M) at each frequency. Made by :func:`worst_case`."""

    sigma: np.ndarray  # (n,): an upper bound for all plants k and all Delta
    attained: (
        np.ndarray
    )  # (n,): what it is for the plant and the Delta below; `sigma`, but rounded
    plant: (
        np.ndarray
    )  # (n,): number of the worst plant, 0 for the nominal one; of tied ones, first
    Delta: (
        np.ndarray | None
    )  # (n, m, m): within the radius, in units of `scale`; None without one
    peaks: (
        np.ndarray
    )  # (1 + others,): largest sigma_max(M) of each plant by itself, Delta = 0
    tied: tuple[
        tuple[int, int], ...
    ]  # plants and indices of frequencies of the worst of all


def worst_case(problem: Problem, L: LearningFilter) -> WorstCase:
    """Find the worst of all plants of a problem for a learning filter.

    Parameters
    ----------
    problem : Problem
    L : LearningFilter
        In units of `scale`.

    Notes
    -----
    For a radius r, and rho = |Q| r, the worst case is exactly

        max over unit x of |M x| + rho |L x|
            = min over alpha in (0, 1) of sigma_max([M / sqrt(alpha); rho L / sqrt(1 - alpha)]).

    For each alpha the right-hand side is an upper bound, by Cauchy and Schwarz; it is convex in
    alpha, and at the least of them an x exists that attains it, because the pairs (|M x|^2,
    |L x|^2) fill a convex set (Toeplitz and Hausdorff). Delta of rank one turns rho L x against
    M x.
    """
    arguments.instance("problem", problem, Problem)
    check_learning(L, problem.channels)
    arguments.one_period(problem=problem.Ts, L=L.Ts)
    response = L.frequency_response(problem.omega)
    each = (problem.M(response, k) for k in range(len(problem.plants)))
    nominal = np.array([largest_singular_values(M) for M in each])
    plant, peaks = tied(nominal).argmax(axis=0), nominal.max(axis=1)
    at = np.arange(len(problem.omega))
    if problem.radius is None:
        sigma = nominal.max(axis=0)
        return WorstCase(sigma, sigma, plant, None, peaks, _pairs(nominal, at))
    t = _balance(stacked(problem, plant, at, response))[0]
    sigma = _bound(stacked(problem, plant, at, response), t)
    # Any t gives an upper bound: those plants that it leaves in doubt are looked at themselves.
    each = (
        stacked(problem, np.full(len(at), k), at, response) for k in range(len(nominal))
    )
    limits = np.array([_bound(G, t) for G in each])
    while np.any(limits > sigma):
        [at] = np.nonzero(limits.max(axis=0) > sigma)
        number = limits[:, at].argmax(axis=0)
        limits[number, at] = 0
        G = stacked(problem, number, at, response)
        value = _bound(G, _balance(G)[0])
        worse = value > sigma[at]
        plant[at[worse]], sigma[at[worse]] = number[worse], value[worse]
    Delta, attained = _worst_Delta(problem, plant, response)
    [at] = np.nonzero(tied(sigma))
    each = [
        stacked(problem, np.full(len(at), k), at, response) for k in range(len(nominal))
    ]
    of_all = np.array([_bound(G, _balance(G)[0]) for G in each])
    return WorstCase(sigma, attained, plant, Delta, peaks, _pairs(of_all, at))


def _pairs(values, at):
    """Plant and frequency of all that are tied as the worst, of values of plants at frequencies."""
    frequency, plant = np.nonzero(tied(values.ravel()).reshape(values.shape).T)
    return tuple(zip(plant.tolist(), at[frequency].tolist(), strict=True))


def affine(problem: Problem, plant, at) -> tuple[np.ndarray, np.ndarray]:
    """F and T of G = F + T L in :class:`rodlib.ilc.problem.Cuts`, for plants and frequencies."""
    m = problem.channels
    P, Q = problem.plants[plant, at], problem.Q[at, None, None]
    T = -Q * P
    if problem.radius is not None:
        below = np.abs(Q) * problem.radius[at].reshape(-1, 1, 1) * np.eye(m)
        T = np.concatenate([T, below], axis=1)
    return Q * np.eye(T.shape[1], m), T


def stacked(problem, plant, at, response):
    """G, shape (c, rows, m), from the frequency response of L at all frequencies."""
    F, T = affine(problem, plant, at)
    return F + T @ response[at]


def _weighted(G, t):
    """[M / sqrt(alpha); rho L / sqrt(1 - alpha)] for alpha = 1 / (1 + exp(t))."""
    shares = np.stack([1 / (1 + np.exp(t)), 1 / (1 + np.exp(-t))], axis=1)
    return G / np.sqrt(np.repeat(shares, G.shape[2], axis=1))[..., None]


def _bound(G, t):
    """Its largest singular value."""
    return largest_singular_values(_weighted(G, t))


def _balance(G):
    """The best t = log((1 - alpha) / alpha), and neighbours below and above it."""

    def imbalance(t, i):
        first, second = np.linalg.norm(
            _images(G[i], _most_amplified(G[i], t)), axis=2
        ).T
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = np.log(second) - np.log(first)
        return t - np.clip(np.nan_to_num(wanted), -FARTHEST, FARTHEST)

    ends = np.full(len(G), FARTHEST + 1)
    with np.errstate(
        invalid="ignore"
    ):  # a bracket at rounding level, which is then halved
        root = elementwise.find_root(
            imbalance, (-ends, ends), args=(np.arange(len(G)),)
        )
    return root.x, *np.clip(root.bracket, root.x - NEXT, root.x + NEXT)


def _most_amplified(G, t):
    """The unit x that the weighted G amplifies most."""
    return np.linalg.svd(_weighted(G, t))[2][:, 0].conj()


def _images(G, x):
    """M x and rho L x, shape (c, 2, m)."""
    return (G @ x[..., None]).reshape(len(G), 2, -1)


def _balanced_vector(G):
    """The unit x with the largest |M x| + |rho L x|."""
    # Where two are amplified equally at the best alpha, one with too large an M x and one with too
    # large an L x, it is the sum of both for which alpha is the best, too.
    t, low, high = _balance(G)
    x, y = _most_amplified(G, low), _most_amplified(G, high)
    y = y * _phase((y.conj() * x).sum(axis=1))[:, None]
    sign = np.stack([np.exp(t), -np.exp(-t)], axis=1)
    X, Y = _images(G, x), _images(G, y)
    a, b, c = ((sign * (u.conj() * v).real.sum(axis=2)).sum(axis=1) for u, v in
               ((X, X), (X, Y), (Y, Y)))  # fmt: skip
    root = np.sqrt(np.maximum(b**2 - a * c, 0))
    p, q = np.where(b > 0, [b + root, -a], [c, root - b])  # a p^2 + 2 b p q + c q^2 = 0
    p, q = np.where(np.maximum(p, q) > 0, [p, q], [[1.0], [0.0]])
    return _unit(np.maximum(p, 0)[:, None] * x + np.maximum(q, 0)[:, None] * y)


def _worst_Delta(problem, plant, response):
    """A Delta within the radius at each frequency, and the sigma_max(M) that it leads to."""
    G = stacked(problem, plant, np.arange(len(plant)), response)
    M, Q = G[:, : problem.channels], problem.Q[:, None, None]
    against = -_phase(Q).conj()  # so that -Q Delta L x points as M x does
    x = _balanced_vector(G)[..., None]
    u, v = (_unit((X @ x)[..., 0])[..., None] for X in (M, response))
    Delta = problem.radius.reshape(-1, 1, 1) * against * u * v.conj().swapaxes(1, 2)
    return Delta, largest_singular_values(M - Q * Delta @ response)


def _phase(z):
    """z / |z|; one where that is 0 / 0."""
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1), 1)


def _unit(x):
    """x / |x| for each row; the first axis where that is 0 / 0."""
    size = np.linalg.norm(x, axis=1, keepdims=True)
    return np.where(size > 0, x / np.where(size > 0, size, 1), np.eye(1, x.shape[1]))
