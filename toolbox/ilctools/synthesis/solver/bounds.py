"""A bound on a largest singular value: its value, its derivatives, its dual, its worst case.

There are two kinds, and one class for both. The plain one is sigma_max(G) <= b, with G = F + T L.
The other holds for all plants within a radius: sigma_max(M + E H) <= b for every E of norm one or
less. That is so if and only if a number d exists such that

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = [M; H],    Lambda = diag((b - d) I, d I),

by the S-procedure [1]. With a given share d = b split it is a plain bound again, on
Lambda(split)^(-1/2) G, so that the smallest b is the minimum of that over the split.

Arrays have the frequency last, so that an operation on all the small matrices is a few operations
on long vectors: for m = 2 several times faster than a call of LAPACK for each.

[1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and
    Control Theory, 1994, 2.6.3.
[2] T. Kato, Perturbation Theory for Linear Operators, 1966, II.2.
"""

from dataclasses import dataclass, replace

import numpy as np

from ilctools.problem.problem import largest_singular_values

EVEN = 1e-14  # relative distance of two values that rounding may have exchanged
INSIDE = 0.05  # share of b that a first split leaves to M, and to H, at least


@dataclass(frozen=True)
class Expansion:
    """The value at the columns `at`, + gradient dx + |curvature dx|^2 / 2; N is its slope in G."""

    at: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    N: np.ndarray


