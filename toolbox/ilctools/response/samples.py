"""Between the samples of a frequency response: splines, and by how much they may miss.

Samples run along cubic splines, their radius along straight lines. Measured grids are linear or
logarithmic, plants smooth over one or the other: both run over omega or log omega, over that in
which splines predict every other sample better.

A spline misses P between its samples. By how much is estimated by what the spline of every other
sample misses of those left out, at twice the distance. The larger of what is missed at two
neighbours, times 4 t (1 - t) from one to the other, is a radius, in which P lies if its resonances
show in the samples; what the radius of the samples covers counts once.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.singular_values import largest_singular_values

SAME = 1e-9  # relative: two frequencies that are nearer are the same
FEWEST = 4  # samples of which every other one can be left out


@dataclass(frozen=True, eq=False)
class Samples:
    """A frequency response by its samples, and how far off these may be."""

    omega: np.ndarray  # (n,), rad/s
    P: np.ndarray  # (n, p, m), complex
    radius: np.ndarray  # (n,)

    @cached_property
    def _over(self):
        return axis_of(self.omega, self.P)

    @property
    def axis(self):
        """Of omega and log omega that over which samples are interpolated."""
        return self._over[0]

    @cached_property
    def missed(self) -> np.ndarray:
        """What splines miss at the samples, beyond the radius, (n,)."""
        return np.maximum(self._over[1] - self.radius, 0)

    def radius_at(self, omega) -> np.ndarray:
        """The radius (k,) by straight lines; beyond the ends as there."""
        return np.interp(self._place(omega), self.axis(self.omega), self.radius)

    def at(self, omega) -> tuple[np.ndarray, np.ndarray]:
        """P (k, p, m), and the radius (k,) with what splines may miss; beyond the ends as there."""
        known, place = self.axis(self.omega), self._place(omega)
        after = np.searchsorted(known, place).clip(1, len(known) - 1)
        t = (place - known[after - 1]) / (known[after] - known[after - 1])
        more = 4 * t * (1 - t) * np.maximum(self.missed[after - 1], self.missed[after])
        return CubicSpline(known, self.P)(place), self.radius_at(omega) + more

    def outside(self, omega) -> np.ndarray:
        """Which frequencies are beyond the ends, (k,), bool."""
        return np.abs(omega - np.clip(omega, *self.omega[[0, -1]])) > SAME * np.abs(omega)

    def _place(self, omega):
        return self.axis(np.clip(omega, *self.omega[[0, -1]]))


def axis_of(omega, P):
    """That of omega and log omega over which splines miss every other sample by less; by how much.

    The latter is (n,).
    """
    axes = (np.asarray, np.log) if omega[0] > 0 else (np.asarray,)
    return min(((axis, missed(axis(omega), P)) for axis in axes), key=lambda pair: pair[1].max())


def missed(x, P) -> np.ndarray:
    """sigma_max(P - S), S the spline of every other sample over x: at each sample, (n,).

    At the ends that of the next one; of P itself with fewer than four samples.
    """
    sizes = largest_singular_values(P)
    if len(x) < FEWEST:
        return sizes
    for first in (1, 2):  # between the two at the ends
        out = np.arange(first, len(x) - 1, 2)
        S = CubicSpline(np.delete(x, out), np.delete(P, out, axis=0))(x[out])
        sizes[out] = largest_singular_values(P[out] - S)
    sizes[[0, -1]] = sizes[[1, -2]]
    return sizes
