"""Interpolate a sampled frequency response by splines, bound their error, and extend it below.

Cubic splines connect the samples, and straight lines connect their radius. Measured grids are
linear or logarithmic, and plants are smooth over omega or over log omega. Both interpolations use
the axis, omega or log omega, on which splines predict every other sample better.

A spline misses P between its samples. To estimate this error, a second spline runs through every
other sample, and its error at the samples that were left out is computed. The distance between
its samples is twice as large. Between two neighbours, the larger of their two errors, times
4 t (1 - t), is a radius. Here t runs from 0 to 1 from one neighbour to the other. P lies within
the radius if the resonances of P show in the samples. An error that the radius of the samples
covers is not counted again.

Below the first sample, at omega_1 > 0, P is not known. But P is real at rest, and about rest its
real part is even and its imaginary part odd. With x = omega / omega_1, P is therefore taken to be

    P(omega) = Re P(omega_1) + j x Im P(omega_1) + Delta Re P(omega_1) + E,
    ||Delta|| <= d,    ||E|| <= r,    d = s + t^2, at most t where s <= t,
    s = sigma_max((Re P(2 omega_1) - Re P(omega_1)) Re P(omega_1)^-1),
    t = sigma_max(Im P(omega_1) Re P(omega_1)^-1),

where r is the radius of the first sample. The sample nearest to 2 omega_1 stands for
P(2 omega_1), and the change up to this sample is scaled in proportion to omega^2. If this sample
is above COARSE_STEP omega_1, d is t at least. A real part that moves as omega^2 moves by s / 3
below omega_1. The real part of a first-order lag moves by t^2. For one channel, t is the tangent
of the phase. Delta Re P does not depend on the units of y, so that channels with a large gain do
not hide a channel with a small one.

From d = 1 on, which is reached at a phase of 45 degrees at the latest, this region contains
singular plants, and the phase may have turned before. Then P is anything that is not larger than
at omega_1, and no filter has a sigma_max(M) below |Q| there.

The region was tried on 30 plants. With omega_1 at 1/1000, 1/100, 1/50, 1/20 and 1/10 of the
cut-off, the region contains 30, 29, 28, 24 and 24 of these plants. The region does not contain a
plant with a slow part of little gain below omega_1. Only the certificate counts this region. Bounds
on M are not imposed there, as no filter has less than |Q| d at rest. Among 58 designs of a finite
filter, seven exceeded M_max = 0.9 there, and all seven had d above 0.7. If the numbers of inputs
and outputs differ, a ball with the radius d sigma_max(Re P(omega_1)) contains this region, and
rates are larger.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.singular_values import largest_singular_values

SAME_FREQUENCY = 1e-9  # relative: two frequencies that are nearer are the same
FEWEST_TO_HALVE = 4  # samples: with fewer, no sample can be left out
COARSE_STEP = (
    3  # times the first frequency: a second sample above this does not show how P moves below
)


class Assumed(NamedTuple):
    """An assumption on which a design rests, as a line of text that is printed."""

    text: str

    def __str__(self):
        return f"assumed: {self.text}"


class Region(NamedTuple):
    """All P + Delta W + E with ||Delta|| <= moves and ||E|| <= radius, at some frequencies."""

    P: np.ndarray  # (k, p, m), complex
    W: np.ndarray  # (any, m)
    moves: float
    radius: np.ndarray  # (k,)

    @property
    def widest(self) -> np.ndarray:
        """The radius of a ball about P that contains the whole region, (k,)."""
        return self.radius + self.moves * np.linalg.norm(self.W, 2)


@dataclass(frozen=True, eq=False)
class Samples:
    """A frequency response known by its samples, and the error that these may have."""

    omega: np.ndarray  # (n,), rad/s
    P: np.ndarray  # (n, p, m), complex
    radius: np.ndarray  # (n,)
    low: "Samples | None" = None  # measured from zero to the first frequency

    @cached_property
    def _over(self):
        """The axis, omega or log omega, on which splines miss less, and what they miss, (n,)."""
        axes = (np.asarray, np.log) if self.omega[0] > 0 else (np.asarray,)
        each = ((axis, missed(axis(self.omega), self.P)) for axis in axes)
        return min(each, key=lambda pair: pair[1].max())

    @property
    def axis(self):
        """The function that maps omega to the axis of interpolation: omega or log omega."""
        return self._over[0]

    @cached_property
    def missed(self) -> np.ndarray:
        """The error of splines at the samples, as far as it exceeds the radius, (n,)."""
        return np.maximum(self._over[1] - self.radius, 0)

    def radius_at(self, omega) -> np.ndarray:
        """The radius by straight lines, (k,); beyond the ends, the radius at the end."""
        return np.interp(self._place(omega), self.axis(self.omega), self.radius)

    def at(self, omega) -> tuple[np.ndarray, np.ndarray]:
        """P (k, p, m), and its radius (k,), which includes what splines may miss.

        Above the last sample, P and the radius are as at the last sample.
        """
        known, place = self.axis(self.omega), self._place(omega)
        after = np.searchsorted(known, place).clip(1, len(known) - 1)
        t = (place - known[after - 1]) / (known[after] - known[after - 1])
        more = 4 * t * (1 - t) * np.maximum(self.missed[after - 1], self.missed[after])
        P, radius = CubicSpline(known, self.P)(place), self.radius_at(omega) + more
        if (below := self.outside(omega) & (omega < self.omega[0])).any():
            region = self.below(omega[below])
            P[below], radius[below] = region.P, region.widest
        return P, radius

    @cached_property
    def moves(self) -> float:
        """d: by which share of its real part P may move below its first sample."""
        (first, *others), P = self.omega, self.P[0]
        later = 1 + np.abs(np.array(others) - 2 * first).argmin()
        times = self.omega[later] / first
        real = 3 * (self.P[later].real - P.real) / (times**2 - 1)  # in proportion to omega^2
        try:
            s, t = (np.linalg.norm(_over(X, P.real), 2) for X in (real, P.imag))
        except np.linalg.LinAlgError:
            return np.inf
        if s > t:
            return float(s + t**2)
        return float(t if times > COARSE_STEP else min(s + t**2, t))

    @property
    def known_below(self) -> bool:
        """Whether the first samples determine P below them, which needs d < 1."""
        return self.moves < 1

    @property
    def below_in_words(self) -> Assumed:
        """What is assumed below the first sample, in words."""
        first = f"{self.omega[0]:.4g} rad/s"
        if self.low is not None:
            return Assumed(
                f"below {first}, P is what the measured response says at zero frequency and up "
                f"to there, within {self.low.at(self.low.omega)[1].max():.2g}"
            )
        if self.known_below:
            beside = ", in addition to its radius" if self.radius[0] else ""
            return Assumed(
                f"below {first}, P is within {100 * self.moves:.2g} % of a straight line from "
                f"P there to its real part at zero frequency{beside}"
            )
        return Assumed(
            f"below {first}, where P is not known because its phase or gain changes too fast, "
            "P is not larger than at this frequency, at any phase"
        )

    def below(self, omega) -> Region:
        """The region in which P is assumed to lie below the first sample, at frequencies (k,)."""
        if self.low is not None:
            P, radius = self.low.at(omega)
            return Region(P, np.eye(P.shape[-1]), 0.0, radius)
        real, imag = self.P[0].real, self.P[0].imag
        P = real + 1j * imag * (omega / self.omega[0])[:, None, None]
        radius = np.full(len(omega), self.radius[0])
        if self.known_below and len(real) == real.shape[1]:
            return Region(P, real, self.moves, radius)
        if self.known_below:  # a ball that holds Delta Re P, or Re P Delta
            radius += self.moves * np.linalg.norm(real, 2)
            return Region(P, np.eye(real.shape[1]), 0.0, radius)
        # a ball about P with twice this radius contains all that is not larger than this
        size = np.linalg.norm(self.P[0], 2) + self.radius[0]
        return Region(P, size * np.eye(real.shape[1]), 2.0, 0 * radius)

    def outside(self, omega) -> np.ndarray:
        """Return which frequencies are below the first sample or above the last, (k,), bool."""
        return np.abs(omega - np.clip(omega, *self.omega[[0, -1]])) > SAME_FREQUENCY * np.abs(omega)

    def _place(self, omega):
        return self.axis(np.clip(omega, *self.omega[[0, -1]]))


def _over(X, P):
    """X P^-1 for a square P; else the least-squares Delta of X = Delta P, or of X = P Delta."""
    rows, columns = P.shape
    if rows == columns:
        return np.linalg.solve(P.T, X.T).T
    inverse = np.linalg.pinv(P)
    return X @ inverse if rows > columns else inverse @ X


def missed(x, P) -> np.ndarray:
    """sigma_max(P - S) at each sample, (n,), where S is the spline of every other sample over x.

    The value at each end is the value of the sample next to the end. With fewer than four samples,
    the result is sigma_max(P).
    """
    sizes = largest_singular_values(P)
    if len(x) < FEWEST_TO_HALVE:
        return sizes
    for first in (1, 2):  # between the two at the ends
        out = np.arange(first, len(x) - 1, 2)
        S = CubicSpline(np.delete(x, out), np.delete(P, out, axis=0))(x[out])
        sizes[out] = largest_singular_values(P[out] - S)
    sizes[[0, -1]] = sizes[[1, -2]]
    return sizes
