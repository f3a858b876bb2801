"""Small problems for the solver, and their optima by CVXPY."""

import tracemalloc
import warnings

import cvxpy as cp
import numpy as np

from ilctools.problem.problem import Cuts


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
        L, limit = sum(c * z ** (k + 1) for k, c in enumerate(C)), 1 / problem.weight[i, 0, 0]
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
