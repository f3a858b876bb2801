"""How slowly may learning converge? The worst case over all plants within a radius.

At each frequency, the worst case is the largest sigma_max(Q (I - (P_k + Delta) L)) over the plants
P_k and over all errors Delta with ||Delta|| <= r, where r is the radius at this frequency. The
computed value is a proved upper bound, and some Delta attains this bound.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise
from scipy.special import expit

from ilctools import arguments
from ilctools.filters import Filter, check_learning
from ilctools.problem.problem import Problem, convergence_matrix
from ilctools.signals import check_match
from ilctools.singular_values import largest_singular_values, tied

NEAR_LEVEL = 0.99  # share of `level` in within_radius, above which a worst case is exact
TO_ROUNDING = {"xatol": 0, "xrtol": 1e-11, "fatol": 0, "frtol": 1e-13}
MOST_UNEQUAL = 40.0  # logarithm of the ratio of two shares; the smaller share is then rounding


@dataclass(frozen=True, eq=False)
class WorstCase:
    """The worst case of sigma_max(M) at each frequency, as :func:`worst_case` returns it."""

    sigma: np.ndarray  # (n,): an upper bound for all plants and all Delta within the radius
    frequency: int  # index of the frequency with the largest sigma; the first if several are tied
    plant: int  # number of the plant with the largest sigma


def worst_case(problem: Problem, L: Filter) -> WorstCase:
    """Find the largest sigma_max(M) of a learning filter over all plants of a problem.

    M = Q (I - P L) maps the error of one trial to the error of the next trial.

    Parameters
    ----------
    problem : Problem
        The problem, with its plants and their radius, such as ``design.problem``.
    L : LearningFilter
        The filter, in units of `scale`.

    See Also
    --------
    synthesise : bounds sigma_max(M) for all plants
    Synthesis.check : computes the rate for another plant

    Notes
    -----
    Let r be the radius, and rho = |Q| r. For one plant and one frequency, the largest
    sigma_max(Q (I - (P + Delta) L)) over all Delta with ||Delta|| <= r is exactly

        max over unit x of |M x| + rho |L x|
            = min over alpha in (0, 1) of sigma_max([M / sqrt(alpha); rho L / sqrt(1 - alpha)]).

    For a given x, |M x - Q Delta L x| is largest for a Delta of rank one and norm r. This Delta
    rotates L x into the direction of M x, so that the two terms add. The left-hand side is
    therefore attained. For each alpha, the right-hand side is an upper bound by the inequality of
    Cauchy and Schwarz. This bound is convex in alpha. At the least bound, an x exists that attains
    the bound, because the pairs (|M x|^2, |L x|^2) fill a convex set, by the theorem of Toeplitz
    and Hausdorff.

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
    check_learning(L, "L", problem.m, problem.p)
    check_match(problem=problem, L=L)
    response = L.frequency_response(problem.omega)
    sigma = np.array([worst_sigma(problem, response, k, 0) for k in range(len(problem.plants))])
    first, *_ = np.argwhere(tied(sigma.ravel()).reshape(sigma.shape).T).tolist()
    return WorstCase(sigma.max(axis=0), *first)


def worst_sigma(problem, L, k, level):
    """Return the worst sigma_max(M) of plant k within its radius, see :func:`within_radius`."""
    return within_radius(problem.plants[k], problem.Q, L, problem.response.radii, level)


def within_radius(P, Q, L, radius, level):
    """Return the largest sigma_max(M) over all plants within a radius of P, shape (n,).

    P has the shape (n, p, m), and L has the shape (n, m, p). A result above `NEAR_LEVEL` times
    `level` is exact. A smaller result is an upper bound.
    """
    M, rho_L = convergence_matrix(P, Q, L), (np.abs(Q) * radius)[:, None, None] * L
    if P.shape[2] < P.shape[1]:  # M = Q (I - L P): the same problem for P^T and L^T
        M, rho_L = M.mT, rho_L.mT
    wider = largest_singular_values(rho_L) if np.any(radius) else np.zeros(len(M))
    sigma = largest_singular_values(M) + wider
    near = (sigma >= NEAR_LEVEL * level) & (wider > 0)
    if M.shape[1] > 1 and near.any():
        least = _least_bound(np.concatenate([M, rho_L], axis=1)[near])
        sigma[near] = np.fmin(sigma[near], least)
    return sigma


def _least_bound(G):
    """Minimise sigma_max([M / sqrt(alpha); rho L / sqrt(1 - alpha)]) over alpha, shape (n,).

    The argument is G = [M; rho L]. Where M is zero, the result is NaN.
    """

    def bound(t, i):
        """Compute sigma_max of the weighted G for t = log((1 - alpha) / alpha)."""
        m = G.shape[2]
        root = np.sqrt(expit([-t, t])).T.repeat([m, G.shape[1] - m], axis=1)
        return largest_singular_values(G[i] / root[:, :, None])

    end, numbers = np.full(len(G), MOST_UNEQUAL), np.arange(len(G))
    bracket = -end, 0 * end, end
    return elementwise.find_minimum(bound, bracket, args=(numbers,), tolerances=TO_ROUNDING).f_x
