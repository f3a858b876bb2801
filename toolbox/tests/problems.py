"""Problems for the solver, and their optima by CVXPY.

`optimum` takes any problem, entry for entry, and returns multipliers, too; `statement` is that of
the paper for one plant, as it is timed and for hundreds of frequencies: for real C_k,

    L_i = sum_k C_k z_i^k,    M_i = Q_i (I - P_i L_i),    (44), (40)

minimise the sum of sigma_max(M_i) in a band, (39), or the largest, (45), subject to

    sigma_max(M_i) <= M_max,    sigma_max(L_i) <= L_max    (46)

at all frequencies. That sigma_max(G) <= b is one matrix inequality, [[b I, G], [G^H, b I]] >= 0,
for all frequencies at once, with [[Re G, -Im G], [Im G, Re G]] in the place of G.
"""

import tracemalloc
import warnings

import cvxpy as cp
import numpy as np

from ilctools.problem.pose import pose
from ilctools.problem.problem import Cuts
from ilctools.response.door import response_of


def posed(P, Q, omega=None, Ts=None, uncertainty=None, scale=None, **choices):
    """The problem that `synthesise` states for the same arguments."""
    return pose(response_of(P, omega, Ts, uncertainty, scale, Q), Q, **choices)


def memory(function):
    """Bytes that a call holds at most."""
    tracemalloc.start()
    function()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def optimum(problem):
    """The problem as a semidefinite program, entry for entry: its optimum and its multipliers.

    With all of its plants, radius and weights, by Clarabel. The matrices are variables of their
    own, so that the multipliers U, V and those of the cuts are those of equations.
    """
    m, M_max, others = problem.channels, problem.M_max, range(1, len(problem.plants))
    C = [cp.Variable((m, m)) for _ in range(problem.order)]
    if problem.structure == "diagonal":
        C = [cp.diag(cp.Variable(m)) for _ in range(problem.order)]
    subject_to, value, peak, one = [], 0, cp.Variable(), np.eye(m)
    equations, plant, frequency = {"U": [], "V": [], "N": []}, [], []
    bound = peak if problem.objective.kind == "peak" else M_max

    def at_most(kind, expression, corner, b):  # sigma_max <= b, for the corner b I
        variable = cp.Variable(expression.shape, complex=True)
        equations[kind].append(variable == expression)
        subject_to.append(cp.bmat([[corner, variable], [variable.H, b * one]]) >> 0)

    for i, omega in enumerate(problem.omega):
        q, z, t = problem.Q[i], np.exp(1j * omega * problem.Ts), cp.Variable()
        L, limit = sum(c * z ** (k + 1) for k, c in enumerate(C)), 1 / problem.L_bound[i, 0, 0]
        M = [q * (one - P[i] @ L) for P in problem.plants]
        at_most("V", L, limit * one, limit)
        at_most("U", M[0], t * one, t)
        value += problem.objective.weights[i] * t
        if problem.radius is None:
            subject_to.append(t <= bound)
        for k in others if problem.radius is None else [0, *others]:
            plant.append(k), frequency.append(i)
            G, shares = M[k], [bound] * m
            if problem.radius is not None:
                G, d = cp.vstack([G, abs(q) * problem.radius[i] * L]), cp.Variable()
                shares = [bound - d] * m + [d] * m
            at_most("N", G, cp.diag(cp.hstack(shares)), bound)
    subject_to += [equation for kind in equations.values() for equation in kind]
    cost = peak if problem.objective.kind == "peak" else value
    tiny = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-11)
    program = cp.Problem(cp.Minimize(cost), subject_to)
    with warnings.catch_warnings(action="ignore"):  # "may be inaccurate"
        program.solve(solver=cp.CLARABEL, **tiny)
    U, V, N = (-np.array([e.dual_value for e in equations[kind]]) for kind in "UVN")
    return program.value, U, V, Cuts(np.array(plant), np.array(frequency), N)


def statement(P, Q, omega, Ts, *, order, band, M_max=0.9, L_max=None, structure="full"):
    """State the problem (39), and let Clarabel solve it.

    Arguments as for `synthesise`, P and Q as arrays. The powers of z are nearly
    dependent at low frequencies, where Clarabel would fail: C consists of multiples of R^-T, of
    which L is a combination of orthonormal functions.

    Returns
    -------
    L : ndarray, shape (n, m, m)
        Response of the filter; None if the bounds cannot be met.
    value : float
        The objective; infinite if the bounds cannot be met. Clarabel's accuracy is about 1e-6.
    """
    n, m, _ = P.shape
    z = np.exp(1j * omega * Ts)[:, None] ** np.arange(1, order + 1)
    inverse = np.linalg.inv(np.linalg.qr(np.vstack([z.real, z.imag]), mode="r")) * np.sqrt(n)
    taps, t = cp.Variable((order, m * m)), cp.Variable(n)
    L = cp.reshape((z @ inverse) @ taps, (n, m, m), order="C")  # (44)
    M = Q[:, None, None] * np.eye(m) - (Q[:, None, None] * P) @ L  # (40)
    bounds = [sigma_max_at_most(M, t), t <= M_max]
    if L_max is not None:
        bounds.append(sigma_max_at_most(L, np.full(n, L_max)))  # (46)
    if structure == "diagonal":
        bounds.append(taps[:, ~np.eye(m, dtype=bool).ravel()] == 0)
    cost = cp.sum(t[(omega >= band[0]) & (omega <= band[1])])  # (39)
    problem = cp.Problem(cp.Minimize(cost), bounds)
    options = {"canon_backend": cp.SCIPY_CANON_BACKEND, "chordal_decomposition_enable": False}
    with warnings.catch_warnings(action="ignore"):  # "may be inaccurate": about 1e-6
        value = problem.solve(solver=cp.CLARABEL, **options)
    return L.value, value


def sigma_max_at_most(G, b):
    """sigma_max(G_i) <= b_i."""
    n, m, _ = G.shape
    G = blocks(cp.real(G), -cp.imag(G), cp.imag(G), cp.real(G))
    corner = cp.multiply(cp.reshape(b, (n, 1, 1), order="C"), np.tile(np.eye(2 * m), (n, 1, 1)))
    return blocks(corner, G, cp.swapaxes(G, 1, 2), corner) >> 0


def blocks(upper_left, upper_right, lower_left, lower_right):
    """A block matrix for each frequency."""
    upper = cp.concatenate([upper_left, upper_right], axis=2)
    return cp.concatenate([upper, cp.concatenate([lower_left, lower_right], axis=2)], axis=1)
