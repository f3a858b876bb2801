"""A bound on a largest singular value: its value, its derivatives, its dual, its worst case.

There are two kinds, and one class for both. The plain one is sigma_max(G) <= b, with G = F + T L.
The other holds for all plants within a radius. If M changes to M + sum_k e_k g_k with vectors e_k
of length one and unknown sizes |g_k| <= 1 times the rows of a matrix H, the worst case is at most b
if numbers d exist such that

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = [M; H],    Lambda = diag(b - d, d),

where d is subtracted in the rows of M that it concerns, and stands in its own rows of H. This is
the S-procedure; for a radius of the norm, where there is a single d, it is exact, and entry by
entry sufficient [1]. With given shares d = b split it is a plain bound again, on
Lambda(split)^(-1/2) G, so that the smallest b is the minimum of that over the split.

Arrays have the frequency last, so that an operation on all the small matrices is a few operations
on long vectors: for m = 2 several times faster than a call of LAPACK for each.

[1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and
    Control Theory, 1994, 2.6.3 and 4.3.
"""

from dataclasses import dataclass, replace

import numpy as np

from rodlib.ilc.problem import largest_singular_values

INSIDE = 0.05  # share of b that a first split leaves to the rows of M, and to those below


@dataclass(frozen=True)
class Expansion:
    """The value of a bound at the columns `at`, to second order.

    It changes by gradient dx + |curvature dx|^2 / 2; `N` is its derivative with respect to G.
    """

    at: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    N: np.ndarray


