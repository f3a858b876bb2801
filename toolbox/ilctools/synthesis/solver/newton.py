"""The Newton system of the interior-point method, reduced to the coefficients by elimination.

The notation is that of `interior_point`. The unknowns are the coefficients x, with G = F + T L and
L = x Phi, and the numbers t and d in Lambda and b of S. Each unknown changes S in a direction. For
two such directions dS_a and dS_b, the entry of the matrix of the system is <dS_a, Y dS_b X>. The
right-hand side is the difference between <dS_a, Y> and the value that stationarity requires.

Each column of a bound, which is one of its frequencies, has at most one unknown z that occurs in no
other column. This z is the d of the column, or a t that belongs to this column alone. A t that
occurs in many columns is called shared. Each z is eliminated at its column. Let a be the direction
of z in the diagonal of S, and e the direction of a shared t. Then

    zz = <a, Y a X>,  zt = <a, Y e X>,  tt = <e, Y e X>,  zL = <a, Y dS X>,  tL = <e, Y dS X>,

where dS is the change of S by an entry of L. If r_z is the right-hand side for z, the change of z
is

    dz = (r_z - Re(zL . dL) - zt dt) / zz,    (1)

The elimination of z subtracts zt zt / zz, zt zL / zz and zL zL / zz from the entries of the matrix
that remain for t and L.    (2)
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ilctools.synthesis.solver.inequalities import adjoint, product

EPS = np.finfo(float).eps


class Block:
    """The contribution of one bound to the system, for z, a shared t and the entries of L."""

    def __init__(self, program, bound, X, Y, barrier):
        self.program, self.bound, self.X, self.Y = program, bound, X, Y
        has_t = bound.level < len(program.cost)
        self.has_shared_t, self.has_own_t = has_t & program.shared, has_t & (not program.shared)
        self.along_t = bound.along_b
        self.along_z = bound.along_d if bound.within_radius else bound.along_b
        self._eliminate_z(barrier)

    def _eliminate_z(self, barrier):
        """Compute the terms of (1), and tt and tL after the elimination of z by (2)."""
        z, t = self.along_z, self.along_t
        zz = self._second(z, z) + np.where(self.has_own_t, barrier, 0)
        zt = self.has_shared_t * self._second(z, t)
        self.zL = self._mixed(z)
        has_z = self.has_own_t | self.bound.within_radius
        self.inverse_zz = np.where(has_z, 1 / zz, 0)
        self.zt_by_zz = zt * self.inverse_zz
        self.tt = self.has_shared_t @ self._second(t, t) - zt @ self.zt_by_zz  # (2)
        self.tL = self.has_shared_t * self._mixed(t) - self.zt_by_zz * self.zL  # (2)

    def _second(self, a, b):
        """Compute <a, Y b X> at each column for two directions in the diagonal of S, (c,)."""
        return np.einsum("i,ijc,j->c", a, (self.Y * self.X.conj()).real, b)

    def _mixed(self, a):
        """Compute <a, Y dS X> for a direction in the diagonal of S and each entry of L, (e, c)."""
        X, Y, a, p = self.X, self.Y, a[:, None], len(self.bound.F)
        W = product(X[p:] * a, Y[:, :p]) + product(Y[p:] * a, X[:, :p])
        return self.program.of_entries(self.bound, W)

    def forms(self, j, k):
        """Compute the Hermitian form A and the symmetric form B for pairs of entries, (pairs, c).

        j and k number the entries of L in each pair. D and D' are the off-diagonal blocks of dS and
        dS'. The entry <dS, Y dS' X> of the matrix is the real part of

            tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)).
        """
        X, Y, T = self.X, self.Y, self.bound.T
        p = len(T)
        X22, Y22 = X[p:, p:], Y[p:, p:]
        X21, Y21 = (product(S[p:, :p], T) for S in (X, Y))
        X11, Y11 = (product(adjoint(T), product(S[:p, :p], T)) for S in (X, Y))
        rows, cols = self.program.rows, self.program.cols
        row, col, row_k, col_k = rows[j], cols[j], rows[k], cols[k]
        A = Y11[row, row_k] * X22[col_k, col] + X11[row, row_k] * Y22[col_k, col]
        B = Y21[col, row_k] * X21[col_k, row] + X21[col, row_k] * Y21[col_k, row]
        follows_z = 0.5 * self.inverse_zz * self.zL[k]
        return A - self.zL[j].conj() * follows_z, B - self.zL[j] * follows_z  # (2)

    def residuals(self, Y, of_own_t):
        """Compute the right-hand sides: r_z at each column, and r_t of a shared t without z.

        Y are the multipliers of the bound. `of_own_t` is the value that stationarity requires at
        each column with its own t.
        """
        diagonal = np.einsum("iin->in", Y).real
        r_z = self.along_z @ diagonal - self.has_own_t * of_own_t
        r_t = self.along_t @ diagonal @ self.has_shared_t - self.zt_by_zz @ r_z
        return r_z, r_t

    def change_of_z(self, r_z, dt, dL):
        """Compute dz by (1) from the changes of a shared t and of the entries of L."""
        of_L = (self.zL * dL[:, self.bound.at]).real.sum(axis=0)
        return self.inverse_zz * (r_z - of_L) - self.zt_by_zz * dt


class NewtonSystem:
    """The factorised Newton system at a point.

    `barrier` is eta / (limit - t), which the limit of each t adds to the entry of this t in the
    matrix. If the feasible set is smaller than rounding, a LinAlgError is raised.
    """

    def __init__(self, program, X, Y, barrier):
        self.program = program
        columns = zip(program.bounds, X, Y, program.at_own_t(barrier), strict=True)
        self.blocks = [Block(program, *each) for each in columns]
        tL = program.onto_x([block.tL for block in self.blocks]).ravel()
        tt = sum(block.tt for block in self.blocks) + (barrier[0] if program.shared else 1)
        H = np.block([[np.array([[tt]]), tL[None]], [tL[:, None], self._of_x()]])
        if not np.isfinite(H).all() or np.diag(H).max() <= 0:
            raise np.linalg.LinAlgError("rounding is larger than the room that the bounds leave")
        self.scale = 1 / np.sqrt(np.maximum(np.diag(H), EPS * np.diag(H).max()))
        self.factor = factorised(self.scale[:, None] * H * self.scale)

    def _of_x(self):
        """Compute sum <dS_a, Y dS_b X> for all pairs of coefficients, with z eliminated."""
        program = self.program
        E, order = len(program.rows), len(program.basis)
        j, k = np.triu_indices(E)
        A, B = 0, 0
        for block, incidence in zip(self.blocks, program.incidence, strict=True):
            of_A, of_B = block.forms(j, k)
            A, B = A + of_A @ incidence, B + of_B @ incidence
        H, conjugate = np.empty((E, order, E, order)), program.basis.conj()
        for row, col, a, b in zip(k, j, A, B, strict=True):
            # Re phi_k (A phi_l^* + B phi_l), summed over the frequencies
            sums = as_real(conjugate) @ as_real(a * conjugate + b * program.basis).T
            H[row, :, col], H[col, :, row] = sums, sums.T
        return H.reshape(E * order, -1)

    def solve(self, r_x, Y, eta):
        """Compute the changes of x, of t and of each d for given multipliers Y and eta.

        r_x is the residual of stationarity with respect to x.
        """
        program, blocks = self.program, self.blocks
        of_t = program.cost + eta
        columns = zip(blocks, Y, program.at_own_t(of_t), strict=True)
        r_z, of_shared = zip(*(block.residuals(*known) for block, *known in columns), strict=True)
        r_t = sum(of_shared) - (of_t[0] if program.shared else 0)
        pairs = [*zip(blocks, r_z, strict=True)]
        r_x = r_x - program.onto_x([block.zL * block.inverse_zz * r for block, r in pairs])
        residual = np.append(r_t, r_x)
        shared, *changes = self.scale * cho_solve(self.factor, self.scale * residual)

        dx, dt, dd = np.reshape(changes, r_x.shape), np.full(len(eta), shared), []
        dL = dx @ program.basis
        for block, r in pairs:
            dz = block.change_of_z(r, shared, dL)  # (1)
            dd.append(dz * block.bound.within_radius)
            dt[block.bound.level[block.has_own_t]] = dz[block.has_own_t]
        return dx, dt, dd


def as_real(A):
    """Return real and imaginary parts in turn along the last axis, (..., 2 n)."""
    return np.ascontiguousarray(A).view(float)


def factorised(H):
    """Factorise a matrix with ones on its diagonal by Cholesky.

    A small multiple of the identity is added, which is raised until the factorisation succeeds.
    """
    shift = 1e-15
    while True:
        try:
            return cho_factor(H + shift * np.eye(len(H)))
        except np.linalg.LinAlgError:
            shift *= 10
