"""The synthesis problems in CVXPY, as the paper states them: one matrix inequality per frequency.

This is the statement to read, and to compare with. :mod:`rodlib.synthesis.interior_point` solves
the same problems ten to forty times faster (the benchmark in the README), and more accurately.
"""

import warnings

import cvxpy as cp
import numpy as np

from rodlib.problem import Solution
from rodlib.synthesis.program import Infeasible, Program


def solve(program: Program) -> Solution:
    """State the problem in CVXPY and solve it with Clarabel.

    Parameters
    ----------
    program : Program
        From :func:`rodlib.synthesis.program.formulate`.

    Returns
    -------
    Solution

    Raises
    ------
    Infeasible
        If M_max cannot be met.
    RuntimeError
        If Clarabel fails.
    """
    n = program.basis.shape[1]
    x = cp.Variable(program.entries * len(program.basis))
    t = cp.Variable(1 if program.shared else len(program.free))
    level = np.zeros((n, t.size))  # of the bound on M: t at some frequencies, M_max at the others
    level[program.free] = 1 if program.shared else np.eye(t.size)
    fixed = np.where(level.any(axis=1), 0, program.limits[0])
    levels = [level @ t + fixed, *[np.ones(n)] * (len(program.bounds) - 1)]

    subject_to = []  # sigma_max(F + T L) <= level, (39), (45), (46)
    for bound, b in zip(program.bounds, levels, strict=True):
        shape = (n, *bound.F.shape[:2])
        F = np.moveaxis(bound.F, -1, 0).ravel()
        T = np.moveaxis(bound.linear(program.basis), 2, 0).reshape(F.size, -1)
        T = np.pad(T, [(0, 0), (0, x.size - T.shape[1])])
        parts = (F.real + T.real @ x, F.imag + T.imag @ x)
        G = [cp.reshape(part, shape, order="C") for part in parts]
        subject_to.append(sigma_max_at_most(G, b))
    meets = [] if program.shared else [t <= program.M_max]
    problem = cp.Problem(cp.Minimize(cp.sum(t)), subject_to + meets)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": the caller checks the result
            problem.solve(
                solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND,
                chordal_decomposition_enable=False,
            )  # fmt: skip
    except cp.SolverError as error:
        raise RuntimeError(f"Clarabel failed: {error}") from None
    failed = x.value is None or problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE)
    if failed and not program.shared:
        solve(program.peak())  # which raises, if it is the bounds
    if failed:
        raise RuntimeError(f"Clarabel ended with status {problem.status!r} and returned no filter")
    method = f"CVXPY with Clarabel ({problem.status})"
    coefficients = x.value.reshape(program.entries, -1)
    multipliers = [multiplier(constraint) for constraint in subject_to]
    iterations = problem.solver_stats.num_iters
    solution = program.solution(coefficients, multipliers, method, iterations)
    if program.shared and solution.peak > program.M_max:
        raise Infeasible(program.M_max, solution.peak)
    return solution


def sigma_max_at_most(parts, bound):
    """sigma_max(G_i) <= b_i as [[b I, G], [G^H, b I]] >= 0, written in real numbers."""
    real, imag = parts
    n, m, _ = real.shape
    if m == 1:
        return cp.SOC(bound, cp.vstack([part[:, 0, 0] for part in parts]))
    b = cp.multiply(cp.reshape(bound, (n, 1, 1), order="C"), np.tile(np.eye(m), (n, 1, 1)))
    zero = np.zeros((n, m, m))
    real_t, imag_t = (cp.swapaxes(part, 1, 2) for part in parts)
    rows = [
        [b, zero, real, -imag],
        [zero, b, imag, real],
        [real_t, imag_t, b, zero],
        [-imag_t, real_t, zero, b],
    ]
    return cp.concatenate([cp.concatenate(row, axis=2) for row in rows], axis=1) >> 0


def multiplier(constraint):
    """Multiplier of G, shape (q, q, n), from that of its constraint."""
    Z = constraint.dual_value
    if isinstance(constraint, cp.SOC):
        real, imag = Z[1].reshape(2, -1)
        return -(real + 1j * imag)[None, None]
    m = Z.shape[-1] // 4
    Z = Z.reshape(len(Z), 4, m, 4, m)
    N = -2 * (Z[:, 0, :, 2] + Z[:, 1, :, 3] + 1j * (Z[:, 1, :, 2] - Z[:, 0, :, 3]))
    return np.moveaxis(N, 0, -1)
