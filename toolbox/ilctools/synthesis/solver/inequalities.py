"""Operations on the small matrices of the interior-point method, at all frequencies at once.

Arrays have the frequency as their last axis. An operation on all small matrices is then a few
operations on long vectors. For m = 2, this is several times faster than a call of LAPACK for each
matrix.
"""

import numpy as np

ACCURACY_OF_STEP = 0.02  # relative accuracy of a step length, as steps are shortened by more
NO_STEP = 1e-9  # a shorter step makes no progress


def product(A, B):
    """Compute the product A B at each frequency."""
    return np.einsum("ijn,jkn->ikn", A, B)


def adjoint(A):
    """Return the adjoint A^H at each frequency."""
    return A.conj().swapaxes(0, 1)


def hermitian(A):
    """Return the Hermitian part (A + A^H) / 2 at each frequency."""
    return 0.5 * (A + adjoint(A))


def inverse(S):
    """Invert positive definite matrices by Gauss-Jordan elimination in place."""
    X = S.copy()
    for k in range(len(X)):
        row = X[k] / X[k, k].real
        column = X[:, k].copy()
        X -= column[:, None] * row
        X[:, k] = -column / column[k].real
        X[k] = row
        X[k, k] = 1 / column[k].real
    return hermitian(X)


def inner(A, B):
    """Compute the sum of <A, B> = tr(A B) over all frequencies, for Hermitian A and B."""
    return np.vdot(A, B).real


def positive_definite(A):
    """Check which Hermitian matrices are positive definite, by the signs of their pivots.

    Gaussian elimination on all matrices at once takes a fifth of the time of their eigenvalues.
    """
    A = A.copy()
    positive = A[0, 0].real > 0
    for k in range(1, len(A)):
        pivot = np.where(positive, A[k - 1, k - 1].real, 1)
        column = A[k:, k - 1]
        A[k:, k:] -= column[:, None] * (column.conj() / pivot)
        positive &= A[k, k].real > 0
    return positive


def longest_step(S, dS, limit):
    """Find by bisection the largest a <= limit at which all S + a dS are positive definite."""
    low, high, a = 0.0, limit, limit
    while high - low > ACCURACY_OF_STEP * high and high > NO_STEP:
        failing = ~positive_definite(S + a * dS)
        if failing.any():
            high = a  # with shorter steps, only these can still fail
            S, dS = S[..., failing], dS[..., failing]
        else:
            low = a
        a = (low + high) / 2
    return low
