"""Is the filter optimal? A bound on the objective that no other filter can beat.

It follows from the solver's multipliers, whatever their quality, by linear algebra alone.
"""

import numpy as np

from rodlib.problem import Problem


def lower_bound(problem: Problem, U, V) -> float:
    """Lower bound on the optimum of (39) or (45), from multipliers and linear algebra alone.

    For all filters that meet the bounds, and all U_i, V_i with sum_i Re tr(U_i^H dM_i) +
    Re tr(V_i^H dL_i) = 0 for every change of the coefficients,

        sum_i Re tr(U_i^H Q_i) = sum_i Re tr(U_i^H M_i) + Re tr(V_i^H L_i)
                               <= sum_i |U_i| sigma_max(M_i) + sum_i |W^-1 V_i|

    with nuclear norms |.| and W of :attr:`rodlib.problem.Problem.weight`. Where |U_i| exceeds the
    weight of sigma_max(M_i) in the objective, the excess is bounded with M_max. U and V are first
    projected on those that fulfil the condition, so the bound holds, up to rounding, whatever was
    passed. A coefficient of L_jk acts on column k of M and L only, so the columns are projected one
    by one.

    Parameters
    ----------
    problem : Problem
    U, V : ndarray, shape (n, m, m); V may be None
        Multipliers of the bounds on M and on L. With V None, no bound on L is used at all.

    Returns
    -------
    float
    """
    P, Q, angles = problem.P, problem.Q, problem.angles
    n, m, _ = P.shape
    T, N = -Q[:, None, None] * P, np.array(U, dtype=complex)
    if V is not None:  # in units of the bound, so that both parts have the size of the objective
        W = problem.weight
        T = np.concatenate([T, np.broadcast_to(W, (n, m, m))])
        N = np.concatenate([N, np.linalg.solve(W, V)])
        angles = np.concatenate([angles, angles])
    groups = [list(range(m))] if problem.structure == "full" else [[k] for k in range(m)]
    for group in groups:
        changes = _changes(T[:, :, group], angles, problem.order)
        part = _rows(N[:, :, group])
        for _ in range(2):
            part -= (part @ changes.T) @ changes
        N[:, :, group] = part.view(complex).reshape(-1, len(N), m).transpose(1, 2, 0)
    norms = np.linalg.svd(N, compute_uv=False).sum(axis=1)
    bound = (np.trace(N[:n].conj(), axis1=1, axis2=2) * Q).real.sum() - norms[n:].sum()
    if problem.objective == "peak":
        return float(bound / norms[:n].sum())
    return float(bound - problem.M_max * np.maximum(norms[:n] - problem.in_band, 0).sum())


def _changes(T, angles, order):
    """Orthonormal rows that span what the coefficients can do to T L, shape (n, m, q).

    The powers of z are nearly dependent at low frequencies. Arnoldi's process never forms them: it
    multiplies the last rows by z - 1 and makes the result orthogonal to all before, which spans
    the same space and needs no more than doubles.
    """
    rows = _rows(T * np.exp(1j * angles)[:, None, None])
    step = np.repeat(np.expm1(1j * angles), T.shape[1])
    done = np.empty((0, rows.shape[1]))
    for _ in range(order):
        for _ in range(2):  # once leaves what rounding has put back
            rows = np.linalg.qr((rows - (rows @ done.T) @ done).T)[0].T
        done = np.vstack([done, rows])
        rows = (np.ascontiguousarray(rows).view(complex) * step).view(float)
    return done


def _rows(X):
    """Columns of all X as one real row each, real and imaginary parts in turn: (n, m, q)."""
    rows = X.transpose(2, 0, 1).reshape(X.shape[2], -1)
    return np.ascontiguousarray(rows, dtype=complex).view(float)
