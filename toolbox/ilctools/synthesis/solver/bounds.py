"""A bound on the largest singular value of a matrix that is affine in the filter.

There are two kinds of bounds, and one class for both. The plain bound is sigma_max(G) <= b, with G
= F + T L. The bound for all plants within a radius is sigma_max(M + E H) <= b for every E of norm
one or less, with H = |Q| r L for a radius r. The second bound holds if and only if a number d
exists such that

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = [M; H],    Lambda = diag((b - d) I, d I),

by the S-procedure [1]. For a fixed share = d / b, this is again a plain bound on
Lambda(share)^(-1/2) G, where Lambda(share) is Lambda for b = 1. The smallest b is therefore the
minimum over the share of sigma_max(Lambda(share)^(-1/2) G).

[1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and
    Control Theory, 1994, 2.6.3.
"""

from dataclasses import dataclass

import numpy as np

from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.solver.inequalities import adjoint

# Least share of b that the first guess gives to M and to H. Any number below one half works.
LEAST_SHARE = 0.05
TINY = np.finfo(float).tiny  # is added to a norm that may be zero


@dataclass(frozen=True)
class Bound:
    """A bound on G = F + T L, shape (p, q, c), at some frequencies."""

    F: np.ndarray  # (p, q, c): p = q for the plain bound, p = 2 q for the bound with a radius
    T: np.ndarray
    at: np.ndarray  # (c,): index of the frequency of each column
    level: np.ndarray  # (c,): number of the b of each column, among the program's t and limits
    within_radius: bool  # whether the bound is for a radius, with a number d for each column

    @property
    def along_b(self):
        """Factor of b in the diagonal of S, (p + q,): zero in the rows of H."""
        p, q, _ = self.F.shape
        return np.repeat([1.0, 0.0, 1.0], [q, p - q, q])

    @property
    def along_d(self):
        """Factor of d in the diagonal of S, (p + q,): -1 in the rows of M, 1 in the rows of H."""
        p, q, _ = self.F.shape
        return self.within_radius * np.repeat([-1.0, 1.0, 0.0], [q, p - q, q])

    def diagonal(self, b, d):
        """Compute the diagonal of S, (p + q, c)."""
        return self.along_b[:, None] * b + self.along_d[:, None] * d

    def inequality(self, b, d, G):
        """Compute S at each column, (p + q, p + q, c).

        For changes of b, d and G, the result is the change of S, because S is linear.
        """
        p, q, c = G.shape
        S = np.zeros((p + q, p + q, c), dtype=complex)
        S[:p, p:], S[p:, :p] = G, adjoint(G)
        S[range(p + q), range(p + q)] = self.diagonal(b, d)
        return S

    def first_share(self, G):
        """Choose a first share d / b for G, (c,), for which Lambda is positive definite."""
        of_M, of_H = (np.linalg.norm(part, axis=(0, 1)) for part in np.split(G, [G.shape[1]]))
        part = of_H + LEAST_SHARE * (of_M + TINY)
        return self.within_radius * part / (of_M + (1 + LEAST_SHARE) * part)

    def value(self, G, share):
        """Compute the smallest b for G with this share, at each column."""
        scaled = G / np.sqrt(self.diagonal(1.0, share)[: len(G), None])
        return largest_singular_values(np.moveaxis(scaled, -1, 0))
