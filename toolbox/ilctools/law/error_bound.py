"""By how much an error of the model can change an output within a trial.

Let Delta, the error of a model, be a stable, linear and causal system with
||Delta(omega)|| <= r(omega). Let d be a signal of N samples that is zero before and after the
trial. Then, at each sample t of the trial and in each output,

    |(Delta d)(t)| <= rho(d) = (1 / M) sum_j rt_j ||D_j||,                                      (1)

where D is the transform of d, padded to M samples. The weights are

    rt = transform of c_k tau_k,    tau = (m tri_m + n tri_n) / (m - n),                        (2)
    tri_q(k) = max(0, 1 - |k| / q),    h = (N - 1) // 2,    n = N - 1 - h,    m = M - N - h,

where c_k are the Fourier coefficients of r over omega Ts. Within a trial the impulse response of
Delta acts at lags from zero to N - 1 only. The impulse response may therefore be multiplied by a
trapezoid that is one at these lags. The trapezoid is (m tri_m - n tri_n) / (m - n), centred at h.
The trapezoid is zero at all lags that would wrap around in a circular convolution of M samples. The
transform of the trapezoid is a difference of two Fejer kernels, which are positive. Equation (2)
has their sum, see docs/proofs.md. The sum costs a factor of (m + n) / (m - n), which is 1.033 for
M = 32 N.

Delta is causal, and therefore the values of d after t do not affect the output at t. The trial is
divided into blocks. If b denotes the end of the block that contains t, or of any later block, then

    rho(t) = least rho(d up to b) among these b,                                                (3)

and rho(t) is zero before d begins.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len, rfft

PADDING = 32  # M / N: (1) is 1.033 times the integral of r ||D||; with 8, the factor is 1.17
BLOCKS = 16  # blocks of a trial in (3); with 64, rho(t) is 2 to 3 % smaller, in four times the time


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """The bound rho of (1) for all model errors within a radius, on trials of `samples` samples."""

    angles: np.ndarray  # omega Ts, (n,), increasing
    radius: np.ndarray  # r at the angles, (n,); linear between them, constant below and above
    samples: int

    @cached_property
    def padded(self) -> int:
        """M, the length of the transforms."""
        return next_fast_len(PADDING * self.samples, real=True)

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights rt_j / M, (M // 2 + 1,), doubled if a frequency also stands for its negative."""
        M, N = self.padded, self.samples
        h = (N - 1) // 2
        n, m = N - 1 - h, M - N - h

        def tau(k):
            return (np.maximum(0, m - np.abs(k)) + np.maximum(0, n - np.abs(k))) / (m - n)

        # r is linear between the M points: its c_k are the coefficients of the points, times sinc^2
        c, k = np.fft.irfft(self._above_radius(), M), np.arange(M)
        folded = sum(tau(lag) * np.sinc(lag / M) ** 2 for lag in (k, k - M))
        rt = rfft(c * folded).real  # (2)
        same = np.bincount(np.minimum(k, M - k))  # number of the M frequencies with this size of D
        return same * rt / M

    def _above_radius(self):
        """Compute values at the M points such that lines between them are nowhere below r."""
        points = 2 * np.pi * np.arange(self.padded // 2 + 1) / self.padded
        r = np.interp(points, self.angles, self.radius)
        left = np.clip(np.searchsorted(points, self.angles) - 1, 0, len(points) - 2)
        for neighbour in (left, left + 1):
            np.maximum.at(r, neighbour, self.radius)
        return r

    def of(self, d) -> float:
        """Compute rho(d) by (1) for a signal (time, m)."""
        return self.weights @ np.linalg.norm(rfft(d, self.padded, axis=0), axis=1)

    def over_time(self, d) -> np.ndarray:
        """Compute rho(t) by (3) at each sample of a signal (samples, m)."""
        rho, moving = np.zeros(len(d)), np.flatnonzero(d.any(axis=1))
        if not len(moving):
            return rho
        begin, least = moving[0], np.inf
        ends = np.unique(np.linspace(begin, len(d), BLOCKS + 1).round().astype(int))
        for start, end in reversed([*pairwise(ends)]):
            least = min(least, self.of(d[:end]))
            rho[start:end] = least
        return rho