@dataclass(frozen=True)
class Bound:
    """A bound on G = F + T L, at some frequencies, for a q x q part L of the filter.

    Attributes
    ----------
    F, T : ndarray, shape (p, q, c)
    entries, rows, cols : ndarray of int
        The entries `entries` of the filter stand at `rows`, `cols` of L; the others are zero.
    at : ndarray of int, shape (c,), or slice
        Frequency of each column.
    limit : int
        Which of the program's limits it has: that of what is minimised (0), or the other (1).
    C : ndarray, shape (p, k)
        Lambda = diag(b + C d) in the rows of M, and diag(C d) in those below; k = 0 if plain.
    plant : ndarray of int, shape (c,), or None
        Number of the plant of each column; None for the nominal M and for L.
    """

    F: np.ndarray
    T: np.ndarray
    entries: np.ndarray
    rows: np.ndarray
    cols: np.ndarray
    at: np.ndarray | slice
    limit: int = 0
    C: np.ndarray | None = None
    plant: np.ndarray | None = None

    @property
    def shape(self):
        """p, q, c."""
        return self.F.shape

    @property
    def splits(self):
        """How many numbers d there are."""
        return 0 if self.C is None else self.C.shape[1]

    @property
    def of_b(self):
        """1 for the rows of Lambda that b stands in, 0 for the others; shape (p,)."""
        return np.ones(len(self.F)) if self.C is None else (self.C.max(axis=1) <= 0).astype(float)

    def columns(self, at):
        """The bound at some of its columns only."""
        frequency = np.arange(self.shape[2]) if isinstance(self.at, slice) else self.at
        some = {"F": self.F[..., at], "T": self.T[..., at], "at": frequency[at]}
        return replace(self, **some, plant=None if self.plant is None else self.plant[at])

    def diagonal(self, b, d):
        """Lambda, shape (p, c); (1, c) if plain, where it is b I."""
        return b[None] if self.C is None else self.of_b[:, None] * b + self.C @ d

    def response(self, L):
        """T L, given all entries of the filter, shape (entries, n)."""
        _, q, c = self.shape
        D = np.zeros((self.T.shape[1], q, c), dtype=complex)
        D[self.rows, self.cols] = L[self.entries][:, self.at]
        return product(self.T, D)

    def gradient(self, W):
        """The g with Re tr(W T L) = Re sum g L, shape (entries of the bound, c)."""
        return product(W, self.T)[self.cols, self.rows]

    def spread(self, g, out):
        """Add numbers for each of the bound's entries and columns to those of the filter."""
        if isinstance(self.at, slice):
            out[self.entries] += g
        else:  # a frequency may occur more than once
            np.add.at(out, (self.entries[:, None], self.at), g)

    def matrices(self, L):
        """G, given all entries of the filter."""
        return self.F + self.response(L)

    def first_split(self, G):
        """A split for G, shape (k, c), that leaves a positive share to each row of Lambda."""
        if self.C is None:
            return np.zeros((0, G.shape[-1]))
        m = int(self.of_b.sum())
        rows = np.sqrt((np.abs(G) ** 2).sum(axis=1))
        below = np.maximum(self.C[m:], 0).T @ rows[m:] ** 2
        above = np.sqrt((rows[:m] ** 2).sum(axis=0))
        share = np.sqrt(below) + INSIDE * (above + 1e-300)
        taken = (-self.C[:m] @ share).max(axis=0)  # in the row that has least left
        return share / (above + (1 + INSIDE) * taken)

    def value(self, G, split=None):
        """The smallest b for G with this split, at each column: the largest singular value."""
        if self.C is None:
            return largest_singular_values(np.moveaxis(G, -1, 0))
        scaled = G / np.sqrt(self.diagonal(np.ones(G.shape[-1]), split))[:, None]
        return largest_singular_values(np.moveaxis(scaled, -1, 0))

    def dual(self, N, split=None):
        """The largest Re tr(N^H G) with a value of G of one or less: a nuclear norm."""
        if self.splits:
            N = N * np.sqrt(self.diagonal(np.ones(N.shape[-1]), split))[:, None]
        return np.linalg.norm(np.moveaxis(N, -1, 0), "nuc", axis=(1, 2))

    def linear(self, basis):
        """T L for each unknown of L = x basis by itself, shape (p, q, c, entries, order)."""
        A = np.zeros((*self.shape, self.entries.max() + 1, len(basis)), dtype=complex)
        for e, r, c in zip(self.entries, self.rows, self.cols, strict=True):
            A[:, c, :, e] = self.T[:, r, :, None] * basis[:, self.at].T
        return A

    def _second_order(self, G, split):
        """sigma of Lambda^(-1/2) G to second order in L and the split, in real numbers.

        Returns sigma, its derivative with respect to G, the gradient, and the second derivatives as
        the sum of R'R and H. Unknowns are the real parts of the bound's entries of L, then the
        imaginary ones, then the split.
        """
        c, k = G.shape[-1], self.splits
        root = np.sqrt(self.diagonal(np.ones(c), split)) if k else np.ones((1, c))
        scaled = np.moveaxis(G / root[:, None], -1, 0)
        U, s, Vh = np.linalg.svd(scaled)
        V = Vh.conj().swapaxes(1, 2)
        left = U.conj().swapaxes(1, 2) @ np.moveaxis(self.T / root[:, None], -1, 0)
        share = self.C / (root.T**2)[:, :, None] if k else np.zeros((c, len(G), 0))
        q = V.shape[1]

        def form(i, j):
            """u_i^H dG v_j, where G is the scaled one: linear in entries of L and split."""
            of_L = left[:, i, self.rows] * V[:, self.cols, j]
            rotated = U[:, :, i].conj() * U[:, :, j] * s[:, j, None]
            return of_L, -0.5 * np.einsum("cr,crk->ck", rotated, share)

        def real(form):
            of_L, of_split = form
            return np.concatenate([of_L.real, -of_L.imag, of_split.real], axis=1)

        def imag(form):
            of_L, of_split = form
            return np.concatenate([of_L.imag, of_L.real, of_split.imag], axis=1)

        first = form(0, 0)
        size = np.maximum(s[:, 0], 1e-12)  # where Q is zero, M and all its derivatives are
        rows = [imag(first) / np.sqrt(size)[:, None]]
        for j in range(1, U.shape[1]):
            alpha = form(j, 0)
            beta = form(0, j) if j < q else None
            other = s[:, j] if j < q else 0.0
            apart = np.maximum(s[:, 0] - other, 1e-9 * size)
            for sign, distance in ((1, apart), (-1, size + other)):
                re, im = real(alpha), imag(alpha)
                if beta is not None:
                    re, im = re + sign * real(beta), im - sign * imag(beta)
                rows += [x / np.sqrt(2 * distance)[:, None] for x in (re, im)]
        R, H = np.stack(rows, axis=1), 0.0
        if k:
            H = np.zeros((c, R.shape[2], R.shape[2]))
            weight = np.abs(U[:, :, 0]) ** 2 * s[:, :1]
            H[:, -k:, -k:] = 0.75 * np.einsum("cr,crk,crl->ckl", weight, share, share)
            scaled_T = np.moveaxis(self.T / root[:, None], -1, 0)
            row = U[:, :, :1].conj() * scaled_T[:, :, self.rows] * V[:, None, self.cols, 0]
            cross = -0.5 * np.einsum("crk,cre->cke", share, row)
            cross = np.concatenate([cross.real, -cross.imag], axis=2)
            H[:, -k:, :-k], H[:, :-k, -k:] = cross, cross.swapaxes(1, 2)
        N = U[:, :, :1] * Vh[:, :1] / root.T[:, :, None]
        return s[:, 0], np.moveaxis(N, 0, -1), real(first), R, H

    def tighten(self, G, split, level):
        """The split that makes the value smallest, by Newton's method, and that value.

        Only where the value is above the level; elsewhere they stay as they are.
        """
        value, split, k = self.value(G, split), split.copy(), self.splits
        active = np.flatnonzero(value > level) if k else np.array([], dtype=int)
        for _ in range(30):
            if not active.size:
                break
            some = self.columns(active)
            _, _, g, R, H = some._second_order(G[..., active], split[:, active])
            g, R = g[:, -k:], R[..., -k:]
            H = H[:, -k:, -k:] + R.swapaxes(1, 2) @ R
            d = -_solve(H, g[..., None])[..., 0].T
            before = self.diagonal(np.ones(len(active)), split[:, active])
            into_wall = (-self.C @ d) / before
            d *= np.minimum(1, 0.9 / np.maximum(into_wall.max(axis=0), 1e-300))
            gain = -(g.T * d).sum(axis=0)
            for _ in range(6):
                new = split[:, active] + d
                there = some.value(G[..., active], new)
                better = there < value[active]
                split[:, active[better]], value[active[better]] = new[:, better], there[better]
                d = np.where(better, 0, d / 4)
                if better.all():
                    break
            active = active[gain > 1e-13 * value[active]]
        return split, value

    def expand(self, G, split, at, basis, count):
        """The value to second order at the matrices G, at the columns `at`.

        The split follows so that it stays the best. `basis` and the number `count` of the filter's
        entries say what the unknowns are.
        """
        some = self.columns(at)
        k, e = self.splits, len(self.entries)
        value, N, g, R, H = some._second_order(G[..., at], split[:, at] if k else None)
        if k:
            H = H + R.swapaxes(1, 2) @ R
            right = np.concatenate([H[:, -k:, :-k], g[:, -k:, None]], axis=2)
            follow = _solve(H[:, -k:, -k:], right)
            g = g[:, :-k] - np.einsum("ckx,ck->cx", H[:, -k:, :-k], follow[..., -1])
            w, X = np.linalg.eigh(H[:, :-k, :-k] - H[:, :-k, -k:] @ follow[..., :-1])
            R = np.sqrt(np.maximum(w, 0))[:, :, None] * X.swapaxes(1, 2)
        phi = basis[:, some.at]

        def in_unknowns(a):
            """From real and imaginary parts of the entries to all unknowns."""
            whole = np.zeros((*a.shape[:2], count, len(basis)))
            whole[:, :, self.entries] = (
                a[:, :, 0, :, None] * phi.real.T[:, None, None]
                + a[:, :, 1, :, None] * phi.imag.T[:, None, None]
            )
            return whole.reshape(*a.shape[:2], count * len(basis))

        gradient = in_unknowns(g.reshape(len(at), 1, 2, e))[:, 0]
        return Expansion(at, value, gradient, in_unknowns(R.reshape(len(at), R.shape[1], 2, e)), N)


def _solve(H, right):
    """H^-1 right for positive semidefinite matrices, whatever the units of their rows."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("cii->ci", H), 1e-280))[..., None]
    H = H * scale * scale.swapaxes(1, 2) + 1e-14 * np.eye(H.shape[1])
    return scale * np.linalg.solve(H, scale * right)


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
