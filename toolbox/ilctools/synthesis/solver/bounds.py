"""A bound on a largest singular value that is affine in the filter.

There are two kinds, and one class for both. The plain one is sigma_max(G) <= b, with G = F + T L.
The other holds for all plants within a radius: sigma_max(M + E H) <= b for every E of norm one or
less. That is so if and only if a number d exists such that

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = [M; H],    Lambda = diag((b - d) I, d I),

by the S-procedure [1]. With a given share d = b share it is a plain bound again, on
Lambda(share)^(-1/2) G, so that the smallest b is the minimum of that over the share.

Arrays have the frequency last, so that an operation on all the small matrices is a few operations
on long vectors: for m = 2 several times faster than a call of LAPACK for each.

[1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and
    Control Theory, 1994, 2.6.3.
"""

from dataclasses import dataclass

import numpy as np

from ilctools.singular_values import largest_singular_values

INSIDE = 0.05  # share of b that a first share leaves to M, and to H, at least


@dataclass(frozen=True)
class Bound:
    """A bound on G = F + T L, of shape (p, q, c), at some frequencies."""

    F: np.ndarray  # with p = q for the plain one, p = 2 q for the one with a radius
    T: np.ndarray
    at: np.ndarray  # (c,): index of the frequency of each column
    level: np.ndarray  # (c,): number of b at each column among the program's t and limits
    within_radius: bool  # whether there is a number d for each column

    @property
    def of_b(self):
        """Lambda = diag(of_b b + of_d d), (p,): 1 for the rows of M."""
        rows_of_M = self.F.shape[1] if self.within_radius else len(self.F)
        return (np.arange(len(self.F)) < rows_of_M).astype(float)

    @property
    def of_d(self):
        """-1 for the rows of M and 1 for the rows of H; zero if the bound is plain, (p,)."""
        return (1 - 2 * self.of_b) * self.within_radius

    def diagonal(self, b, d):
        """That of Lambda, shape (p, c)."""
        return self.of_b[:, None] * b + self.of_d[:, None] * d

    def first_share(self, G):
        """A share d / b for G, shape (c,), that leaves a positive part to each row of Lambda."""
        if not self.within_radius:
            return np.zeros(G.shape[2])
        power = (np.abs(G) ** 2).sum(axis=1)
        above, below = np.sqrt(np.stack([self.of_b, 1 - self.of_b]) @ power)
        part = below + INSIDE * (above + 1e-300)
        return part / (above + (1 + INSIDE) * part)

    def value(self, G, share):
        """The smallest b for G with this share, at each column."""
        scaled = G / np.sqrt(self.diagonal(1.0, share))[:, None]
        return largest_singular_values(np.moveaxis(scaled, -1, 0))


def product(A, B):
    """A B at each frequency."""
    return np.einsum("ijn,jkn->ikn", A, B)


def adjoint(A):
    return A.conj().swapaxes(0, 1)
