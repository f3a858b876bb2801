"""The largest norm of a trial among several plants, by Lanczos iterations that run together.

The map of a trial of plant k is T_k = Q_N (I - L_N P_k), see :func:`.finite.trial_map`. Q and L
are the same for all plants. So L_N is made a matrix once, and filters the signals of many plants at
the same time. The iteration on T_k^T T_k ends for all of them when the residual of each largest
Ritz value is small.
"""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ilctools.filters import Filter, ZeroPhaseButterworth
from ilctools.models import impulse_response

TOGETHER = 32  # plants of which the iteration runs at the same time: 64 take as long for each
BETWEEN = 8  # steps from one look at the Ritz values to the next: each takes as long as a step
TINY = np.finfo(float).tiny  # length of what is left of a plant whose iteration has ended
TOLERANCE = 1e-8  # relative residual of an eigenvector, as of one plant alone


def largest_trial_norm(plants, Q: ZeroPhaseButterworth, L: Filter, samples: int) -> float:
    """The largest 2-norm of a trial among some plants, see :func:`.finite.trial_norm`."""
    units = np.eye(samples * L.columns)
    L_N = L.apply(units.reshape(-1, samples, L.columns)).reshape(len(units), -1).T
    parts = [plants[first : first + TOGETHER] for first in range(0, len(plants), TOGETHER)]
    return max(_largest(Maps(part, Q, L_N, samples)) for part in parts)


class Maps:
    """The maps T_k of some plants, each on a signal of its own."""

    def __init__(self, plants, Q, L_N, samples):
        self.Q, self.L_N, self.length = Q, L_N, next_fast_len(2 * samples)  # no sample wraps round
        p, m = plants[0].shape
        self.shape, self.outputs = (len(plants), samples, m), (len(plants), samples, p)
        self.H = rfft([impulse_response(P, samples) for P in plants], self.length, axis=1)

    def normal(self, v) -> np.ndarray:
        """T_k^T T_k v_k, of shape (plants, samples channels)."""
        changed = v - self._filtered(self.H, v.reshape(self.shape)) @ self.L_N.T
        back = self.Q.apply_transposed(self.Q.apply(changed.reshape(self.shape))).reshape(v.shape)
        errors = (back @ self.L_N).reshape(self.outputs)
        return back - self._filtered(self.H.conj().swapaxes(2, 3), errors)

    def _filtered(self, H, v):
        """P_k v_k, or with H adjoint P_k^T v_k, raveled."""
        V = rfft(v, self.length, axis=1)[..., None]
        signals = irfft((H @ V)[..., 0], self.length, axis=1)[:, : v.shape[1]]
        return signals.reshape(len(v), -1)


def _largest(maps) -> float:
    """The largest norm of some maps."""
    count, samples, channels = maps.shape
    size = samples * channels
    start = np.random.default_rng(0).standard_normal(size)  # the same in every run
    basis = np.tile(start / np.linalg.norm(start), (count, 1, 1))
    projected = np.zeros((count, 0, 0))
    for step in range(1, size + 1):
        w = maps.normal(basis[:, -1])[..., None]
        products = basis @ w
        projected = np.pad(projected, [(0, 0), (0, 1), (0, 1)])
        projected[:, :, -1:] = products
        w -= basis.swapaxes(1, 2) @ products
        w -= basis.swapaxes(1, 2) @ (basis @ w)  # what rounding has left of them
        length = np.linalg.norm(w, axis=1)
        if step % BETWEEN == 0 or step == size:
            values, vectors = np.linalg.eigh(projected, UPLO="U")
            residual = length[:, 0] * np.abs(vectors[:, -1, -1])
            if step == size or np.all(residual <= TOLERANCE * values[:, -1]):
                break
        basis = np.append(basis, (w.swapaxes(1, 2) / np.maximum(length, TINY)[..., None]), axis=1)
    return float(np.sqrt(values[:, -1].max()))
