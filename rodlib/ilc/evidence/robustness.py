"""How slowly may it converge? The worst case of M over all plants considered possible.

For each frequency: the largest sigma_max(Q (I - (P_k + Delta) L)) over the plants P_k and all Delta
within the radius, an upper bound with a proof, and a Delta that shows how sharp it is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningFilter, check_learning
from rodlib.ilc.problem.problem import (
    TIED,
    Problem,
    convergence_matrix,
    largest_singular_values,
    tied,
)
from rodlib.ilc.signals import check_match

FARTHEST = 40.0  # logarithm of how unequal two shares may be: the smaller is then below rounding
NEXT = 1e-12  # distance of neighbouring logarithms


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst case of sigma_max(M) at each frequency. Made by :func:`worst_case`."""

    sigma: np.ndarray  # (n,): an upper bound for all plants k and all Delta
    attained: np.ndarray  # (n,): by the plant and the Delta below; `sigma`, but rounded
    plant: np.ndarray  # (n,): number of the worst plant, 0 for the nominal one
    Delta: np.ndarray | None  # (n, m, m): in units of `scale`; None without a radius
    peaks: np.ndarray  # (1 + others,): largest sigma_max(M) of each plant, Delta = 0
    tied: tuple[tuple[int, int], ...]  # plants and indices of frequencies of the peak


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
    check_match(problem=problem, L=L)
    response = L.frequency_response(problem.omega)
    count = len(problem.plants)
    nominal = np.array(
        [largest_singular_values(problem.M(response, k)) for k in range(count)]
    )
    plant, peaks = tied(nominal).argmax(axis=0), nominal.max(axis=1)
    if problem.radius is None:
        sigma = nominal.max(axis=0)
        return WorstCase(sigma, sigma, plant, None, peaks, _tied_pairs(nominal))

    every = np.arange(len(problem.omega))
    G = _stacked(problem, plant, every, response)
    t = _balance(G)[0]
    first = _bound(G, t)
    # Any t gives an upper bound. Where that of a plant is below the first guess, so is the plant.
    bounds = np.empty(nominal.shape)
    for k in range(count):
        bounds[k] = _bound(
            _stacked(problem, np.full_like(every, k), every, response), t
        )
    possible, at = np.nonzero(bounds >= first * (1 - TIED))
    G = _stacked(problem, possible, at, response)
    worst = np.zeros(nominal.shape)
    worst[possible, at] = _bound(G, _balance(G)[0])
    plant = worst.argmax(axis=0)
    Delta = _worst_Delta(problem, plant, response)
    P = problem.plants[plant, every]
    M = convergence_matrix(P + Delta, problem.Q, response)
    attained = largest_singular_values(M)
    return WorstCase(
        worst.max(axis=0), attained, plant, Delta, peaks, _tied_pairs(worst)
    )


def _tied_pairs(sigma):
    """Plant and index of frequency of all that are tied as the worst, by frequency."""
    frequency, plant = np.nonzero(tied(sigma.ravel()).reshape(sigma.shape).T)
    return tuple(zip(plant.tolist(), frequency.tolist(), strict=True))


def affine(problem: Problem, plant, at) -> tuple[np.ndarray, np.ndarray]:
    """F and T of G = F + T L in :class:`rodlib.ilc.problem.Cuts`, for plants and frequencies."""
    m = problem.channels
    P, Q = problem.plants[plant, at], problem.Q[at, None, None]
    T = -Q * P
    if problem.radius is not None:
        rho = np.abs(Q) * problem.radius[at, None, None]
        T = np.concatenate([T, rho * np.eye(m)], axis=1)
    F = Q * np.eye(T.shape[1], m)
    return F, T


def _stacked(problem, plant, at, response):
    """[M; rho L] of plants at frequencies, shape (c, 2 m, m), from L at all frequencies."""
    F, T = affine(problem, plant, at)
    return F + T @ response[at]


