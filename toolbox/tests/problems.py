"""Small problems for the solver, and their optima by CVXPY."""

import tracemalloc
import warnings

import cvxpy as cp
import numpy as np

from ilctools.problem.pose import pose
from ilctools.problem.problem import Cuts


def memory(function):
    """Bytes that a call holds at most."""
    tracemalloc.start()
    function()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def plant(m, n=20, seed=0, grid=np.geomspace):
    rng = np.random.default_rng(seed)
    omega = grid(1e-3, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    P = (np.eye(m) + 0.2 * rng.standard_normal((m, m))) * 0.2 / (z - 0.8)
    return P, 1 / (1 + omega**4), omega


def posed(P, Q, omega, structure, objective="sum", L_max=5.0, M_max=0.9, uncertainty=None):
    kind = {"structure": structure, "objective": objective, "uncertainty": uncertainty}
    return pose(P, Q, omega, 1.0, order=4, M_max=M_max, L_max=L_max, band=(1e-3, 1), **kind)


def dense(diagonal, b, G):
    """S = [[Lambda, G], [G^H, b I]], frequency first, one by one."""
    columns = zip(diagonal.T, b, np.moveaxis(G, -1, 0), strict=True)
    blocks = [
        [[np.diag(Lambda), G_i], [G_i.conj().T, b_i * np.eye(G.shape[1])]]
        for Lambda, b_i, G_i in columns
    ]
    return np.array([np.block(rows) for rows in blocks])


def optimum(problem):
    """The problem as a semidefinite program, entry for entry: its optimum and its multipliers.

    With all of its plants, radius and weights, by Clarabel. The matrices are variables of their
    own, so that the multipliers U, V and those of the cuts are those of equations.
    """
    m, M_max, others = problem.channels, problem.M_max, range(1, len(problem.plants))
    C = [cp.Variable((m, m)) for _ in range(problem.order)]
    if problem.structure == "diagonal":
        C = [cp.diag(cp.Variable(m)) for _ in range(problem.order)]
    subject_to, value, peak = [], 0, cp.Variable()
    equations, plant, frequency = {"U": [], "V": [], "N": []}, [], []
    bound = peak if problem.objective.kind == "peak" else M_max

    def named(kind, expression):
        variable = cp.Variable(expression.shape, complex=True)
        equations[kind].append(variable == expression)
        return variable

    def at_most(G, corner, b):  # sigma_max(G) <= b, for the corner b I
        return cp.bmat([[corner, G], [G.H, b * np.eye(m)]]) >> 0

    def response(omega):
        z = np.exp(1j * omega * problem.Ts)
        return sum(c * z ** (k + 1) for k, c in enumerate(C))

    for omega, weight in zip(problem.omega, problem.weight, strict=True):
        limit = 1 / weight[0, 0]
        subject_to.append(at_most(named("V", response(omega)), limit * np.eye(m), limit))
    for i, omega in enumerate(problem.omega):
        q, L, t = problem.Q[i], response(omega), cp.Variable()
        M = [q * (np.eye(m) - P[i] @ L) for P in problem.plants]
        subject_to.append(at_most(named("U", M[0]), t * np.eye(m), t))
        value += problem.objective.weights[i] * t
        if problem.radius is None:
            subject_to.append(t <= bound)
        for k in others if problem.radius is None else [0, *others]:
            plant.append(k), frequency.append(i)
            G, shares = M[k], [bound] * m
            if problem.radius is not None:
                G, d = cp.vstack([G, abs(q) * problem.radius[i] * L]), cp.Variable()
                shares = [bound - d] * m + [d] * m
            corner = cp.diag(cp.hstack(shares))
            subject_to.append(at_most(named("N", G), corner, bound))
    subject_to += [equation for kind in equations.values() for equation in kind]
    cost = peak if problem.objective.kind == "peak" else value
    tiny = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-11)
    program = cp.Problem(cp.Minimize(cost), subject_to)
    with warnings.catch_warnings(action="ignore"):  # "may be inaccurate"
        program.solve(solver=cp.CLARABEL, **tiny)
    U, V, N = (-np.array([e.dual_value for e in equations[kind]]) for kind in "UVN")
    return program.value, U, V, Cuts(np.array(plant), np.array(frequency), N)
