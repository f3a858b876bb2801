"""The Newton system of the interior-point method, with all but the coefficients eliminated.

The unknowns of `interior_point` are the coefficients x, and t and d, which stand in Lambda and b of
single inequalities. For directions dS_a, dS_b in which S can change, the matrix of the system is
<dS_a, Y dS_b X>. What belongs to a single inequality is eliminated first; in terms of the entries
of L at each frequency that leaves a Hermitian form and a symmetric one.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ilctools.synthesis.solver.bounds import add_columns, adjoint, product
from ilctools.synthesis.solver.inequalities import EPS, cholesky, trace


class Local:
    """One bound: its second derivatives in d, t and L, and what is eliminated at each column.

    That is d, a t of its own, or nothing; `inner` is its direction in the diagonal of S, or None.
    """

    def __init__(self, program, j, slack, Y, barrier):
        self.bound = bound = program.bounds[j]
        self.columns = program.has_t(j)
        p, q, c = bound.shape
        has_t = len(self.columns) > 0
        self.shared = program.shared and has_t
        self.own_t = has_t and not program.shared
        self.cost, self.of_t = program.cost, np.append(bound.of_b, np.ones(q))
        self.inner = self.of_t if self.own_t else None
        if bound.splits:
            self.inner = np.append(bound.of_d, np.zeros(q))
        overlap = (Y * slack.X.conj()).real

        def second(a, b):
            """Second derivatives along two directions in the diagonal, (c,)."""
            return np.tensordot(np.outer(a, b), overlap)

        def mixed(a):
            """Those along a direction in the diagonal and each entry of L, (entries, c)."""
            a = a[:, None]
            W = product(slack.X[p:] * a, Y[:, :p]) + product(Y[p:] * a, slack.X[:, :p])
            return bound.gradient(W)

        self.inverse, self.g = np.zeros(c), np.zeros((len(bound.entries), c))
        if self.inner is not None:
            Z, self.g = second(self.inner, self.inner), mixed(self.inner)
            here = np.arange(c) if bound.splits else self.columns
            self.inverse[here] = 1 / (Z[here] + (barrier if self.own_t else 0))
        # how what is eliminated follows the entries of L, and a t that several bounds share
        self.follow, self.shift = self.inverse * self.g, 0 * self.inverse
        if self.shared:
            self.tt, self.xt = second(self.of_t, self.of_t).sum(), mixed(self.of_t)
            if self.inner is not None:
                cross = second(self.inner, self.of_t)
                self.shift = self.inverse * cross
                self.tt -= cross @ self.shift
                self.xt = self.xt - self.shift * self.g

    def residual(self, Y, eta):
        """By how much Y is not stationary with respect to what is eliminated, and a shared t."""
        diagonal = np.einsum("iin->in", Y).real
        of_inner = np.zeros(len(self.inverse))
        if self.inner is not None:
            of_inner = self.inner @ diagonal
        if self.own_t:
            of_inner[self.columns] -= eta + self.cost
        of_t = (self.of_t @ diagonal).sum() if self.shared else 0.0
        return of_inner, of_t - self.shift @ of_inner

    def step(self, residual, dL, dt):
        """Change of d, and of the bound's own t, that follows."""
        dL = dL[self.bound.entries][:, self.bound.at]
        dz = self.inverse * residual - (self.follow * dL).real.sum(axis=0)
        if self.own_t:
            dt = dz[self.columns]
        elif self.shared:
            dz = dz - self.shift * dt
        return dz[None][: self.bound.splits], dt


