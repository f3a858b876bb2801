"""The Newton system of the interior-point method, with all but the coefficients eliminated.

The unknowns are x, of which G = F + T L with L = x Phi is made, and the numbers t and d, which
stand in Lambda and b of S. For directions dS_a, dS_b in which S can change, the matrix of the
system is <dS_a, Y dS_b X>; its right-hand side is by how much <dS_a, Y> is not what it must be.

At each column of a bound at most one number belongs to it alone, z: its d, or a t of its own. That
is eliminated there. With its direction a in the diagonal of S, and that of a shared t, e,

    zz = <a, Y a X>,  zt = <a, Y e X>,  tt = <e, Y e X>,  zL = <a, Y dS X>,  tL = <e, Y dS X>,

where dS is the change by an entry of L:

    dz = (r_z - Re(zL . dL) - zt dt) / zz,    (1)

and what remains for t and L has zt zt / zz, zt zL / zz and zL zL / zz subtracted.    (2)
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ilctools.synthesis.solver.bounds import adjoint, product

EPS = np.finfo(float).eps


class Block:
    """One bound: its second derivatives in z, a shared t, and the entries of L, at each column."""

    def __init__(self, program, j, slack, Y, barrier):
        bound = program.bounds[j]
        p, q, _ = bound.F.shape
        self.bound, self.slack, self.Y = bound, slack, Y
        has_t = bound.level < len(program.cost)
        self.own = has_t & (not program.shared)
        self.of_t = np.append(bound.of_b, np.ones(q))
        self.of_z = np.append(bound.of_d, np.zeros(q)) if bound.within_radius else self.of_t
        overlap = (Y * slack.X.conj()).real

        def second(a, b):
            """<a, Y b X> for two directions in the diagonal, (c,)."""
            return np.einsum("i,ijc,j->c", a, overlap, b)

        def mixed(a):
            """<a, Y dS X> for a direction in the diagonal and each entry of L, (e, c)."""
            a = a[:, None]
            W = product(slack.X[p:] * a, Y[:, :p]) + product(Y[p:] * a, slack.X[:, :p])
            return program.of_entries(j, W)

        zz = second(self.of_z, self.of_z) + np.where(self.own, barrier, 0)
        self.inverse = np.where(self.own | bound.within_radius, 1 / zz, 0)
        self.zL = mixed(self.of_z)
        self.shared = has_t & program.shared
        zt = self.shared * second(self.of_z, self.of_t)
        self.shift = self.inverse * zt
        self.tt = self.shared @ second(self.of_t, self.of_t) - zt @ self.shift  # (2)
        self.tL = self.shared * mixed(self.of_t) - self.shift * self.zL

    def forms(self, program, j, k):
        """Forms A, Hermitian, and B, symmetric, in pairs j, k of entries of L, (pairs, c).

        In terms of D, the off-diagonal block of dS, <dS, Y dS' X> is the real part of

            tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)).
        """
        X, Y, T = self.slack.X, self.Y, self.bound.T
        p = len(T)
        X22, Y22 = X[p:, p:], Y[p:, p:]
        X21, Y21 = (product(S[p:, :p], T) for S in (X, Y))
        X11, Y11 = (product(adjoint(T), product(S[:p, :p], T)) for S in (X, Y))
        row, col = program.rows[j], program.cols[j]
        row_k, col_k = program.rows[k], program.cols[k]
        A = Y11[row, row_k] * X22[col_k, col] + X11[row, row_k] * Y22[col_k, col]
        B = Y21[col, row_k] * X21[col_k, row] + X21[col, row_k] * Y21[col_k, row]
        follow = 0.5 * self.inverse * self.zL[k]
        return A - self.zL[j].conj() * follow, B - self.zL[j] * follow  # (2)


class NewtonSystem:
    """The system at a point, factorised; `barrier` is the second derivative of that of each t.

    A LinAlgError where the bounds leave less room than rounding takes.
    """

    def __init__(self, program, slacks, Y, barrier):
        self.program = program
        at_columns = program.at_columns(barrier, [0, 0])
        self.blocks = [
            Block(program, j, slacks[j], Y[j], at_columns[j]) for j in range(len(program.bounds))
        ]
        tL = program.onto_x([block.tL for block in self.blocks]).ravel()
        tt = sum(block.tt for block in self.blocks) + (barrier[0] if program.shared else 1)
        H = np.block([[np.array([[tt]]), tL[None]], [tL[:, None], self._of_x()]])
        if not np.isfinite(H).all() or np.diag(H).max() <= 0:
            raise np.linalg.LinAlgError("the bounds leave less room than rounding takes")
        self.scale = 1 / np.sqrt(np.maximum(np.diag(H), EPS * np.diag(H).max()))
        self.factor = factorised(self.scale[:, None] * H * self.scale)

    def _of_x(self):
        """sum <dS_a, Y dS_b X> for all pairs of coefficients, z eliminated."""
        program = self.program
        E, order = len(program.rows), len(program.basis)
        j, k = np.triu_indices(E)
        A, B = 0, 0
        for block, incidence in zip(self.blocks, program.incidence, strict=True):
            of_A, of_B = block.forms(program, j, k)
            A, B = A + of_A @ incidence, B + of_B @ incidence
        H, conjugate = np.empty((E, order, E, order)), program.basis.conj()
        for row, col, a, b in zip(k, j, A, B, strict=True):
            # Re phi_k (A phi_l^* + B phi_l), summed over the frequencies
            sums = as_real(conjugate) @ as_real(a * conjugate + b * program.basis).T
            H[row, :, col], H[col, :, row] = sums, sums.T
        return H.reshape(E * order, -1)

    def solve(self, r_x, Y, eta):
        """The changes of x, of t and of each d for multipliers Y, eta; r_x: their residual in x."""
        program, blocks = self.program, self.blocks
        of_t = program.cost + eta
        r_t, r_z, follow = -of_t[0] if program.shared else 0.0, [], []
        for block, Y_j, of_own in zip(blocks, Y, program.at_columns(of_t, [0, 0]), strict=True):
            diagonal = np.einsum("iin->in", Y_j).real
            r = block.of_z @ diagonal - block.own * of_own
            r_t += block.of_t @ diagonal @ block.shared - block.shift @ r
            r_z.append(r)
            follow.append(block.zL * block.inverse * r)
        residual = np.append(r_t, r_x - program.onto_x(follow))
        changes = self.scale * cho_solve(self.factor, self.scale * residual)
        dt, dx = np.full(len(eta), changes[0]), changes[1:].reshape(r_x.shape)
        dL, dd = dx @ program.basis, []
        for block, r in zip(blocks, r_z, strict=True):
            of_L = (block.zL * dL[:, block.bound.at]).real.sum(axis=0)
            dz = block.inverse * (r - of_L) - block.shift * changes[0]  # (1)
            dd.append(dz * block.bound.within_radius)
            dt[block.bound.level[block.own]] = dz[block.own]
        return dx, dt, dd


def as_real(A):
    """Real and imaginary parts in turn, (..., 2 n)."""
    return np.ascontiguousarray(A).view(float)


def factorised(H):
    """Cholesky factor of a matrix with ones on the diagonal, shifted if it must be."""
    shift = 1e-15
    while True:
        try:
            return cho_factor(H + shift * np.eye(len(H)))
        except np.linalg.LinAlgError:
            shift *= 10
