"""How slowly may it converge? The worst case of M over all plants that were not ruled out.

For each frequency: the largest sigma_max(Q (I - (P_k + Delta) L)) over the plants P_k and all Delta
within the radius, an upper bound that holds, and a Delta that shows how sharp it is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningFilter, check_learning
from rodlib.ilc.problem import Problem, largest_singular_values, tied

FARTHEST = 40.0  # logarithm of how unequal two shares may be: the smaller is then below rounding
NEXT = 1e-12  # distance of neighbouring logarithms
ACCURACY = 1e-13  # relative, to which the shares entry by entry are optimal
STEPS = 200  # of Newton's method; 60 is usual
FASTER = 10.0  # factor from one weight of the objective against the barrier to the next
ROUNDS = 30  # of the search for a Delta from one start
TIGHT = 1e-9  # relative distance of the two bounds at which it ends
PHASES = np.exp(0.5j * np.pi * np.arange(4))


@dataclass(frozen=True)
class WorstCase:
    """The worst case of sigma_max(M) at each frequency. Made by :func:`worst_case`.

    Attributes
    ----------
    sigma : ndarray, shape (n,)
        sigma_max(Q (I - (P_k + Delta) L)) is at most this for all plants k and all Delta.
    attained : ndarray, shape (n,)
        What it is for the plant and the Delta below. Without a radius, or with one of the norm,
        that is `sigma` up to rounding.
    plant : ndarray of int, shape (n,)
        Number of the worst plant; 0 is the nominal one. Of those that are tied, the first.
    Delta : ndarray, shape (n, m, m), complex; or None without a radius
        Within the radius, in units of `scale`, as `problem.P` is.
    peaks : ndarray, shape (1 + number of other plants,)
        Largest sigma_max(M) of each plant by itself, Delta = 0.
    tied : tuple of (int, int)
        Plant and index of the frequency of the worst of all, in the order of the frequencies;
        several if rounding could decide between them.
    """

    sigma: np.ndarray
    attained: np.ndarray
    plant: np.ndarray
    Delta: np.ndarray | None
    peaks: np.ndarray
    tied: tuple[tuple[int, int], ...]


def worst_case(problem: Problem, L: LearningFilter) -> WorstCase:
    """Find the worst of all plants of a problem for a learning filter.

    Parameters
    ----------
    problem : Problem
    L : LearningFilter
        In units of `scale`.

    Returns
    -------
    WorstCase

    Raises
    ------
    ValueError
        If an argument is something else, or L has other channels or another sampling period.

    Notes
    -----
    For a radius r of the norm, and rho = |Q| r, the worst case is exactly

        max over unit x of |M x| + rho |L x|
            = min over alpha in (0, 1) of sigma_max([M / sqrt(alpha); rho L / sqrt(1 - alpha)]).

    For each alpha the right-hand side is an upper bound, by Cauchy and Schwarz; it is convex in
    alpha, and at the least of them an x exists that attains it, because the pairs (|M x|^2,
    |L x|^2) fill a convex set (Toeplitz and Hausdorff). Delta of rank one turns rho L x against
    M x.

    For radii r_ij of the entries, x is met by the worst Delta exactly, with

        sum_i (|(M x)_i| + sum_j |Q| r_ij |(L x)_j|)^2
            <= sigma_max(diag(d)^(-1/2) [M; |Q| r_ij (row j of L), all i, j])^2

    for all shares d > 0 of the rows whose sum is one for each i: of row i of M and of the rows
    ij. The best d is found by Newton's method, with a barrier. There are more than two shares, so
    that no x need attain the least of these bounds, but little is lost: with 1500 random M and L
    of each of four kinds (normal, M a tenth as large, unitary, M a multiple of I), for m = 2 and 3,
    the Delta that is found stays below it by 1.3 % at most and by 0.006 % on average.
    """
    arguments.instance("problem", problem, Problem)
    check_learning(L, problem.channels)
    arguments.one_period(problem=problem.Ts, L=L.Ts)
    response = L.frequency_response(problem.omega)
    each = (problem.M(response, k) for k in range(1 + len(problem.others)))
    nominal = np.array([largest_singular_values(M) for M in each])
    plant, peaks = tied(nominal).argmax(axis=0), nominal.max(axis=1)
    at = np.arange(len(problem.omega))
    if problem.radius is None:
        sigma = nominal.max(axis=0)
        return WorstCase(sigma, sigma, plant, None, peaks, _pairs(nominal, at))
    best_shares = _shares_of_entries if by_entries(problem) else _shares_of_norm
    shares = best_shares(stacked(problem, plant, at, response))
    sigma = _bound(stacked(problem, plant, at, response), shares)
    # Any shares give an upper bound: those plants that it leaves in doubt are looked at themselves.
    each = (stacked(problem, np.full(len(at), k), at, response) for k in range(len(nominal)))
    limits = np.array([_bound(G, shares) for G in each])
    while np.any(limits > sigma):
        [at] = np.nonzero(limits.max(axis=0) > sigma)
        number = limits[:, at].argmax(axis=0)
        limits[number, at] = 0
        G = stacked(problem, number, at, response)
        found = best_shares(G)
        value = _bound(G, found)
        worse = value > sigma[at]
        there = at[worse]
        plant[there], sigma[there], shares[there] = number[worse], value[worse], found[worse]
    Delta, attained = _worst_Delta(problem, plant, response, shares)
    [at] = np.nonzero(tied(sigma))
    each = [stacked(problem, np.full(len(at), k), at, response) for k in range(len(nominal))]
    of_all = np.array([_bound(G, best_shares(G)) for G in each])
    return WorstCase(sigma, attained, plant, Delta, peaks, _pairs(of_all, at))


def _pairs(values, at):
    """Plant and frequency of all that are tied as the worst, of values of plants at frequencies."""
    frequency, plant = np.nonzero(tied(values.ravel()).reshape(values.shape).T)
    return tuple(zip(plant.tolist(), at[frequency].tolist(), strict=True))


def by_entries(problem: Problem) -> bool:
    """Whether the radius is one for each entry; that of a single channel is its norm."""
    return problem.radius is not None and problem.radius.ndim == 3 and problem.channels > 1


def affine(problem: Problem, plant, at) -> tuple[np.ndarray, np.ndarray]:
    """F and T, with G = F + T L the matrix that :class:`rodlib.ilc.problem.Cuts` is about.

    Parameters
    ----------
    problem : Problem
    plant, at : ndarray of int, shape (c,)
        Numbers of the plants, indices of the frequencies.

    Returns
    -------
    F, T : ndarray, shape (c, rows of G, m), complex
    """
    m, other = problem.channels, plant > 0
    P, Q = problem.P[at], problem.Q[at, None, None]
    P[other] = problem.others[plant[other] - 1, at[other]]
    T = [-Q * P]
    if problem.radius is not None:
        r = problem.radius[at] if by_entries(problem) else problem.radius[at].reshape(-1, 1, 1)
        identity = np.tile(np.eye(m), (m, 1)) if by_entries(problem) else np.eye(m)
        rows = r.reshape(len(at), -1, 1) * identity
        T.append(np.abs(Q) * rows)
    T = np.concatenate(T, axis=1)
    return Q * np.eye(T.shape[1], m), T


def layout(problem: Problem) -> np.ndarray:
    """Rows of G, shape (g, k, l): g groups of k shares that add up to one, l rows for each."""
    m = problem.channels
    if by_entries(problem):
        return np.insert(m + np.arange(m * m).reshape(m, m), 0, np.arange(m), axis=1)[..., None]
    return np.arange(m if problem.radius is None else 2 * m).reshape(1, -1, m)


def stacked(problem, plant, at, response):
    """G, shape (c, rows, m), from the frequency response of L at all frequencies."""
    F, T = affine(problem, plant, at)
    return F + T @ response[at]


def _bound(G, shares):
    """sigma_max of G whose rows are divided by the square roots of their shares."""
    return largest_singular_values(G / np.sqrt(shares)[..., None])


def _shares_of_norm(G):
    """Shares (alpha, 1 - alpha) of M and of rho L, as rows of G."""
    return _two_shares(_balance(G)[0], G.shape[2])


def _two_shares(t, m):
    """alpha = 1 / (1 + exp(t)) and 1 - alpha, m times each, shape (c, 2m)."""
    return np.repeat(np.stack([1 / (1 + np.exp(t)), 1 / (1 + np.exp(-t))], axis=1), m, axis=1)


def _balance(G):
    """The best t = log((1 - alpha) / alpha), and neighbours below and above it."""

    def imbalance(t, i):
        first, second = np.linalg.norm(_images(G[i], _most_amplified(G[i], t)), axis=2).T
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = np.log(second) - np.log(first)
        return t - np.clip(np.nan_to_num(wanted), -FARTHEST, FARTHEST)

    ends = np.full(len(G), FARTHEST + 1)
    with np.errstate(invalid="ignore"):  # a bracket at rounding level, which is then halved
        root = elementwise.find_root(imbalance, (-ends, ends), args=(np.arange(len(G)),))
    return root.x, *np.clip(root.bracket, root.x - NEXT, root.x + NEXT)


def _most_amplified(G, t):
    """The unit x that [M / sqrt(alpha); rho L / sqrt(1 - alpha)] amplifies most."""
    weighted = G / np.sqrt(_two_shares(t, G.shape[2]))[..., None]
    return np.linalg.svd(weighted)[2][:, 0].conj()


def _images(G, x):
    """M x and rho L x, shape (c, 2, m)."""
    return (G @ x[..., None]).reshape(len(G), 2, -1)


def _balanced_vector(G):
    """The unit x with the largest |M x| + |rho L x|.

    Where two are amplified equally at the best alpha, one with too large an M x and one with too
    large an L x, it is the sum of both for which alpha is the best, too.
    """
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


def _shares_of_entries(G):
    """Shares of the rows of G, for radii of the entries, by Newton's method with a barrier.

    Minimises the bound b over the shares d, subject to b I >= G^H diag(d)^-1 G and to groups of
    shares that add up to one. The barrier is self-concordant, which says how far a step may go.
    """
    c, rows, m = G.shape
    member = _groups(m)
    d = np.full((c, rows), 1 / (m + 1))
    size = _bound(G, d)
    G = G / np.where(size > 0, size, 1)[:, None, None]
    b, weight, todo = np.full(c, 2.0), np.ones(c), np.arange(c)
    for _ in range(STEPS):
        step_d, step_b, decrement = _newton_step(G[todo], d[todo], b[todo], weight[todo], member)
        length = np.where(decrement < 0.25, 1, 1 / (1 + decrement))
        d[todo] *= 1 + length[:, None] * step_d
        b[todo] += length * step_b
        weight[todo] *= np.where(decrement < 0.25, FASTER, 1)
        todo = todo[weight[todo] * ACCURACY < 1]
    return d / (d @ member.T @ member)


def _newton_step(G, d, b, weight, member):
    """Relative step of d, step of b, and the decrement: its length in the metric of the barrier."""
    c, rows, m = G.shape
    G = G / np.sqrt(d)[..., None]
    S = np.linalg.inv(b[:, None, None] * np.eye(m) - G.conj().swapaxes(1, 2) @ G)
    K = G @ S @ G.conj().swapaxes(1, 2)
    diagonal = np.einsum("crr->cr", K).real
    system = np.zeros((c, rows + 1 + m, rows + 1 + m))
    system[:, :rows, :rows] = np.abs(K) ** 2 + (2 * diagonal[:, None] + 1) * np.eye(rows)
    system[:, rows, :rows] = (np.abs(G @ S) ** 2).sum(axis=2)
    system[:, rows, rows] = (np.abs(S) ** 2).sum(axis=(1, 2))
    system[:, rows + 1 :, :rows] = member * d[:, None]
    system[:, :rows, rows:] = system[:, rows:, :rows].swapaxes(1, 2)
    right = np.zeros((c, rows + 1 + m))
    right[:, :rows] = diagonal + 1
    right[:, rows] = np.einsum("crr->c", S).real - weight
    step = np.linalg.solve(system, right[..., None])[:, : rows + 1, 0]
    metric = system[:, : rows + 1, : rows + 1]
    decrement = np.sqrt(np.einsum("ck,ckl,cl->c", step, metric, step))
    return step[:, :rows], step[:, rows], decrement


def _groups(m):
    """Which shares add up to one, shape (m, m + m^2): d_i of row i of M, and d_ij of rows ij."""
    return np.hstack([np.eye(m), np.kron(np.eye(m), np.ones(m))])


def _worst_Delta(problem, plant, response, shares):
    """A Delta within the radius at each frequency, and the sigma_max(M) that it leads to."""
    G = stacked(problem, plant, np.arange(len(plant)), response)
    m, Q = problem.channels, problem.Q[:, None, None]
    M = G[:, :m]
    against = -_phase(Q).conj()  # so that -Q Delta L x points as M x does
    if not by_entries(problem):
        x = _balanced_vector(G)[..., None]
        u, v = (_unit((X @ x)[..., 0])[..., None] for X in (M, response))
        Delta = problem.radius.reshape(-1, 1, 1) * against * u * v.conj().swapaxes(1, 2)
        return Delta, largest_singular_values(M - Q * Delta @ response)
    most, Delta = _bound(G, shares), np.zeros(M.shape, dtype=complex)
    attained = largest_singular_values(M)
    vectors = np.linalg.svd(G / np.sqrt(shares)[..., None])[2].conj()
    first, others = vectors[:, 0], vectors[:, 1:].swapaxes(0, 1)
    for start in [first, *others, *(first + turn * x for x in others for turn in PHASES)]:
        [todo] = np.nonzero(attained < most * (1 - TIGHT))
        found, reached = _climb(M[todo], Q[todo], response[todo],
                                against[todo] * problem.radius[todo], start[todo])  # fmt: skip
        better = reached > attained[todo]
        Delta[todo[better]], attained[todo[better]] = found[better], reached[better]
    return Delta, attained


def _climb(M, Q, L, against, x):
    """In turn, the Delta that is worst for x and the x that this Delta amplifies most."""
    x = x[..., None]
    for _ in range(ROUNDS):
        Delta = against * _phase(M @ x) * _phase(L @ x).conj().swapaxes(1, 2)
        perturbed = M - Q * Delta @ L
        x = np.linalg.svd(perturbed)[2][:, :1].conj().swapaxes(1, 2)
    return Delta, largest_singular_values(perturbed)


def _phase(z):
    """z / |z|; one where that is 0 / 0."""
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1), 1)


def _unit(x):
    """x / |x| for each row; the first axis where that is 0 / 0."""
    size = np.linalg.norm(x, axis=1, keepdims=True)
    return np.where(size > 0, x / np.where(size > 0, size, 1), np.eye(1, x.shape[1]))
