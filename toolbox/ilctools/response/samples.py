"""Interpolate a sampled frequency response by splines, and extend it below its first sample.

Each sample has a radius, a bound on the distance of the sample from the true P. Cubic splines
interpolate P, and straight lines interpolate the radius. Measured grids are linear or logarithmic,
and plants are smooth over omega or over log omega. Both interpolations use omega or log omega as
their axis. The better axis is found by splines through every other sample, which predict the
remaining samples.

Between its samples, a spline differs from P. This error is estimated from a second spline, which
uses every other sample, so that the distance between its samples is twice as large. Its error is
computed at the samples that it does not use. Between two neighbouring samples, an additional radius
is the larger of the two errors at these samples, times 4 t (1 - t). Here t increases from 0 at one
sample to 1 at the other. P lies within this radius if the samples resolve the resonances of P. An
error that the radius of the samples covers is not counted again.

Below the first sample, at omega_1 > 0, P is not known. But P is real at zero frequency. As a
function of omega, the real part of P is even and its imaginary part is odd. With x = omega /
omega_1, P is therefore taken to be

    P(omega) = Re P(omega_1) + j x Im P(omega_1) + Delta Re P(omega_1) + E,
    ||Delta|| <= d,    ||E|| <= r,    d = s + t^2, at most t where s <= t,
    s = sigma_max((Re P(2 omega_1) - Re P(omega_1)) Re P(omega_1)^-1),
    t = sigma_max(Im P(omega_1) Re P(omega_1)^-1),

where r is the radius of the first sample, and Delta and E are unknown matrices. s and t estimate by
how much the real part of P may change below omega_1. The sample nearest to 2 omega_1 replaces P(2
omega_1), and the change of P up to this sample is scaled in proportion to omega^2. If this sample
is above COARSE_STEP omega_1, d is at least t. If the real part changes in proportion to omega^2, it
changes by s / 3 below omega_1. The real part of a first-order lag changes by t^2. For one channel,
t is the tangent of the phase. The term Delta Re P is relative to P, and does not depend on the
units of y. A channel with a large gain therefore does not hide a channel with a small gain.

All P of this form are called the region. If d is one or more, the region contains singular plants,
and the phase may turn by any angle below omega_1. If the phase at omega_1 reaches 45 degrees, d is
at least one. If d is one or more, P below omega_1 is taken to be any matrix whose norm is at most
the norm of P at omega_1 plus r. No filter then has a sigma_max(M) below |Q| at these frequencies.

The region was tested on 30 plants. With omega_1 at 1/1000, 1/100, 1/50, 1/20 and 1/10 of the
cut-off, the region contains 30, 29, 28, 24 and 24 of these plants, respectively. The region does
not contain a plant with a slow mode of small gain below omega_1. Only the certificate uses this
region. The design does not bound M in the region, because no filter has a sigma_max(M) below |Q| d
at zero frequency. Among 58 designs of a finite filter, seven exceeded M_max = 0.9 there, and all
seven had d above 0.7. If the numbers of inputs and outputs differ, the region is replaced by a ball
that contains it, with the radius d sigma_max(Re P(omega_1)). Rates are then larger.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.singular_values import largest_singular_values

SAME_FREQUENCY = 1e-9  # relative: two frequencies with a smaller difference are the same
FEWEST_TO_HALVE = 4  # samples: with fewer, no sample can be left out
COARSE_STEP = (
    3  # ratio of the second to the first sample, above which they do not show how P changes below
)


class Assumed(NamedTuple):
    """An assumption of a design, as a line of text that is printed."""

    text: str

    def __str__(self):
        return f"assumed: {self.text}"


class Region(NamedTuple):
    """A region in which the plant lies at some frequencies.

    The region contains all P + Delta W + E with ||Delta|| <= moves and ||E|| <= radius.
    """

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
    """A frequency response that is known by samples, and the largest errors of the samples."""

    omega: np.ndarray  # (n,), rad/s
    P: np.ndarray  # (n, p, m), complex
    radius: np.ndarray  # (n,): bound on the error of each sample
    low: "Samples | None" = None  # P from zero to the first frequency, if it was measured

    @cached_property
    def _over(self):
        """The axis on which splines have the smaller error, and this error at the samples, (n,)."""
        axes = (np.asarray, np.log) if self.omega[0] > 0 else (np.asarray,)
        each = ((axis, missed(axis(self.omega), self.P)) for axis in axes)
        return min(each, key=lambda pair: pair[1].max())

    @property
    def axis(self):
        """The function that maps omega to the axis of interpolation: omega or log omega."""
        return self._over[0]

    @cached_property
    def missed(self) -> np.ndarray:
        """The part of the error of splines that exceeds the radius of the samples, (n,)."""
        return np.maximum(self._over[1] - self.radius, 0)

    def radius_at(self, omega) -> np.ndarray:
        """Interpolate the radius by straight lines, shape (k,).

        Outside the samples, the radius is constant.
        """
        return np.interp(self._place(omega), self.axis(self.omega), self.radius)

    def at(self, omega) -> tuple[np.ndarray, np.ndarray]:
        """Return P (k, p, m) and its radius (k,), which includes the error of the splines.

        Above the last sample, P and the radius are constant. Below the first sample, they are P and
        the radius of a ball that contains the region of :meth:`below`.
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
        """d, a bound on the relative change of the real part of P below the first sample."""
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
        """Whether d is below one, so that two samples determine P at lower frequencies."""
        return self.moves < 1

    @property
    def below_in_words(self) -> Assumed:
        """The assumption on P below the first sample, in words."""
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
        """Return the region in which P is assumed to lie at frequencies below the first sample."""
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
        # a ball around P with twice this radius contains all plants with a norm up to `size`
        size = np.linalg.norm(self.P[0], 2) + self.radius[0]
        return Region(P, size * np.eye(real.shape[1]), 2.0, 0 * radius)

    def outside(self, omega) -> np.ndarray:
        """Return which frequencies are below the first sample or above the last, (k,), bool."""
        return np.abs(omega - np.clip(omega, *self.omega[[0, -1]])) > SAME_FREQUENCY * np.abs(omega)

    def _place(self, omega):
        return self.axis(np.clip(omega, *self.omega[[0, -1]]))


def _over(X, P):
    """Solve Delta P = X for Delta, by least squares if P is not square.

    If P has more columns than rows, P Delta = X is solved instead.
    """
    rows, columns = P.shape
    if rows == columns:
        return np.linalg.solve(P.T, X.T).T
    inverse = np.linalg.pinv(P)
    return X @ inverse if rows > columns else inverse @ X


def missed(x, P) -> np.ndarray:
    """Return sigma_max(P - S) at each sample, (n,), where S is a spline through other samples.

    S is a spline over x through the two ends and through every second sample between them. At each
    sample, the S that does not use this sample is taken. At the two ends, the value of the
    neighbouring sample is returned. With fewer than four samples, the result is sigma_max(P).
    """
    sizes = largest_singular_values(P)
    if len(x) < FEWEST_TO_HALVE:
        return sizes
    for first in (1, 2):  # the two samples at the ends always stay
        out = np.arange(first, len(x) - 1, 2)
        S = CubicSpline(np.delete(x, out), np.delete(P, out, axis=0))(x[out])
        sizes[out] = largest_singular_values(P[out] - S)
    sizes[[0, -1]] = sizes[[1, -2]]
    return sizes
