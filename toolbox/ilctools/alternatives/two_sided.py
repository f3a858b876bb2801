"""A learning filter that is known by its frequency response, and acts by the fast transform.

Most alternatives to a short filter (44) reach far into the past and the future at once. None of
them needs a recursion of its own: between two trials the whole last trial is known.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from ilctools import arguments
from ilctools.filters import LearningOperator

SHORTEST, LONGEST = 2**12, 2**20  # samples of the transform, for an impulse response
NEGLIGIBLE = 1e-9  # of its largest entry
MOST = 0.999  # of its energy; half of the rest is left out at each end


@dataclass(frozen=True)
class TwoSidedFilter:
    """A learning filter for a :class:`Law`, for signals that are zero outside the trial."""

    response: Callable  # from omega (rad/s), (n,), to L, (n, channels, channels)
    channels: int
    Ts: float  # s

    def __post_init__(self):
        arguments.instance("response", self.response, Callable)
        arguments.whole("channels", self.channels, 1)
        arguments.sampling_period("Ts", self.Ts)

    def frequency_response(self, omega) -> np.ndarray:
        """L at `omega` (rad/s), shape (n, channels, channels), complex."""
        return self.response(arguments.row("omega", omega))

    @cached_property
    def _taps(self):
        return two_sided_taps(self)

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, channels)."""
        signal = arguments.array("signal", signal, (..., "time", self.channels))
        lags, taps = self._taps
        samples = signal.shape[-2]
        n = next_fast_len(samples + len(taps), real=True)
        spectrum = rfft(taps, n, axis=0) @ rfft(signal, n, axis=-2)[..., None]
        filtered = irfft(spectrum[..., 0], n, axis=-2)
        return np.roll(filtered, lags[0], axis=-2)[..., :samples, :]


def two_sided_taps(L: LearningOperator) -> tuple[np.ndarray, np.ndarray]:
    """Two-sided impulse response of a learning filter, by the inverse transform of its response.

    Parameters
    ----------
    L : LearningOperator

    Returns
    -------
    lags : ndarray of int, shape (n,)
        From the future (below zero) to the past.
    taps : ndarray, shape (n, channels, channels)
        L e at p is the sum of ``taps[i] @ e[p - lags[i]]``. What is left out is below `NEGLIGIBLE`;
        of a filter with a pole on the unit circle, or nearly, a ValueError says that it is not.
    """
    arguments.instance("L", L, LearningOperator)
    n = SHORTEST
    while n <= LONGEST:
        omega = rfftfreq(n, L.Ts / (2 * np.pi))
        taps = np.fft.fftshift(irfft(L.frequency_response(omega), n, axis=0), axes=0)
        size = np.abs(taps).max(axis=(1, 2))
        quarter = n // 4
        ends = max(size[:quarter].max(), size[-quarter:].max())
        if ends <= NEGLIGIBLE * size.max():
            lags = np.arange(-n // 2, n // 2)
            return lags[quarter:-quarter], taps[quarter:-quarter]
        n *= 2
    raise ValueError(
        f"L has an impulse response that does not decay within {LONGEST // 4} samples: a pole, "
        "which for an inverse is a zero of P, is on the unit circle or next to it. Take a design "
        "with a weight on v, such as norm_optimal"
    )


def extent(L: LearningOperator) -> tuple[int, int]:
    """How far a learning filter looks ahead and back, in samples, with nearly all of its energy.

    Either is below zero if the filter begins later than that.
    """
    lags, taps = two_sided_taps(L)
    energy = np.cumsum((taps**2).sum(axis=(1, 2)))
    energy /= energy[-1]
    first = np.searchsorted(energy, (1 - MOST) / 2)
    last = np.searchsorted(energy, (1 + MOST) / 2)
    return int(-lags[first]), int(lags[last])
