"""Is the filter optimal? A bound on the objective that no other filter can beat.

The bound is computed from the solver's multipliers by linear algebra alone. The bound is valid even
if the multipliers are inaccurate.
"""

import numpy as np
from scipy.special import expit

from ilctools.evidence.robustness import MOST_UNEQUAL
from ilctools.problem.problem import Cuts, Problem

HALVINGS = 40  # of the interval of logarithms of w_1 / w_2 that is searched
FAINT = 1e-12  # lower limit on the eigenvalues of X in `dual_norm`, relative to the size of N


def lower_bound(problem: Problem, U, V, cuts: Cuts | None = None) -> float:
    """Compute a lower bound on the optimum of (39) or (45) of the paper from multipliers.

    U_i and V_i are multipliers of the bounds on M and on L at frequency i. N_c are multipliers of
    the additional bounds, called cuts, see :class:`.Cuts`. Cut c bounds a norm of G_c = F_c + T_c L
    by b_c. A change of the coefficients of L changes M_i, L_i and G_c by dM_i, dL_i and dG_c.
    Suppose that every such change fulfils

        sum_i Re tr(U_i^H dM_i) + Re tr(V_i^H dL_i) + sum_c Re tr(N_c^H dG_c) = 0.

    Then all filters that meet the bounds fulfil

        sum_i Re tr(U_i^H Q_i) + sum_c Re tr(N_c^H F_c)
            = sum_i Re tr(U_i^H M_i) + Re tr(V_i^H L_i) + sum_c Re tr(N_c^H G_c)
            <= sum_i |U_i| sigma_max(M_i) + sum_i |W^-1 V_i| + sum_c nu(N_c) b_c

    where |.| are nuclear norms and W is :attr:`.Problem.L_bound`. The norm nu, see
    :func:`dual_norm`, is dual to the norm of G_c that the cut bounds.

    If the objective is the sum (39), |U_i| may exceed the weight of sigma_max(M_i) in the
    objective. The lower bound is then reduced by M_max times the sum of all excesses and all
    nu(N_c). If the objective is the peak (45), sigma_max(M_i) and b_c are no larger than the
    objective itself.

    The function first projects the multipliers onto the space of all multipliers that fulfil the
    condition. The bound therefore holds up to rounding for any multipliers. A coefficient of L_jk
    acts on column k of M, L and G only. The columns are therefore projected one by one. If V is
    None, the bound on L is not used. If `cuts` is None, no cuts are used.
    """
    parts = _parts(problem, U, V, cuts)
    U, *others = multipliers = _projected(problem, parts)

    bound = sum((N.conj() * F).real.sum() for N, (F, *_) in zip(multipliers, parts, strict=True))
    norms, dual = _nuclear_norms(U), 0.0
    if V is not None:
        bound -= _nuclear_norms(others[0]).sum()
    if cuts is not None:
        dual = dual_norm(others[-1]).sum()
    if problem.objective.kind == "peak":
        bound /= norms.sum() + dual
    else:
        excess = np.maximum(norms - problem.objective.weights, 0).sum() + dual
        bound -= problem.M_max * excess
    return max(0.0, float(bound))  # because the objective is never negative


def _parts(problem, U, V, cuts):
    """Return F, T, the multipliers N and the frequency indices for each bound on G = F + T L.

    If L = B K, T contains B, so that G = F + T K.
    """
    every = np.arange(len(problem.omega))
    F, T = problem.affine(0, every, None)
    parts = [(F, T, U, every)]
    if V is not None:  # in units of the bound, so that W L has a size near one
        W = problem.L_bound
        parts.append((0 * W, W, np.linalg.solve(W, V), every))
    if cuts is not None:
        F, T = problem.affine(cuts.plant, cuts.frequency, problem.radius)
        nonzero = (np.abs(T) + np.abs(F)).max(axis=2, keepdims=True) > 0
        parts.append((F, T, cuts.N * nonzero, cuts.frequency))
    return parts


