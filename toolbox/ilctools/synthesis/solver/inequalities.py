"""The small matrix inequalities of the interior-point method, all frequencies at once.

S = [[Lambda, G], [G^H, b I]] >= 0 at each frequency; arrays have the frequency last.
"""

import numpy as np

from ilctools.synthesis.solver.bounds import adjoint, product


class Slack:
    """S and its inverse X, given the diagonal of Lambda, (p, c), b, (c,), and G, (p, q, c).

    With the Schur complement A = b I - G^H Lambda^-1 G,

        X = [[Lambda^-1 + Lambda^-1 G A^-1 G^H Lambda^-1, -Lambda^-1 G A^-1], [., A^-1]].
    """

    def __init__(self, diagonal, b, G):
        p, q, _ = G.shape
        self.diagonal, self.b, self.G = diagonal, b, G
        self.scaled = G * (1 / diagonal)[:, None]  # Lambda^-1 G
        A = -product(adjoint(G), self.scaled)
        A[range(q), range(q)] += b
        self.inverse = hermitian(np.moveaxis(np.linalg.inv(np.moveaxis(A, -1, 0)), 0, -1))
        lower = -product(self.inverse, adjoint(self.scaled))
        upper = -product(self.scaled, lower)
        upper[range(p), range(p)] += 1 / diagonal
        self.X = stacked(upper, adjoint(lower), lower, self.inverse)

    def sandwich(self, Y, diagonal, b, G):
        """Hermitian part of Y dS X, for the parts of a change dS.

        Near the solution X is very large where dS nearly vanishes. The differences of
        dS [-Lambda^-1 G; I] take care of that cancellation before they are multiplied by A^-1. So
        rounding errors leave the small eigenvalues of Y alone.
        """
        p, q, _ = G.shape
        change = np.concatenate(
            [G - diagonal[:, None] * self.scaled, -product(adjoint(G), self.scaled)]
        )
        change[range(p, p + q), range(q)] += b
        right = product(product(Y, change), self.inverse)
        left = Y[:, :p] * diagonal + product(Y[:, p:], adjoint(G))
        left = left * (1 / self.diagonal) - product(right, adjoint(self.scaled))
        return hermitian(np.concatenate([left, right], axis=1))


def stacked(upper_left, upper_right, lower_left, lower_right):
    """A block matrix at each frequency."""
    upper = np.concatenate([upper_left, upper_right], axis=1)
    return np.concatenate([upper, np.concatenate([lower_left, lower_right], axis=1)])


def dense(diagonal, b, G):
    """S of its parts."""
    p, q, c = G.shape
    S = stacked(np.zeros((p, p, c)), G, adjoint(G), np.zeros((q, q, c)))
    S[range(p), range(p)] = diagonal
    S[range(p, p + q), range(p, p + q)] = b
    return S


def hermitian(A):
    return 0.5 * (A + adjoint(A))


def positive_definite(A):
    """Which of the Hermitian matrices are positive definite. They are overwritten."""
    positive = A[0, 0].real > 0
    for k in range(1, len(A)):  # Gaussian elimination
        column = A[k:, k - 1]
        row = column.conj() * (1 / np.where(positive, A[k - 1, k - 1].real, 1))
        A[k:, k:] -= column[:, None] * row
        positive &= A[k, k].real > 0
    return positive


def longest_step(A, D, limit, accuracy):
    """The largest a <= limit with A + a D positive definite, by bisection."""
    low, high, a = 0.0, limit, limit
    while high - low > accuracy * high and high > 1e-9:
        failing = ~positive_definite(A + a * D)
        if failing.any():
            high = a
            A, D = A[..., failing], D[..., failing]  # the others would not fail below
        else:
            low = a
        a = (low + high) / 2
    return low
