"""The Newton system of the interior-point method, with all but the coefficients eliminated.

The unknowns of `interior_point` are the coefficients x, and t and d,
which stand in Lambda and b of single inequalities. For directions dS_a, dS_b in which S can change,
the matrix of the system is <dS_a, Y dS_b X>. What belongs to a single inequality is eliminated
first; in terms of the entries of L at each frequency that leaves a Hermitian form and a symmetric
one.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rodlib.ilc.synthesis.solver.bounds import adjoint, product
from rodlib.ilc.synthesis.solver.inequalities import EPS, cholesky, trace

CACHED = 2**15  # numbers in a block of columns


class Local:
    """One bound: its second derivatives in d, t and L, and d or a t of its own eliminated."""

    def __init__(self, program, j, slack, Y, barrier):
        bound = program.bounds[j]
        p, q, c = bound.shape
        self.bound, self.has_t, k = bound, program.has_t(j), bound.splits
        self.shared = program.shared and len(self.has_t) > 0
        self.own_t = not program.shared and len(self.has_t) > 0
        directions = np.zeros((k + 1, p + q))
        directions[:k, :p] = bound.of_d
        directions[k, :p], directions[k, p:] = bound.of_b, 1
        if not len(self.has_t):
            directions = directions[:k]
        half = np.tensordot(directions, (Y * slack.X.conj()).real, 1)
        Z = np.tensordot(directions, half, (1, 1))
        g = np.zeros((len(directions), len(bound.entries), c), dtype=complex)
        for z, a in enumerate(directions[..., None]):
            W = product(slack.X[p:] * a, Y[:, :p]) + product(Y[p:] * a, slack.X[:, :p])
            g[z] = bound.gradient(W)
        if self.own_t:
            here = np.zeros(c)
            here[self.has_t] = 1
            g[k], Z[k], Z[:, k] = g[k] * here, Z[k] * here, Z[:, k] * here
            Z[k, k] += 1 - here  # where there is no t, nothing
            Z[k, k, self.has_t] += barrier
        inner = slice(0, k + self.own_t)
        self.inverse, self.g = 1 / Z[inner, inner], g[inner]  # of one number or none
        # how what is eliminated follows the entries of L, and a t that several bounds share
        self.follow = np.einsum("xyc,yec->xec", self.inverse, self.g)
        if self.shared:
            self.shift = np.einsum("xyc,yc->xc", self.inverse, Z[inner, k])
            self.tt = (Z[k, k] - (Z[k, inner] * self.shift).sum(axis=0)).sum()
            self.xt = g[k] - (self.shift[:, None] * self.g).sum(axis=0)

    def residual(self, Y, eta):
        """By how much Y is not stationary with respect to what is eliminated, and a shared t."""
        bound, p = self.bound, len(self.bound.F)
        diagonal = np.einsum("iin->in", Y).real
        of_d = np.tile(bound.of_d, (bound.splits, 1)) @ diagonal[:p]
        if not len(self.has_t):
            return of_d, 0.0
        of_t = bound.of_b @ diagonal[:p] + diagonal[p:].sum(axis=0)
        if self.own_t:
            rest = np.zeros((1, Y.shape[-1]))
            rest[0, self.has_t] = of_t[self.has_t] - eta - 1
            return np.concatenate([of_d, rest]), 0.0
        return of_d, of_t.sum() - (self.shift * of_d).sum()

    def step(self, residual, dL, dt):
        """Change of d, and of the bound's own t, that follows."""
        dL = dL[self.bound.entries][:, self.bound.at]
        dz = np.einsum("xyc,yc->xc", self.inverse, residual)
        dz = dz - (self.follow * dL).real.sum(axis=1)
        if self.shared:
            dz = dz - self.shift * dt
        k = self.bound.splits
        return dz[:k], dz[k][self.has_t] if self.own_t else dt


def normal_matrix(program, slacks, Y, local):
    """sum <dS_j, Y dS_k X> for all pairs of coefficients, with d and own t eliminated."""
    # In terms of D, the off-diagonal block of dS, this is the real part of
    # tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)), that is, a Hermitian form
    # A and a symmetric form B in the entries of L at each frequency.
    basis, E = program.basis, program.entries
    order, n = basis.shape
    pairs = np.array([(j, k) for j in range(E) for k in range(j, E)])
    number = np.zeros((E, E), dtype=int)
    number[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    A, B = np.zeros((2, len(pairs), n), dtype=complex)
    for part, slack, Yc in zip(local, slacks, Y, strict=True):
        bound, T, p = part.bound, part.bound.T, len(part.bound.F)
        (X11, Y11), (X21, Y21), (X22, Y22) = (
            [product(adjoint(T), product(S[:p, :p], T)) for S in (slack.X, Yc)],
            [product(S[p:, :p], T) for S in (slack.X, Yc)],
            [S[p:, p:] for S in (slack.X, Yc)],
        )
        j, k = np.triu_indices(len(bound.entries))
        r, c, rs, cs = bound.rows[j], bound.cols[j], bound.rows[k], bound.cols[k]
        which, columns = number[bound.entries[j], bound.entries[k]], bound.shape[2]
        size = max(32, CACHED // len(which))  # of a block that stays in the cache
        for i in range(0, columns, size):
            some = slice(i, min(i + size, columns))
            x11, y11, x21, y21, x22, y22 = (
                Z[..., some] for Z in (X11, Y11, X21, Y21, X22, Y22)
            )
            a = y11[r, rs] * x22[cs, c] + x11[r, rs] * y22[cs, c]
            b = y21[c, rs] * x21[cs, r] + x21[c, rs] * y21[cs, r]
            for g, follow in zip(
                part.g[..., some], part.follow[..., some], strict=True
            ):
                a -= 0.5 * g[j].conj() * follow[k]
                b -= 0.5 * g[j] * follow[k]
            for form, value in ((A, a), (B, b)):
                if isinstance(bound.at, slice):
                    form[which, some] += value
                else:
                    np.add.at(form, (which[:, None], bound.at[some]), value)
    # Re(A phi_k phi_l^*) + Re(B phi_k phi_l), summed over the frequencies
    sums = sum(
        form.view(float) @ part
        for form, part in zip((A, B), program.products, strict=True)
    )
    H = np.empty((E, order, E, order))
    j, k = pairs.T
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
            part.bound.spread(g, total)
        return (total @ basis.T).real.ravel()

    xt = tt = None
    if program.shared:
        tt = sum(part.tt for part in local if part.shared) + barrier[0]
        xt = onto_x(
            [part.xt if part.shared else 0 * part.bound.T[0, 0] for part in local]
        )
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
        follow = zip(local, residuals, strict=True)
        rx = rx - onto_x(
            [(part.follow * r[:, None]).sum(axis=0) for part, (r, _) in follow]
        )
        if program.shared:
            rt = sum(r for _, r in residuals) - eta[0] - 1
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