def _projected(problem, parts):
    """Make the multipliers N of parts (F, T, N, at) orthogonal to all changes of L."""
    m, shapes = problem.channels, [T.shape for _, T, _, _ in parts]
    T = np.concatenate([T.reshape(-1, m) for _, T, _, _ in parts])
    N = np.concatenate([N.reshape(-1, m) for _, _, N, _ in parts], dtype=complex)
    at = np.concatenate([np.repeat(at, T.shape[1]) for _, T, _, at in parts])
    # The coefficients of a column of L act on all of its rows, or on the diagonal entry only.
    columns = [range(m)] if problem.structure == "full" else [[k] for k in range(m)]
    for column in columns:
        changes = _changes(T[:, column], problem.response.angles[at], problem.order)
        rows = _rows(N[:, column])
        for _ in range(2):  # a second pass removes what rounding has put back
            rows -= (rows @ changes.T) @ changes
        N[:, column] = rows.view(complex).T
    ends = np.cumsum([np.prod(shape[:2]) for shape in shapes])
    return [
        piece.reshape(shape) for piece, shape in zip(np.split(N, ends[:-1]), shapes, strict=True)
    ]


def _nuclear_norms(N):
    """Return the nuclear norm of each matrix."""
    return np.linalg.svdvals(N).sum(axis=1)


def dual_norm(N) -> np.ndarray:
    """Return upper bounds on the dual norm nu(N) of each matrix N, shape (c,).

    nu(N) is the largest Re tr(N^H G) over all G that are bounded by one.

    If the plants have no radius, nu is the nuclear norm. With a radius, G = [G_1; G_2] is bounded
    by one if positive shares d_1 + d_2 = 1 exist with sum_k G_k^H G_k / d_k <= I. N_1 and N_2 are
    the parts of N that belong to G_1 and G_2. Then, for all X > 0 and c_k = tr(N_k X^-1 N_k^H),

        Re tr(N^H G) <= sum_k sqrt(c_k tr(G_k X G_k^H))
                     <= sqrt(sum_k c_k d_k) sqrt(sum_k tr(G_k X G_k^H) / d_k)
                     <= sqrt(max c_k) sqrt(tr X),

    by the inequality of Cauchy and Schwarz, applied twice. Now weight the two parts of N by the
    square roots of shares w_1 and w_2 with w_1 + w_2 = 1. The least of the bounds over X equals the
    largest nuclear norm of the weighted N over all shares w. This bound belongs to
    X = (sum_k w_k N_k^H N_k)^(1/2). The trace of X is concave in w_1, with the slope
    (c_1 - c_2) / 2, so that the best w is found by bisection. Any w gives a valid bound.
    """
    count, rows, m = N.shape
    if rows == m:
        return _nuclear_norms(N)
    size = np.linalg.matrix_norm(N)
    N = (N / np.where(size > 0, size, 1)[:, None, None]).reshape(count, 2, m, m)
    low, high = np.full((2, count), [[-MOST_UNEQUAL], [MOST_UNEQUAL]])
    for _ in range(HALVINGS):
        t = (low + high) / 2
        c, trace = _costs(N, t)
        rises = c[0] > c[1]
        low, high = np.where(rises, t, low), np.where(rises, high, t)
    return size * np.sqrt(c.max(axis=0) * trace)


def _costs(N, t):
    """Return c_1, c_2 and the trace of X of `dual_norm`, for w_1 = 1 / (1 + exp(-t))."""
    weights = expit(np.stack([t, -t]).T)
    floor = np.zeros_like(N[:, :1]) + FAINT * np.eye(N.shape[-1])
    parts = [np.sqrt(weights)[..., None, None] * N, floor]
    stacked = np.concatenate(parts, axis=1).reshape(len(N), -1, N.shape[-1])
    _, s, B = np.linalg.svd(stacked, full_matrices=False)  # X is B^H diag(s) B
    in_basis = N @ B.conj().mT[:, None]
    c = (np.abs(in_basis) ** 2 / s[:, None, None]).sum(axis=(2, 3))
    return c.T, s.sum(axis=1)


def _changes(T, angles, order):
    """Return orthonormal rows that span all changes of T L that coefficients of L can cause."""
    # The powers of z are nearly dependent at low frequencies. Arnoldi's process avoids these
    # powers. It multiplies the last rows by z - 1 and makes the result orthogonal to all earlier
    # rows. The resulting rows span the same space, and doubles represent them accurately enough.
    rows = _rows(T * np.exp(1j * angles)[:, None])
    step = np.expm1(1j * angles)
    basis = np.empty((0, rows.shape[1]))
    for _ in range(order):
        for _ in range(2):
            rows = np.linalg.qr((rows - (rows @ basis.T) @ basis).T)[0].T
        basis = np.vstack([basis, rows])
        rows = (np.ascontiguousarray(rows).view(complex) * step).view(float)
    return basis


def _rows(X):
    """Return each column of X as one real row, in which real and imaginary parts alternate."""
    return np.ascontiguousarray(X.T, dtype=complex).view(float)