def forms(part, slack, Y):
    """Forms A, Hermitian, and B, symmetric, in pairs of entries of L, (pairs, c).

    In terms of D, the off-diagonal block of dS, <dS, Y dS' X> is the real part of

        tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)).
    """
    bound, T = part.bound, part.bound.T
    p = len(bound.F)
    X22, Y22 = slack.X[p:, p:], Y[p:, p:]
    X21, Y21 = (product(S[p:, :p], T) for S in (slack.X, Y))
    X11, Y11 = (product(adjoint(T), product(S[:p, :p], T)) for S in (slack.X, Y))
    j, k = np.triu_indices(len(bound.entries))
    row, row_k, col, col_k = bound.rows[j], bound.rows[k], bound.cols[j], bound.cols[k]
    A = Y11[row, row_k] * X22[col_k, col] + X11[row, row_k] * Y22[col_k, col]
    B = Y21[col, row_k] * X21[col_k, row] + X21[col, row_k] * Y21[col_k, row]
    if part.inner is not None:
        A -= 0.5 * part.g[j].conj() * part.follow[k]
        B -= 0.5 * part.g[j] * part.follow[k]
    return A, B


def normal_matrix(program, slacks, Y, local):
    """sum <dS_j, Y dS_k X> for all pairs of coefficients, with d and own t eliminated."""
    order, n = program.basis.shape
    E = program.entries
    j, k = np.triu_indices(E)
    number = np.zeros((E, E), dtype=int)
    number[j, k] = np.arange(len(j))
    totals = np.zeros((2, len(j), n), dtype=complex)
    for part, slack, Yc in zip(local, slacks, Y, strict=True):
        entries = part.bound.entries
        pairs = number[np.ix_(entries, entries)][np.triu_indices(len(entries))]
        for total, form in zip(totals, forms(part, slack, Yc), strict=True):
            add_columns(total, pairs, part.bound.at, form)
    # Re(A phi_k phi_l^*) + Re(B phi_k phi_l), summed over the frequencies
    sums = sum(
        total.view(float) @ products
        for total, products in zip(totals, program.products, strict=True)
    )
    H = np.empty((E, order, E, order))
    H[k, :, j] = sums.reshape(-1, order, order)
    H[j, :, k] = H[k, :, j].transpose(0, 2, 1)
    return H.reshape(E * order, -1)


def square_root(program, slacks, Y, barrier):
    """Triangular R with R'R the matrix of the Newton system, without forming that matrix.

    It has the square root of its condition number. <dS_j, Y dS_k X> is the scalar product of
    C^H dS_j R and C^H dS_k R, where Y = C C^H and X = R R^H.
    """
    basis, E = program.basis, program.entries
    parts = np.stack([basis.real, basis.imag])
    blocks, everywhere = [], []
    for j, bound in enumerate(program.bounds):
        rows = _eliminated_rows(program, j, slacks[j], Y[j], barrier)
        if isinstance(bound.at, slice):
            missing = basis.shape[1] - len(rows)
            everywhere.append(np.pad(rows, [(0, missing), (0, 0), (0, 0)]))
        else:
            blocks.append((rows, parts[..., bound.at]))
    if everywhere:  # one triangle for each frequency, instead of one for each bound
        rows = np.linalg.qr(np.concatenate(everywhere, axis=1), mode="r")
        blocks.append((rows, parts))
    matrices = []
    for rows, parts_at in blocks:
        of_t, of_L = rows[:, :, :1], rows[:, :, 1:].reshape(*rows.shape[:2], E, 2)
        of_x = np.einsum("crep,pkc->crek", of_L, parts_at)
        columns = [of_t.reshape(-1, 1), of_x.reshape(-1, E * len(basis))]
        matrices.append(np.hstack(columns))
    last = np.zeros((1, 1 + E * len(basis)))
    last[0, 0] = np.sqrt(barrier[0]) if program.shared else 1
    # a shared t is eliminated last
    return np.linalg.qr(np.vstack([*matrices, last]), mode="r")[1:, 1:]


