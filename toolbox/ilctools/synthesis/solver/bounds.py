"""A bound on a largest singular value that is affine in the filter.

There are two kinds, and one class for both. The plain one is sigma_max(G) <= b, with G = F + T L.
The other holds for all plants within a radius: sigma_max(M + E H) <= b for every E of norm one or
less. That is so if and only if a number d exists such that

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = [M; H],    Lambda = diag((b - d) I, d I),

by the S-procedure [1]. With a given share d = b share it is a plain bound again, on
Lambda(share)^(-1/2) G, so that the smallest b is the minimum of that over the share.

[1] S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and
    Control Theory, 1994, 2.6.3.
"""

from dataclasses import dataclass

import numpy as np

from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.solver.inequalities import adjoint

LEAST_SHARE = 0.05  # of b that a first share leaves to M, and to H: any below one half will do
TINY = np.finfo(float).tiny  # beside which a norm of zero is none


@dataclass(frozen=True)
class Bound:
    """A bound on G = F + T L, of shape (p, q, c), at some frequencies."""

    F: np.ndarray  # with p = q for the plain one, p = 2 q for the one with a radius
    T: np.ndarray
    at: np.ndarray  # (c,): index of the frequency of each column
    level: np.ndarray  # (c,): number of b at each column among the program's t and limits
    within_radius: bool  # whether there is a number d for each column

    @property
    def along_b(self):
        """What b is times in the diagonal of S, (p + q,): zero in the rows of H."""
        p, q, _ = self.F.shape
        row = np.arange(p + q)
        return 1.0 - ((q <= row) & (row < p))

    @property
    def along_d(self):
        """What d is times there, (p + q,): -1 in the rows of M, 1 in those of H."""
        p, q, _ = self.F.shape
        return self.within_radius * np.repeat([-1.0, 1.0, 0.0], [q, p - q, q])

    def diagonal(self, b, d):
        """That of S, (p + q, c)."""
        return self.along_b[:, None] * b + self.along_d[:, None] * d

    def inequality(self, b, d, G):
        """S at each column, (p + q, p + q, c); its change, for changes of b, d and G."""
        p, q, c = G.shape
        S = np.zeros((p + q, p + q, c), dtype=complex)
        S[:p, p:], S[p:, :p] = G, adjoint(G)
        S[range(p + q), range(p + q)] = self.diagonal(b, d)
        return S

    def first_share(self, G):
        """A share d / b for G, shape (c,), that leaves a positive part to each row of Lambda."""
        of_M, of_H = (np.linalg.norm(part, axis=(0, 1)) for part in np.split(G, [G.shape[1]]))
        part = of_H + LEAST_SHARE * (of_M + TINY)
        return self.within_radius * part / (of_M + (1 + LEAST_SHARE) * part)

    def value(self, G, share):
        """The smallest b for G with this share, at each column."""
        scaled = G / np.sqrt(self.diagonal(1.0, share)[: len(G), None])
        return largest_singular_values(np.moveaxis(scaled, -1, 0))
