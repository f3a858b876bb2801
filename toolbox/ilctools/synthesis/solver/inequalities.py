"""The small matrix inequalities of the interior-point method, all frequencies at once.

S = [[Lambda, G], [G^H, b I]] >= 0 at each frequency; arrays have the frequency last.
"""

import numpy as np

from ilctools.synthesis.solver.bounds import adjoint, product

EPS = np.finfo(float).eps


class Slack:
    """S and its inverse X, given the diagonal of Lambda, (p, n), or (1, n) if it is b I."""

    def __init__(self, G, diagonal, b):
        p, q, n = G.shape
        self.G, self.diagonal, self.b = G, diagonal, b
        self.H = G * (1 / diagonal)[:, None]
        self.A = -product(adjoint(G), self.H)
        self.A[range(q), range(q)] += b
        _, inverse = cholesky(self.A, 0.01 * EPS * b)
        self.F = adjoint(inverse)
        self.M = product(self.F, inverse)  # (b I - G^H Lambda^-1 G)^-1
        self.X = np.empty((p + q, p + q, n), dtype=complex)
        self.X[p:, p:] = self.M
        self.X[p:, :p] = -product(self.M, adjoint(self.H))
        self.X[:p, p:] = adjoint(self.X[p:, :p])
        self.X[:p, :p] = -product(self.H, self.X[p:, :p])
        self.X[range(p), range(p)] += 1 / diagonal

    def change(self, dl, d, D):
        """dS [-Lambda^-1 G; I], where dS = [[dl, D], [D^H, d I]]."""
        # Near the solution X is very large where dS nearly vanishes. These differences take care of
        # that cancellation before they are multiplied by X.
        p, q, _ = D.shape
        N = np.concatenate([D - dl[:, None] * self.H, -product(adjoint(D), self.H)])
        N[range(p, p + q), range(q)] += d
        return N

    def sandwich(self, Y, dl, d, D):
        """Hermitian part of Y dS X. Its rounding errors leave the small eigenvalues of Y alone."""
        p = len(D)
        right = product(product(Y, self.change(dl, d, D)), self.M)
        left = Y[:, :p] * dl + product(Y[:, p:], adjoint(D))
        left = left * (1 / self.diagonal) - product(right, adjoint(self.H))
        return hermitian(np.concatenate([left, right], axis=1))

    def root(self, C, dl, d, D):
        """C^H dS R with R R^H = X, given C^H: its square sum is <dS, C C^H dS X>.

        R = [[Lambda^(-1/2), -Lambda^-1 G F], [0, F]], F F^H = (b I - G^H Lambda^-1 G)^-1.
        """
        p, _, n = D.shape
        first = np.concatenate([np.zeros((p, p, n), dtype=complex), adjoint(D)])
        first[range(p), range(p)] += dl
        first = first * (1 / np.sqrt(self.diagonal))
        return product(C, np.concatenate([first, product(self.change(dl, d, D), self.F)], axis=1))

    def along(self, dl, d, D):
        """S + a dS, positive definite where these are, as coefficients of a polynomial in a."""
        p, q, n = D.shape
        # (b + a d)^2 I - (G + a D)^H (G + a D), which is smaller
        if len(self.diagonal) == 1:
            diagonal = np.diag_indices(q)
            A1, A2 = (-2 * hermitian(product(adjoint(self.G), D)), -product(adjoint(D), D))
            A1[diagonal] += 2 * self.b * d
            A2[diagonal] += d**2
            return [self.A * self.b, A1, A2]
        whole = np.zeros((2, p + q, p + q, n), dtype=complex)
        terms = (self.diagonal, self.b, self.G), (dl, d, D)
        for S, (diagonal, b, G) in zip(whole, terms, strict=True):
            S[range(p), range(p)] = diagonal
            S[range(p, p + q), range(p, p + q)] = b
            S[:p, p:], S[p:, :p] = G, adjoint(G)
        return [*whole]


def hermitian(A):
    return 0.5 * (A + adjoint(A))


def trace(A):
    return np.einsum("iin->n", A).real


def cholesky(A, floor):
    """R^H and R^-1 of A = R R^H > 0; no pivot of A is below the floor, unless by rounding."""
    q = len(A)  # Gaussian elimination turns [A, I] into [R^H, R^-1]
    A = np.concatenate([A, np.zeros_like(A)], axis=1)
    A[range(q), range(q, 2 * q)] = 1
    for k in range(q):
        A[k] *= 1 / np.sqrt(np.maximum(A[k, k].real, floor))
        A[k + 1 :] -= A[k, k + 1 : q, None].conj() * A[k]
    return A[:, :q], A[:, q:]


def positive_definite(A):
    """Which of the Hermitian matrices are positive definite. They are overwritten."""
    positive = A[0, 0].real > 0
    for k in range(1, len(A)):
        column = A[k:, k - 1]
        row = column.conj() * (1 / np.where(positive, A[k - 1, k - 1].real, 1))
        A[k:, k:] -= column[:, None] * row
        positive &= A[k, k].real > 0
    return positive


def longest_step(A, limit, accuracy):
    """The largest a <= limit with A[0] + a A[1] + a^2 A[2] ... positive definite, by bisection."""
    low, high, a = 0.0, limit, limit
    while high - low > accuracy * high and high > 1e-9:
        value = A[-1] * a
        for term in A[-2:0:-1]:
            value += term
            value *= a
        value += A[0]
        failing = ~positive_definite(value)
        if failing.any():
            high = a
            A = [term[..., failing] for term in A]  # the others would not fail below
        else:
            low = a
        a = (low + high) / 2
    return low