@dataclass(frozen=True)
class Bound:
    """A bound on G = F + T L, (p, q, c), at some frequencies, for a q x q part L of the filter."""

    F: np.ndarray  # with p = q for the plain one, p = 2 q for that with a radius
    T: np.ndarray
    # of the filter, that stand at `rows`, `cols` of L; the others are zero
    entries: np.ndarray
    rows: np.ndarray
    cols: np.ndarray
    # frequency of each column; a slice begins with the first one
    at: np.ndarray | slice
    limit: int = 0  # of the program's: that of what is minimised (0), or the other (1)
    # number of the plant of each column; None for the nominal M and for L
    plant: np.ndarray | None = None
    gain: bool = False  # whether it is that on L

    @property
    def shape(self):
        """p, q, c."""
        return self.F.shape

    @property
    def splits(self):
        """How many numbers d there are: one for a radius, else none."""
        return int(self.shape[0] > self.shape[1])

    @property
    def of_b(self):
        """1 for the rows of Lambda that b stands in, 0 for the others; shape (p,)."""
        return (np.arange(self.shape[0]) < self.shape[1]).astype(float)

    @property
    def of_d(self):
        """-1 for the rows of Lambda that d is subtracted in, 1 for its own; shape (p,)."""
        return 1 - 2 * self.of_b

    def columns(self, at):
        """The bound at some of its columns only."""
        frequency = np.arange(self.shape[2]) if isinstance(self.at, slice) else self.at
        some = {"F": self.F[..., at], "T": self.T[..., at], "at": frequency[at]}
        return replace(self, **some, plant=None if self.plant is None else self.plant[at])

    def diagonal(self, b, d):
        """Lambda, shape (p, c); (1, c) if plain, where it is b I."""
        return self.of_b[:, None] * b + self.of_d[:, None] * d if self.splits else b[None]

    def response(self, L):
        """T L, given all entries of the filter, shape (entries, n)."""
        _, q, c = self.shape
        D = np.zeros((self.T.shape[1], q, c), dtype=complex)
        D[self.rows, self.cols] = L[self.entries][:, self.at]
        return product(self.T, D)

    def gradient(self, W):
        """The g with Re tr(W T L) = Re sum g L, shape (entries of the bound, c)."""
        return product(W, self.T)[self.cols, self.rows]

    def matrices(self, L):
        """G, given all entries of the filter."""
        return self.F + self.response(L)

    def first_split(self, G):
        """A split for G, shape (k, c), that leaves a positive share to each row of Lambda."""
        if not self.splits:
            return np.zeros((0, G.shape[-1]))
        power = (np.abs(G) ** 2).sum(axis=1)
        above, below = np.sqrt(np.stack([self.of_b, 1 - self.of_b]) @ power)
        share = below + INSIDE * (above + 1e-300)
        return (share / (above + (1 + INSIDE) * share))[None]

    def _scaled(self, G, split):
        """Lambda(split)^(-1/2) G."""
        if not self.splits:
            return G
        return G / np.sqrt(self.diagonal(np.ones(G.shape[-1]), split))[:, None]

    def value(self, G, split=None):
        """The smallest b for G with this split, at each column: the largest singular value."""
        return largest_singular_values(np.moveaxis(self._scaled(G, split), -1, 0))

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
        """The value to second order in L and the split, in real numbers.

        It is the largest b with K w = b B w, where K = [[0, G], [G^H, 0]] and B = diag(Lambda, I)
        for b = 1 are linear in the unknowns. With the other solutions b_j, w_j, scaled such that
        w_j^H B w_j = 1, the first derivative is w^H c, c = (dK - b dB) w, and the second one [2]

            sum_j 2 |w_j^H c|^2 / (b - b_j) - 2 (w^H dB w) (w^H c).

        Returns b, its derivative with respect to G, the gradient, and the second derivatives as
        the sum of R'R and H. Unknowns are the real parts of the bound's entries of L, then the
        imaginary ones, then the split.
        """
        (p, q, c), e = G.shape, len(self.entries)
        K = np.zeros((c, p + q, p + q), dtype=complex)
        K[:, :p, p:] = np.moveaxis(G, -1, 0)
        K[:, p:, :p] = np.moveaxis(adjoint(G), -1, 0)
        root = np.ones((c, p + q))
        if self.splits:
            root[:, :p] = np.sqrt(self.diagonal(np.ones(c), split)).T
        values, W = np.linalg.eigh(K / root[:, :, None] / root[:, None])
        W = W / root[:, :, None]
        value, u, v = values[:, -1], W[:, :p, -1], W[:, p:, -1]

        change = np.zeros((c, p + q, 2 * e + self.splits), dtype=complex)
        T = np.moveaxis(self.T, -1, 0)[:, :, self.rows]
        of_G = T * v[:, None, self.cols]
        of_adjoint = (T.conj() * u[:, :, None]).sum(axis=1)
        real, imag = np.arange(e), np.arange(e, 2 * e)
        change[:, :p, real], change[:, :p, imag] = of_G, 1j * of_G
        change[:, p + self.cols, real] = of_adjoint
        change[:, p + self.cols, imag] = -1j * of_adjoint
        if self.splits:
            change[:, :p, -1] = -value[:, None] * self.of_d * u
        forms = W.conj().swapaxes(1, 2) @ change

        gradient = forms[:, -1].real
        # where Q is zero, M and all its derivatives are
        apart = np.maximum(value, 1e-12)[:, None] * 1e-9
        apart = np.maximum(value[:, None] - values[:, :-1], apart)
        rows = forms[:, :-1] * np.sqrt(2 / apart)[:, :, None]
        R, H = np.concatenate([rows.real, rows.imag], axis=1), 0.0
        if self.splits:
            H = np.zeros((c, 2 * e + 1, 2 * e + 1))
            of_B = (self.of_d * np.abs(u) ** 2).sum(axis=1, keepdims=True) * gradient
            H[:, -1] -= of_B
            H[:, :, -1] -= of_B
        N = 2 * u[:, :, None] * v[:, None].conj()
        return value, np.moveaxis(N, 0, -1), gradient, R, H

    def tighten(self, G, split, level=0.0):
        """The split of the smallest value, and that value, wherever it is above the level."""
        value, split = self.value(G, split), split.copy()
        active = np.flatnonzero(value > level) if self.splits else np.array([], dtype=int)
        for _ in range(30):
            if not active.size:
                break
            some, before = self.columns(active), split[0, active]
            _, _, g, R, H = some._second_order(G[..., active], split[:, active])
            curvature = H[:, -1, -1] + (R[..., -1] ** 2).sum(axis=1)
            d = -g[:, -1] / np.maximum(curvature, 1e-280)
            d = np.clip(d, -0.9 * before, 0.9 * (1 - before))
            gain = -g[:, -1] * d
            for _ in range(6):
                new = split[:, active] + d
                there = some.value(G[..., active], new)
                better = there <= value[active] * (1 + EVEN)
                split[:, active[better]], value[active[better]] = (new[:, better], there[better])
                d = np.where(better, 0, d / 4)
                if better.all():
                    break
            active = active[gain > 1e-13 * value[active]]
        return split, value

    def expand(self, G, split, at, basis, count):
        """The value at the columns `at` to second order, with the split that stays the best."""
        some, e = self.columns(at), len(self.entries)
        value, N, g, R, H = some._second_order(G[..., at], split[:, at])
        if self.splits:
            H = H + R.swapaxes(1, 2) @ R
            cross, own = H[:, -1, :-1], np.maximum(H[:, -1, -1:], 1e-280)
            g = g[:, :-1] - cross * g[:, -1:] / own
            left = H[:, :-1, :-1] - cross[:, :, None] * (cross / own)[:, None]
            R = root_of(left)
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


def product(A, B):
    """A B at each frequency."""
    if A.shape[0] * B.shape[1] > 36:  # large enough for BLAS
        return np.matmul(A, B, axes=[(0, 1)] * 3)
    C = A[:, 0, None] * B[0]
    for j in range(1, len(B)):
        C += A[:, j, None] * B[j]
    return C


def add_columns(total, rows, at, values):
    """Add values to the rows and to the columns `at` of an array."""
    if isinstance(at, slice):
        total[rows, at] += values
    else:  # a column may occur more than once
        np.add.at(total, (rows[:, None], at), values)


def root_of(H):
    """R with R'R = H, of symmetric positive semidefinite matrices, (..., n, n)."""
    w, X = np.linalg.eigh(H)
    return np.sqrt(np.maximum(w, 0))[..., None] * np.swapaxes(X, -1, -2)


def adjoint(A):
    return A.conj().swapaxes(0, 1)
