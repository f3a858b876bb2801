"""The largest norm of a trial among several plants, without finding all of these norms.

The map of a trial of plant k is T_k = Q_N (I - L_N P_k), see :func:`.finite.trial_map`. Q and L
are the same for all plants. So L_N is made a matrix once, and the Lanczos iteration on T_k^T T_k
runs for many plants at the same time. After j steps from a random start, the largest eigenvalue of
a symmetric, positive semidefinite matrix of size n is above theta / (1 - eps), where theta is the
largest Ritz value, with a probability of at most

    1.648 sqrt(n) exp(-(2 j - 1) sqrt(eps)),

J. Kuczynski and H. Wozniakowski, SIAM Journal on Matrix Analysis and Applications 13 (1992)
1094-1122. A plant whose norm is then below the largest one found is left out; the iteration of each
other plant ends when its norm is found. The largest norm is that of all plants.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ilctools.base import RegularisedInverse
from ilctools.filters import Composition, Filter, ZeroPhaseButterworth
from ilctools.models import impulse_response

TOGETHER = 32  # plants of which the iteration runs at the same time: 64 take as long for each
BETWEEN = 8  # steps from one look at the Ritz values to the next: each takes as long as a step
CHANCE = 1e-9  # that a plant is left out whose norm is the largest
TOLERANCE = 1e-8  # relative residual of an eigenvector, as of one plant alone


def largest_trial_norm(plants, Q: ZeroPhaseButterworth, L: Filter, samples: int) -> float:
    """The largest 2-norm of a trial among some plants, see :func:`.finite.trial_norm`."""
    L_N, largest = matrix_on_trial(L, samples), 0.0
    for first in range(0, len(plants), TOGETHER):
        h = [impulse_response(P, samples) for P in plants[first : first + TOGETHER]]
        largest = _largest_of(_Maps(Q, L_N, np.array(h)), largest)
    return largest


def matrix_on_trial(L: Filter, samples: int) -> np.ndarray:
    """The matrix that L is on raveled trials, (samples m, samples m)."""
    if isinstance(L, Composition):
        return matrix_on_trial(L.B, samples) @ matrix_on_trial(L.K, samples)
    if isinstance(L, RegularisedInverse):
        return L.matrix(samples)
    m, N = L.channels, samples
    ahead = np.subtract.outer(np.arange(N), np.arange(N)).T  # of row i and column j: j - i
    reached = (ahead >= L.first) & (ahead <= L.last)
    taps = np.moveaxis(L.coefficients, -1, 0)[np.clip(ahead - L.first, 0, L.order - 1)]
    blocks = np.where(reached[:, :, None, None], taps, 0.0).transpose(0, 2, 1, 3)
    # the first and the last sample may stand still beyond the ends of the trial
    for end in {0, N - 1}:
        units = np.zeros((m, N, m))
        units[np.arange(m), end, np.arange(m)] = 1
        blocks[:, :, end] = np.moveaxis(L.apply(units), 0, -1)
    return blocks.reshape(N * m, N * m)


@dataclass(frozen=True)
class _Maps:
    """The maps T_k of some plants, each on a signal of its own."""

    Q: ZeroPhaseButterworth
    L_N: np.ndarray  # (N m, N m)
    h: np.ndarray  # (k, N, m, m): impulse responses
    H: np.ndarray = field(init=False)  # their transforms, long enough for no sample to wrap round

    def __post_init__(self):
        object.__setattr__(self, "H", rfft(self.h, next_fast_len(2 * self.h.shape[1]), axis=1))

    def normal(self, v, which):
        """T_k^T T_k v_k of some of the plants, by number; v of shape (k, N m)."""
        H, shape = self.H[which], (len(which), *self.h.shape[1:3])
        after = self.Q.apply((v - self._filtered(H, v, shape) @ self.L_N.T).reshape(shape))
        back = self.Q.apply_transposed(after).reshape(v.shape)
        return back - self._filtered(H.conj().swapaxes(2, 3), back @ self.L_N, shape)

    def _filtered(self, H, v, shape):
        """P_k v_k, or with H adjoint P_k^T v_k."""
        N, length = shape[1], next_fast_len(2 * shape[1])
        V = rfft(v.reshape(shape), length, axis=1)
        return irfft((H @ V[..., None])[..., 0], length, axis=1)[:, :N].reshape(v.shape)


def _largest_of(maps, largest) -> float:
    """The largest norm of some maps, or `largest` where none is larger."""
    count, N, m, _ = maps.h.shape
    run = _Lanczos(maps, count, N * m)
    for step in range(1, N * m + 1):
        run.step()
        last = step == N * m
        if step % BETWEEN and not last and run.beside[:, -1].all():
            continue  # while there is a next vector for each plant
        theta, residual = _ritz(run.diagonal, run.beside)
        found = (residual <= TOLERANCE * theta) | last
        largest = max(largest, np.sqrt(theta[found].max(initial=0)))
        run.keep(~found & (theta / (1 - _missing(N * m, step)) > largest**2))
        if not len(run.which):
            break
    return float(largest)


class _Lanczos:
    """Lanczos iterations on T_k^T T_k of several plants, each with all of its vectors."""

    def __init__(self, maps, count, size):
        start = np.random.default_rng(0).standard_normal(size)  # the same in every run
        self.maps, self.which = maps, np.arange(count)  # the plants that are left, by number
        self.w = np.tile(start, (count, 1))  # the next vectors, not yet of length one
        self.basis = np.empty((count, 0, size))
        self.diagonal, self.beside = np.empty((2, count, 0))

    def step(self):
        """One vector more for each plant; `beside` then has the length of what is left."""
        v = self.w / np.linalg.norm(self.w, axis=1, keepdims=True)
        self.basis = np.concatenate([self.basis, v[:, None]], axis=1)
        w = self.maps.normal(v, self.which)
        self.diagonal = np.column_stack([self.diagonal, (w * v).sum(axis=1)])
        for _ in range(2):  # once leaves what rounding has made of the projections
            w = w - (self.basis.swapaxes(1, 2) @ (self.basis @ w[..., None]))[..., 0]
        self.w = w
        self.beside = np.column_stack([self.beside, np.linalg.norm(w, axis=1)])

    def keep(self, chosen):
        """Go on with some of the plants, (k,) bool."""
        self.which, self.w, self.basis = self.which[chosen], self.w[chosen], self.basis[chosen]
        self.diagonal, self.beside = self.diagonal[chosen], self.beside[chosen]


def _ritz(diagonal, beside):
    """The largest eigenvalues of symmetric tridiagonal matrices, (k,), and their residuals."""
    matrices = diagonal[:, :, None] * np.eye(diagonal.shape[1])
    off = np.arange(diagonal.shape[1] - 1)
    matrices[:, off, off + 1] = matrices[:, off + 1, off] = beside[:, :-1]
    values, vectors = np.linalg.eigh(matrices)
    return values[:, -1], beside[:, -1] * np.abs(vectors[:, -1, -1])


def _missing(size, steps):
    """The share eps by which the largest Ritz value may be too small, but for `CHANCE`."""
    share = (np.log(1.648 * np.sqrt(size) / CHANCE) / (2 * steps - 1)) ** 2
    return min(share, 1 - 1e-12)