def _eliminated_rows(program, j, slack, Y, barrier):
    """Rows of the square root of one bound at each of its frequencies, (c, rows, 1 + 2 entries).

    Columns are a shared t, then real and imaginary part of each entry of L. The triangular factor
    of one small matrix per inequality eliminates d, and a t of its own.
    """
    bound = program.bounds[j]
    p, q, c = bound.shape
    has_t, one = program.has_t(j), np.ones(c)
    zero = np.zeros((p, q, c), dtype=complex)
    Ch, _ = cholesky(Y, 0.01 * EPS * trace(Y))
    of_t = slack.root(Ch, bound.of_b[:, None] * one, one, zero)
    of_t[..., np.setdiff1d(np.arange(c), has_t)] = 0
    columns = [of_t]
    if bound.splits:
        of_d = slack.root(Ch, bound.of_d[:, None] * one, 0 * one, zero)
        columns = [of_d, of_t]
    t = len(columns) - 1
    for row, col in zip(bound.rows, bound.cols, strict=True):
        for unit in (1, 1j):
            D = zero.copy()
            D[:, col] = unit * bound.T[:, row]
            columns.append(slack.root(Ch, 0 * slack.diagonal, 0 * one, D))
    columns = np.stack(columns, axis=-1)
    columns = np.moveaxis(columns, 2, 0).reshape(c, (p + q) ** 2, -1)
    own = np.zeros((c, 1, columns.shape[2]))
    if not program.shared:
        own[:, 0, t] = 1  # where there is no t, its elimination changes nothing
        if len(has_t):
            own[has_t, 0, t] = np.sqrt(barrier)
    R = np.linalg.qr(np.concatenate([columns.real, columns.imag, own], 1), mode="r")
    first = t if program.shared else t + 1
    R = R[:, first:, first:]
    of_L = (1 + 2 * bound.entries[:, None] + [0, 1]).ravel()
    rows = np.zeros((c, R.shape[1], 1 + 2 * program.entries))
    rows[:, :, np.append(0, of_L) if program.shared else of_L] = R
    return rows


def factorise(program, slacks, Y, barrier, root=False):
    """A function from residuals in x, and Y and eta, to the changes of x, of t, and of each d."""
    # `barrier`: second derivative of that of t <= limit, for each t
    basis, E = program.basis, program.entries
    local = [
        Local(program, j, slack, Yc, barrier)
        for j, (slack, Yc) in enumerate(zip(slacks, Y, strict=True))
    ]

    def onto_x(numbers):
        """Numbers for the entries and columns of each bound, as a vector for the coefficients."""
        total = np.zeros((E, basis.shape[1]), dtype=complex)
        for part, g in zip(local, numbers, strict=True):
            add_columns(total, part.bound.entries, part.bound.at, g)
        return (total @ basis.T).real.ravel()

    xt = tt = None
    if program.shared:
        tt = sum(part.tt for part in local if part.shared) + barrier[0]
        xt = onto_x(part.xt if part.shared else 0 * part.g for part in local)
    if root:
        R = square_root(program, slacks, Y, barrier)
        scale = 1 / np.linalg.norm(R, axis=0)
        # a shift of 1e-30 in the squares
        R = np.linalg.qr(np.vstack([R * scale, 1e-15 * np.eye(len(R))]), mode="r")
        factor = (R, False)
    else:
        H = normal_matrix(program, slacks, Y, local)
        if program.shared:
            H -= np.outer(xt, xt / tt)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), EPS * np.diag(H).max()))
        factor = _factorised(scale[:, None] * H * scale)

    def solve(rx, Y, eta):
        residuals = [part.residual(A, eta) for part, A in zip(local, Y, strict=True)]
        rx = rx - onto_x(part.follow * r for part, (r, _) in zip(local, residuals, strict=True))
        if program.shared:
            rt = sum(r for _, r in residuals) - eta[0] - program.cost[0]
            rx = rx - xt * (rt / tt)
        dx = scale * cho_solve(factor, scale * rx)
        dt = np.array([(rt - dx @ xt) / tt]) if program.shared else None
        dL = dx.reshape(E, -1) @ basis
        dd = []
        for part, (r, _) in zip(local, residuals, strict=True):
            d, dt = part.step(r, dL, dt)
            dd.append(d)
        return dx.reshape(E, -1), dt, dd

    return solve


def _factorised(H):
    """Cholesky factor of a matrix with ones on the diagonal, shifted if it must be."""
    if not np.isfinite(H).all():
        raise RuntimeError("the bounds leave less room than rounding takes")
    shift = 1e-15
    while True:
        try:
            return cho_factor(H + shift * np.eye(len(H)))
        except np.linalg.LinAlgError:
            shift *= 10