def _weighted(G, t):
    """[M / sqrt(alpha); rho L / sqrt(1 - alpha)] for alpha = 1 / (1 + exp(t))."""
    alpha = 1 / (1 + np.exp(t))
    rest = 1 / (1 + np.exp(-t))
    M, rho_L = np.split(G, 2, axis=1)
    M = M / np.sqrt(alpha)[:, None, None]
    rho_L = rho_L / np.sqrt(rest)[:, None, None]
    return np.concatenate([M, rho_L], axis=1)


def _bound(G, t):
    """Its largest singular value."""
    return largest_singular_values(_weighted(G, t))


def _balance(G):
    """The best t = log((1 - alpha) / alpha), and neighbours below and above it."""

    def imbalance(t, i):
        Mx, rho_Lx = _images(G[i], _most_amplified(G[i], t))
        with np.errstate(divide="ignore", invalid="ignore"):
            best = np.log(_norm(rho_Lx)) - np.log(_norm(Mx))
        return t - np.clip(np.nan_to_num(best), -FARTHEST, FARTHEST)

    ends = np.full(len(G), FARTHEST + 1)
    cases = (np.arange(len(G)),)
    with np.errstate(invalid="ignore"):  # a bracket at rounding level is halved
        root = elementwise.find_root(imbalance, (-ends, ends), args=cases)
    return root.x, *np.clip(root.bracket, root.x - NEXT, root.x + NEXT)


def _most_amplified(G, t):
    """The unit x that the weighted G amplifies most."""
    return np.linalg.svd(_weighted(G, t))[2][:, 0].conj()


def _images(G, x):
    """M x and rho L x, shape (c, m) each."""
    return np.split((G @ x[..., None])[..., 0], 2, axis=1)


def _balanced_vector(G):
    """The unit x with the largest |M x| + |rho L x|."""
    # At the best alpha exp(t) |M x|^2 = exp(-t) |rho L x|^2. Where two directions are amplified
    # equally, x with too large an M x and y with too large a rho L y, a combination
    # cos(a) x + sin(a) y meets this: the difference of both sides is a sinusoid in 2 a.
    t, low, high = _balance(G)
    x, y = _most_amplified(G, high), _most_amplified(G, low)
    y = y * _phase((y.conj() * x).sum(axis=1))[:, None]

    def difference(x, y):
        Mx, Lx = _images(G, x)
        My, Ly = _images(G, y)
        return np.exp(t) * _inner(Mx, My) - np.exp(-t) * _inner(Lx, Ly)

    first, last = difference(x, x), difference(y, y)
    cosine, sine = (first - last) / 2, difference(x, y)
    size, mean = np.hypot(cosine, sine), (first + last) / 2
    ratio = np.divide(-mean, size, out=np.zeros_like(t), where=size > 0)
    angle = np.arctan2(sine, cosine) + np.arccos(np.clip(ratio, -1, 1))
    a = np.clip(angle, 0, np.pi)[:, None] / 2
    return _unit(np.cos(a) * x + np.sin(a) * y)


def _worst_Delta(problem, plant, response):
    """A Delta within the radius at each frequency that leads to the worst case of M."""
    G = _stacked(problem, plant, np.arange(len(plant)), response)
    x = _balanced_vector(G)
    u = _unit(_images(G, x)[0])
    v = _unit((response @ x[..., None])[..., 0])
    # so that -Q Delta L x points as M x does
    size = -np.sign(problem.Q) * problem.radius
    return size[:, None, None] * u[:, :, None] * v[:, None, :].conj()


def _inner(x, y):
    """Re x^H y of each row."""
    return (x.conj() * y).real.sum(axis=1)


def _norm(x):
    return np.linalg.norm(x, axis=1)


def _phase(z):
    """z / |z|; one where that is 0 / 0."""
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1), 1)


def _unit(x):
    """x / |x| for each row; the first axis where that is 0 / 0."""
    size = _norm(x)[:, None]
    return np.where(size > 0, x / np.where(size > 0, size, 1), np.eye(1, x.shape[1]))
