"""The synthesis problems in CVXPY, as the paper states them: one matrix inequality per frequency.

This is the statement to read, and to compare with.
"""

import warnings

import cvxpy as cp
import numpy as np

from ilctools.problem.problem import Solution
from ilctools.synthesis.solver.program import Infeasible, Program


def solve(program: Program) -> Solution:
    """State the problem in CVXPY and solve it with Clarabel; Infeasible if M_max cannot be met."""
    x = cp.Variable(program.entries * len(program.basis))
    t = cp.Variable(1 if program.shared else len(program.free))

    # sigma_max(F + T L) <= level: of M in (39), (45), of L in (46)
    subject_to, splits = [], []
    for j, bound in enumerate(program.bounds):
        p, q, n = bound.shape
        shape = (n, p, q)
        has_t = program.has_t(j)
        share = np.zeros((n, t.size))  # of t in the level
        share[has_t] = 1 if program.shared else np.eye(t.size)[: len(has_t)]
        b = share @ t + np.where(share.any(axis=1), 0, program.limits[bound.limit])
        F = np.moveaxis(bound.F, -1, 0).ravel()
        T = np.moveaxis(bound.linear(program.basis), 2, 0).reshape(F.size, -1)
        T = np.pad(T, [(0, 0), (0, x.size - T.shape[1])])
        parts = (F.real + T.real @ x, F.imag + T.imag @ x)
        G = [cp.reshape(part, shape, order="C") for part in parts]
        d = cp.Variable((n, 1)) if bound.splits else None
        subject_to.append(sigma_max_at_most(G, b, bound, d))
        splits.append(d)
    meets = [] if program.shared else [t <= program.M_max]
    cost = program.cost @ t  # the sum in (39), the largest in (45)
    problem = cp.Problem(cp.Minimize(cost), subject_to + meets)
    try:
        with warnings.catch_warnings():
            # "may be inaccurate": the caller checks the result
            warnings.simplefilter("ignore")
            problem.solve(
                solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND,
                chordal_decomposition_enable=False,
            )  # fmt: skip
    except cp.SolverError as error:
        raise RuntimeError(f"Clarabel failed: {error}") from None
    failed = x.value is None or problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE)
    if failed and not program.shared:
        solve(program.minimax())  # which raises, if it is the bounds
    if failed:
        raise RuntimeError(f"Clarabel ended with status {problem.status!r} and returned no filter")
    method = f"CVXPY with Clarabel ({problem.status})"
    coefficients = x.value.reshape(program.entries, -1)
    multipliers = [
        multiplier(constraint, bound)
        for constraint, bound in zip(subject_to, program.bounds, strict=True)
    ]
    levels = program.levels(t.value, program.limits)
    splits = [
        np.zeros((0, len(b))) if d is None else np.maximum(d.value.T, 1e-12) / b
        for d, b in zip(splits, levels, strict=True)
    ]
    iterations = problem.solver_stats.num_iters
    solution = program.solution(coefficients, multipliers, splits, method, iterations)
    if program.shared and solution.largest > program.M_max:
        raise Infeasible(program.M_max, solution)
    return solution


def sigma_max_at_most(parts, b, bound=None, d=None):
    """sigma_max(G_i) <= b_i as [[Lambda, G], [G^H, b I]] >= 0, written in real numbers."""
    real, imag = parts
    n, p, q = real.shape
    if p == q == 1:
        return cp.SOC(b, cp.vstack([part[:, 0, 0] for part in parts]))

    def diagonal(levels, size):
        """A diagonal matrix for each of the n levels, or rows of levels."""
        levels = cp.reshape(levels, (n, 1, levels.size // n), order="C")
        return cp.multiply(levels, np.tile(np.eye(size), (n, 1, 1)))

    Lambda = diagonal(b, p)
    if d is not None:
        rows = cp.reshape(b, (n, 1), order="C") @ bound.of_b[None] + d @ bound.of_d[None]
        Lambda = diagonal(rows, p)
    above, below = np.zeros((n, p, p)), np.zeros((n, q, q))
    real_t, imag_t = (cp.swapaxes(part, 1, 2) for part in parts)
    rows = [
        [Lambda, above, real, -imag],
        [above, Lambda, imag, real],
        [real_t, imag_t, diagonal(b, q), below],
        [-imag_t, real_t, below, diagonal(b, q)],
    ]
    return cp.concatenate([cp.concatenate(row, axis=2) for row in rows], axis=1) >> 0


def multiplier(constraint, bound):
    """Multiplier of G, shape (p, q, n), from that of its constraint."""
    Z = constraint.dual_value
    if isinstance(constraint, cp.SOC):
        real, imag = Z[1].reshape(2, -1)
        return -(real + 1j * imag)[None, None]
    p = len(bound.F)
    above, below = np.split(Z[:, : 2 * p, 2 * p :], 2, axis=1)
    (real, minus_imag), (imag, again) = (np.split(half, 2, axis=2) for half in (above, below))
    N = -2 * (real + again + 1j * (imag - minus_imag))
    return np.moveaxis(N, 0, -1)
