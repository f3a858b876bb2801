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
        p = len(G)
        scaled = G * (1 / diagonal)[:, None]  # Lambda^-1 G
        A = complement(b, G, scaled)
        inverse = hermitian(np.moveaxis(np.linalg.inv(np.moveaxis(A, -1, 0)), 0, -1))
        lower = -product(inverse, adjoint(scaled))
        upper = -product(scaled, lower)
        upper[range(p), range(p)] += 1 / diagonal
        self.X = stacked(upper, adjoint(lower), lower, inverse)

    def sandwich(self, Y, diagonal, b, G):
        """Hermitian part of Y dS X, for the parts of a change dS."""
        return hermitian(product(product(Y, assembled(diagonal, b, G)), self.X))


def assembled(diagonal, b, G):
    """[[Lambda, G], [G^H, b I]] of its parts."""
    p, q, _ = G.shape
    S = np.zeros((p + q, p + q, G.shape[2]), dtype=complex)
    S[:p, p:], S[p:, :p] = G, adjoint(G)
    S[range(p), range(p)], S[range(p, p + q), range(p, p + q)] = diagonal, b
    return S


def complement(b, G, scaled):
    """Schur complement b I - G^H Lambda^-1 G, given Lambda^-1 G."""
    q = G.shape[1]
    A = -product(adjoint(G), scaled)
    A[range(q), range(q)] += b
    return A


def stacked(upper_left, upper_right, lower_left, lower_right):
    """A block matrix at each frequency."""
    upper = np.concatenate([upper_left, upper_right], axis=1)
    return np.concatenate([upper, np.concatenate([lower_left, lower_right], axis=1)])


def inner(diagonal, b, G, Y):
    """sum <S, Y> of the parts of S."""
    p = len(G)
    of_Y = np.einsum("iin->in", Y).real
    of_G = 2 * np.einsum("ijn,jin->", G, Y[p:, :p]).real
    return (diagonal * of_Y[:p]).sum() + (b * of_Y[p:]).sum() + of_G


def hermitian(A):
    return 0.5 * (A + adjoint(A))


def is_inside(diagonal, b, G):
    """At which frequencies S is positive definite: Lambda and the Schur complement are."""
    positive = (diagonal > 0).all(axis=0)
    scaled = G * (1 / np.where(positive, diagonal, 1))[:, None]
    return positive & positive_definite(complement(b, G, scaled))


def positive_definite(A):
    """Which of the Hermitian matrices are positive definite: all pivots are positive.

    Gaussian elimination on all of them at once takes a fifth of the time of their eigenvalues.
    """
    A = A.copy()
    positive = A[0, 0].real > 0
    for k in range(1, len(A)):
        pivot = np.where(positive, A[k - 1, k - 1].real, 1)
        column = A[k:, k - 1]
        A[k:, k:] -= column[:, None] * (column.conj() / pivot)
        positive &= A[k, k].real > 0
    return positive


def longest_step(is_inside, parts, changes, limit, accuracy):
    """The largest a <= limit at which `parts + a changes` are inside, by bisection."""
    low, high, a = 0.0, limit, limit
    while high - low > accuracy * high and high > 1e-9:
        moved = (part + a * change for part, change in zip(parts, changes, strict=True))
        failing = ~is_inside(*moved)
        if failing.any():
            high = a  # the others would not fail below
            parts, changes = ([x[..., failing] for x in each] for each in (parts, changes))
        else:
            low = a
        a = (low + high) / 2
    return low
