"""A bound on a largest singular value: its value, its derivatives, its dual, its worst case.

Arrays have the frequency last, so that an operation on all the small matrices is a few operations
on long vectors: for m = 2 several times faster than a call of LAPACK for each.
"""

from dataclasses import dataclass

import numpy as np

from rodlib.problem import largest_singular_values


@dataclass(frozen=True)
class Expansion:
    """sigma_max of a bound at the frequencies `at`, to second order.

    It changes by gradient dx + |curvature dx|^2 / 2; `uv` is the outer product of its vectors.
    """

    at: np.ndarray
    sigma: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Bound:
    """sigma_max(G) <= b with G = F + T L at each frequency, for a q x q part L of the filter.

    The entries `entries` of the filter stand at `rows`, `cols` of L; the others are zero.
    """

    F: np.ndarray
    T: np.ndarray
    entries: np.ndarray
    rows: np.ndarray
    cols: np.ndarray

    def response(self, L):
        """T L, given all entries of the filter, shape (entries, n)."""
        D = np.zeros(self.T.shape, dtype=complex)
        D[self.rows, self.cols] = L[self.entries]
        return product(self.T, D)

    def gradient(self, W):
        """The g with Re tr(W T L) = Re sum g L."""
        return product(W, self.T)[self.cols, self.rows]

    def matrices(self, L):
        """G, given all entries of the filter."""
        return self.F + self.response(L)

    def value(self, G):
        """sigma_max(G) at each frequency."""
        return largest_singular_values(np.moveaxis(G, -1, 0))

    def dual(self, N):
        """The nuclear norm, dual to sigma_max: the largest Re tr(N^H G) with sigma_max(G) <= 1."""
        return np.linalg.norm(np.moveaxis(N, -1, 0), "nuc", axis=(1, 2))

    def linear(self, basis):
        """T L for each unknown of L = x basis by itself, shape (q, q, n, entries, order)."""
        A = np.zeros((*self.F.shape, self.entries.max() + 1, len(basis)), dtype=complex)
        for e, r, c in zip(self.entries, self.rows, self.cols, strict=True):
            A[:, c, :, e] = self.T[:, r, :, None] * basis.T
        return A

    def expand(self, G, at, basis, count):
        """sigma_max to second order at the matrices G, at the frequencies `at`.

        `basis` and the number `count` of the filter's entries say what the unknowns are.
        """
        U, s, Vh = np.linalg.svd(np.moveaxis(G[..., at], -1, 0))
        left = U.conj().swapaxes(1, 2) @ np.moveaxis(self.T[..., at], -1, 0)
        V = Vh.conj().swapaxes(1, 2)
        phi = basis[:, None, at].T

        def form(i, j):
            """u_i^H dG v_j, a linear form in the unknowns."""
            entries = np.zeros((len(at), count, len(basis)), dtype=complex)
            entries[:, self.entries] = (left[:, i, self.rows] * V[:, self.cols, j])[..., None] * phi
            return entries.reshape(len(at), count * len(basis))

        first = form(0, 0)
        size = np.maximum(s[:, 0], 1e-12)  # where Q is zero, M and all its derivatives are
        curvature = [first.imag / np.sqrt(size)[:, None]]
        for j in range(1, len(self.T)):
            alpha, beta = form(j, 0), form(0, j).conj()
            apart = np.maximum(s[:, 0] - s[:, j], 1e-9 * size)
            for total, distance in ((alpha + beta, apart), (alpha - beta, size + s[:, j])):
                total /= np.sqrt(2 * distance)[:, None]
                curvature += [total.real, total.imag]
        uv = U[:, :, :1] * Vh[:, :1]
        return Expansion(at, s[:, 0], first.real, np.stack(curvature, axis=1), uv)


def product(A, B):
    """A B at each frequency."""
    if A.shape[0] * B.shape[1] > 36:  # large enough for BLAS
        return np.matmul(A, B, axes=[(0, 1)] * 3)
    C = A[:, 0, None] * B[0]
    for j in range(1, len(B)):
        C += A[:, j, None] * B[j]
    return C


def adjoint(A):
    return A.conj().swapaxes(0, 1)
