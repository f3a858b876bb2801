"""Least squares on a trial of many samples, by a Riccati recursion on the states of the plant.

We look for the input d that minimises

    sum over p of |y(p)|^2 + weight |d(p)|^2 - 2 f(p)' x(p) - 2 g(p)' d(p),                     (1)
    x(p + 1) = A x(p) + B d(p),    y(p) = C x(p) + D d(p),    x(0) = 0,    p = 0, ..., N - 1.

With f = C' e and g = D' e, this d is the change of v whose response fits an error e best. By
dynamic programming, the least sum from sample p on is x' S(p) x - 2 s(p)' x plus a constant. Here
S(N) = 0, s(N) = 0, and backwards in time

    R(p) = weight I + D' D + B' S(p + 1) B,                                                     (2)
    K(p) = R(p)^-1 (D' C + B' S(p + 1) A),                                                      (3)
    S(p) = C' C + A' S(p + 1) A - K(p)' R(p) K(p),                                              (4)
    s(p) = F(p)' s(p + 1) + f(p) - K(p)' g(p),    F(p) = A - B K(p).                            (5)

Then, forwards in time,

    d(p) = u(p) - K(p) x(p),    u(p) = R(p)^-1 (g(p) + B' s(p + 1)),                            (6)
    x(p + 1) = F(p) x(p) + B u(p).                                                              (7)

(2) to (4) do not depend on f and g. Backwards in time, K, R and S stop changing after some samples.
One K therefore serves all earlier samples, and a trial needs little more memory than its signals. S
is propagated as S = U' U (square-root form). The QR decomposition

    [ sqrt(weight) I    0    ]
    [       D           C    ]  =  orthogonal [ T   T K ]          with  R = T' T
    [      U B         U A   ]                [ 0    U  ]

gives T, T K and the next U, without the difference of numbers that nearly cancel in (4). See
B. D. O. Anderson and J. B. Moore, Optimal filtering, Prentice-Hall, 1979, Section 6.5.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtbtrs

# S counts as constant if its relative change from one check to the next is below this value. Each
# check is half as far again from the end of the trial. S grows ever more slowly. If all modes
# decay, S then grows by far less than this change. The relative rounding error of S is 1e-14.
STATIONARY_S = 1e-13
FIRST_LOOK = 8  # samples from the end of the trial to the first check
PIECE = 2**17  # numbers in the matrix of (5) and (7) for some samples: the matrix fits the cache


class Gains(NamedTuple):
    """The gains K, and T^-1 with R = T' T, for the last samples of a trial.

    The gains of the first of these samples also hold for all earlier samples.
    """

    K: np.ndarray  # (count, m, n)
    root: np.ndarray  # (count, m, m), T^-1


def gains(A, B, C, D, weight: float, samples: int, errors=None) -> Gains:
    """Compute K and T^-1 by (2) to (4), backwards from the end of a trial.

    The recursion stops when S no longer changes. If weights `errors`, (samples, p), are passed,
    |y|^2 in (1) becomes sum_i errors_i y_i^2. Gains are then computed for all samples.
    """
    n, m = B.shape
    above = np.block([[np.sqrt(weight) * np.eye(m), np.zeros((m, n))], [D, C]])
    dynamics = np.hstack([B, A])
    if errors is None:
        rows = _until_stationary(above, dynamics, samples)
    else:
        roots = np.hstack([np.ones((samples, m)), np.sqrt(errors)])
        rows, _ = _backwards(above * roots[..., None], dynamics, np.zeros((n, n)), samples)
    T, TK = np.triu(rows[..., :m]), rows[..., m:]
    return Gains(np.linalg.solve(T, TK), np.linalg.inv(T))


def _until_stationary(above, dynamics, samples) -> np.ndarray:
    """Compute T and T K of the last samples of a trial.

    The recursion runs backwards, and stops when S no longer changes.
    """
    n = len(dynamics)
    U, S, count, parts = np.zeros((n, n)), np.zeros((n, n)), 0, []
    stationary = False
    while count < samples and not stationary:
        look = min(samples, max(FIRST_LOOK, count + count // 2))
        same = np.broadcast_to(above, (look - count, *above.shape))
        rows, U = _backwards(same, dynamics, U, look - count)
        parts.append(rows)
        before, S, count = S, U.T @ U, look
        size = np.sqrt(np.diag(S))
        stationary = bool(np.all(np.abs(S - before) <= STATIONARY_S * np.outer(size, size)))
    return np.concatenate(parts[::-1])


def _backwards(above, dynamics, U, count) -> tuple[np.ndarray, np.ndarray]:
    """Compute T and T K, side by side, for `count` samples before the sample of U.

    The U of the first of these samples is also returned. For each sample, `above` holds the first
    two block rows of the matrix that is decomposed, which do not depend on U.
    """
    n, width = dynamics.shape
    m, height = width - n, above.shape[1]
    matrix = np.empty((height + n, width), order="F")  # what is decomposed, in its place
    rows, upper = np.empty((count, m, width)), np.triu(np.ones((n, n)))
    for row, now in zip(rows[::-1], above[::-1], strict=True):
        matrix[:height] = now
        matrix[height:] = U @ dynamics
        triangle, *_ = dgeqrf(matrix, overwrite_a=True)  # below its diagonal: the rotations
        row[:] = triangle[:m]
        U = triangle[m : m + n, m:] * upper
    return rows, U


class TrialLeastSquares:
    """The least-squares problem (1) for trials of N samples.

    The factors of the problem are computed once, and are the same for any f and g.
    """

    def __init__(self, A, B, C, D, weight: float, samples: int, errors=None):
        self.A, self.B, self.samples = A, B, samples
        self.gains = gains(A, B, C, D, weight, samples, errors)
        piece = max(1, PIECE // (2 * max(1, A.size)))
        starts = range(0, samples, piece)
        self.parts = [slice(start, min(start + piece, samples)) for start in starts]

    def solved(self, signal, to_x, to_d) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Compute x and d, piece by piece, for f = to_x' signal and g = to_d' signal.

        The signal has the shape (trials, samples, any). For each piece, three values are
        returned: the slice of its samples, x with the shape (trials, samples of the slice, n), and
        d with the shape (trials, samples of the slice, m).
        """
        u = self._forced(signal, to_x, to_d)
        x = np.zeros((len(signal), len(self.A)))
        for part in self.parts:
            K, _, F = self._of(part)
            forcing = u[:, part] @ self.B.T
            right = np.concatenate([x[:, None], forcing[:, :-1]], axis=1)
            states = _substituted(F, right, "N")  # (7)
            changes = u[:, part] - _times(states, K.swapaxes(1, 2))  # (6)
            x = states[:, -1] @ F[-1].T + forcing[:, -1]
            yield part, states, changes

    def _forced(self, signal, to_x, to_d) -> np.ndarray:
        """Compute u of (6) for the f and g of :meth:`solved`.

        The result has the shape (trials, samples, m).
        """
        u = np.empty((len(signal), self.samples, self.B.shape[1]))
        s = np.zeros((len(signal), len(self.A)))
        for part in reversed(self.parts):
            K, root, F = self._of(part)
            f, g = signal[:, part] @ to_x, signal[:, part] @ to_d
            right = f - _times(g, K)
            right[:, -1] += s @ F[-1]
            now = _substituted(F, right, "T")  # (5)
            after = np.concatenate([now[:, 1:], s[:, None]], axis=1)
            u[:, part] = _times(_times(g + after @ self.B, root), root.swapaxes(1, 2))
            s = now[:, 0]
        return u

    def _of(self, part):
        """Select K, T^-1 and F of each sample of a piece."""
        before = self.samples - len(self.gains.K)  # samples at which the first gains hold
        number = np.maximum(np.arange(part.start, part.stop) - before, 0)
        K, root = (each[number] for each in self.gains)
        return K, root, self.A - self.B @ K


def _substituted(F, right, trans) -> np.ndarray:
    """Solve x(p + 1) - F(p) x(p) = right(p + 1), or the transposed equation, for x.

    The solution has the shape (trials, samples, n). The matrix of the whole piece is lower
    triangular, with ones on its diagonal.
    """
    if not right.size:
        return right
    count, n, _ = F.shape
    i, j = np.indices((n, n))
    diagonals = np.zeros((count, n, 2 * n))  # in LAPACK's layout of a band
    diagonals[:, j, n + i - j] = -F
    columns = right.reshape(len(right), -1).T
    solved, _ = dtbtrs(diagonals.reshape(count * n, -1).T, columns, uplo="L", trans=trans, diag="U")
    return solved.T.reshape(right.shape)


def _times(signal, matrices) -> np.ndarray:
    """Compute signal(p)' M(p) at each sample p.

    The signal has the shape (trials, samples, k).
    """
    return np.einsum("tpk,pkl->tpl", signal, matrices)
