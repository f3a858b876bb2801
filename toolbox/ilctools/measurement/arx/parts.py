"""Parts of each B that have poles of their own: slow parts and resonant parts.

The lags of a B end after a quarter of the samples of the longest trial, and by the prior late lags
are small. A part lasts longer. The poles p of the parts are given. With the gain g of a part and
the signal s = g / (z - p) u, the unknowns x and x' of a part add to the output

    a slow part, whose p is real:          x s(t),
    a resonant part, whose p is complex:   x Re s(t) + x' Im s(t).                              (7)

The time constant of one *slow part* is the length of the longest trial. The time constant of the
other one is a third of this length. A plant may have a small part that is far slower than its other
dynamics. Without slow parts, the regression would treat this part as drift, and would not see the
error.

*Resonant parts* are added at frequencies where the residual shows a resonance, see `resonances`.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

# Inverse time constants of slow parts, in 1 / (the longest trial), found by counting.
SLOW = np.array([1.0, 3.0])
# Rates at which the three resonant parts at one frequency decay, in 1 / (the longest trial), found
# by counting. Together, they describe resonances with other rates and near frequencies, too.
RESONANT = np.array([2.0, 4.0, 8.0])
# The prior makes slow parts a twentieth of the output. A resonance may be as large as the output.
LARGER_THAN_SLOW = 20.0


class Parts(NamedTuple):
    """The slow parts of each B, and then its resonant parts."""

    poles: np.ndarray  # (pole,), complex; of two conjugate poles the one with a positive angle

    @classmethod
    def of(cls, longest: int, resonances: np.ndarray) -> "Parts":
        """Make the slow parts, and three resonant parts at each angle omega Ts of `resonances`.

        The argument `longest` is the number of samples of the longest trial.
        """
        resonant = resonant_poles(longest, resonances).ravel()
        return cls(np.append(np.exp(-SLOW / longest), resonant))

    @property
    def resonant(self) -> np.ndarray:
        """Mask of the poles of resonant parts, shape (pole,)."""
        return self.poles.imag > 0

    @property
    def size(self) -> int:
        """The number of unknowns: one of each slow part, two of each resonant part."""
        return len(self.poles) + np.count_nonzero(self.resonant)

    @property
    def _g(self):
        """The gains: the frequency response of a slow part, and of Re s, has this peak."""
        at_peak = np.where(self.resonant, 2 * LARGER_THAN_SLOW, 1.0)
        return at_peak * (1 - np.abs(self.poles))

    def impulses(self, n: int) -> np.ndarray:
        """Compute n coefficients for each unknown, from lag 1 on, shape (unknown, n)."""
        return self._by_unknown(self._g[:, None] * self.poles[:, None] ** np.arange(n))

    def answers(self, u: np.ndarray) -> np.ndarray:
        """Compute the signals that (7) multiplies by the unknowns, shape (unknown, time)."""
        return self._by_unknown(self._g[:, None] * answers(self.poles, u))

    def _by_unknown(self, s):
        return np.concatenate([s.real, s.imag[self.resonant]])

    def waves(self, omega: np.ndarray) -> np.ndarray:
        """Compute the frequency response for each unknown at n angles omega Ts, (n, unknown)."""
        z = np.exp(1j * omega)[:, None]
        of_s, of_conjugate = self._g / (z - self.poles), self._g / (z - self.poles.conj())
        real, imag = (of_s + of_conjugate) / 2, (of_s - of_conjugate) / 2j
        return np.hstack([real, imag[:, self.resonant]])


def resonant_poles(longest: int, omega: np.ndarray) -> np.ndarray:
    """Compute the poles of the resonant parts at each of n angles omega Ts, shape (n, 3)."""
    return np.exp(-RESONANT / longest + 1j * np.reshape(omega, (-1, 1)))


def answers(poles: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Compute 1 / (z - p) u for each pole p of an array; time is the last axis."""
    s = [lfilter([0, 1], [1, -p], u) for p in poles.ravel()]
    return np.reshape(s, (*poles.shape, len(u)))
