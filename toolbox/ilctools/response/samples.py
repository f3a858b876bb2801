"""Between the samples of a frequency response: splines, and by how much they may miss; and below.

Samples run along cubic splines, their radius along straight lines. Measured grids are linear or
logarithmic, plants smooth over one or the other: both run over omega or log omega, over that in
which splines predict every other sample better.

A spline misses P between its samples. By how much is estimated by what the spline of every other
sample misses of those left out, at twice the distance. The larger of what is missed at two
neighbours, times 4 t (1 - t) from one to the other, is a radius, in which P lies if its resonances
show in the samples; what the radius of the samples covers counts once.

Below the first sample, at omega_1 > 0, P is not known, but for this: at rest it is real, and about
rest its real part is even and its imaginary part odd. So with x = omega / omega_1 it is taken to be

    P(omega) = Re P(omega_1) + j x Im P(omega_1) + Delta Re P(omega_1) + E,
    ||Delta|| <= d,    ||E|| <= r,    d = s + t^2, at most t where s <= t,
    s = sigma_max((Re P(2 omega_1) - Re P(omega_1)) Re P(omega_1)^-1),
    t = sigma_max(Im P(omega_1) Re P(omega_1)^-1),

r the radius of the first sample, and P(2 omega_1) the sample that is nearest to it, in proportion
to omega^2; if that is above COARSE_STEP omega_1, d is t at least. A real part that moves as omega^2
moves by s / 3 below omega_1, that of a lag of first order by t^2; of one channel, t is the tangent
of the phase. Delta Re P does not depend on the units of y, and a channel whose gain is small is not
drowned by the others. From d = 1 on, at a phase of 45 degrees at the latest, singular plants are
among these, and the phase may have turned before: then P is anything that is not larger than at
omega_1, and no filter has a sigma_max(M) below |Q| there. With omega_1 at 1/1000, 1/100, 1/50, 1/20
and 1/10 of the cut-off 30, 29, 28, 24 and 24 of 30 plants lie within; not where a slow part of
little gain lies below. Only the certificate counts this region: bounds on M are not imposed there,
as no filter has less than |Q| d at rest. Of 58 designs of a finite filter seven passed M_max = 0.9
there, all with d above 0.7. With other numbers of inputs than of outputs a ball holds this region,
with the radius d sigma_max(Re P(omega_1)), and rates are larger.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.singular_values import largest_singular_values

SAME_FREQUENCY = 1e-9  # relative: two frequencies that are nearer are the same
FEWEST_TO_HALVE = 4  # samples of which every other one can be left out
COARSE_STEP = (
    3  # times the first frequency: a next one above does not show how P moves about the first
)


class Assumed(NamedTuple):
    """An assumption on which a design rests, among lines of what is known."""

    text: str

    def __str__(self):
        return f"assumed: {self.text}"


class Region(NamedTuple):
    """P + Delta W + E, ||Delta|| <= moves, ||E|| <= radius, at some frequencies."""

    P: np.ndarray  # (k, p, m), complex
    W: np.ndarray  # (any, m)
    moves: float
    radius: np.ndarray  # (k,)

    @property
    def widest(self) -> np.ndarray:
        """The radius of a ball that holds all of it, (k,)."""
        return self.radius + self.moves * np.linalg.norm(self.W, 2)


@dataclass(frozen=True, eq=False)
class Samples:
    """A frequency response by its samples, and how far off these may be."""

    omega: np.ndarray  # (n,), rad/s
    P: np.ndarray  # (n, p, m), complex
    radius: np.ndarray  # (n,)
    low: "Samples | None" = None  # from zero to the first frequency, of what is measured there

    @cached_property
    def _over(self):
        """That of omega and log omega over which splines miss less; by how much, (n,)."""
        axes = (np.asarray, np.log) if self.omega[0] > 0 else (np.asarray,)
        each = ((axis, missed(axis(self.omega), self.P)) for axis in axes)
        return min(each, key=lambda pair: pair[1].max())

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
        """P (k, p, m), and the radius (k,) with what splines may miss; above the last as there."""
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
        """d: by how much of it P may move below its first sample."""
        (first, *others), P = self.omega, self.P[0]
        later = 1 + np.abs(np.array(others) - 2 * first).argmin()
        times = self.omega[later] / first
        real = 3 * (self.P[later].real - P.real) / (times**2 - 1)  # as omega^2, if not by two
        try:
            s, t = (np.linalg.norm(_over(X, P.real), 2) for X in (real, P.imag))
        except np.linalg.LinAlgError:
            return np.inf
        if s > t:
            return float(s + t**2)
        return float(t if times > COARSE_STEP else min(s + t**2, t))

    @property
    def known_below(self) -> bool:
        """Whether the first samples say what P is below them."""
        return self.moves < 1

    @property
    def below_in_words(self) -> Assumed:
        """What is assumed below the first sample."""
        first = f"{self.omega[0]:.4g} rad/s"
        if self.low is not None:
            return Assumed(
                f"below {first} P is what the measured response says at rest and up to there, "
                f"within {self.low.at(self.low.omega)[1].max():.2g}"
            )
        if self.known_below:
            beside = ", beside its radius" if self.radius[0] else ""
            return Assumed(
                f"below {first} P is within {100 * self.moves:.2g} % of a straight line from P "
                f"there to its real part at rest{beside}"
            )
        return Assumed(
            f"below {first}, where P is not known, as its phase or gain moves too much, it is not "
            "larger than there, at any phase"
        )

    def below(self, omega) -> Region:
        """What is assumed below the first sample, at some frequencies (k,)."""
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
        # about a P of that size, all that is not larger
        size = np.linalg.norm(self.P[0], 2) + self.radius[0]
        return Region(P, size * np.eye(real.shape[1]), 2.0, 0 * radius)

    def outside(self, omega) -> np.ndarray:
        """Which frequencies are beyond the ends, (k,), bool."""
        return np.abs(omega - np.clip(omega, *self.omega[[0, -1]])) > SAME_FREQUENCY * np.abs(omega)

    def _place(self, omega):
        return self.axis(np.clip(omega, *self.omega[[0, -1]]))


def _over(X, P):
    """X P^-1, where P has as many rows as columns; else Delta with X = Delta P, or X = P Delta."""
    rows, columns = P.shape
    if rows == columns:
        return np.linalg.solve(P.T, X.T).T
    inverse = np.linalg.pinv(P)
    return X @ inverse if rows > columns else inverse @ X


def missed(x, P) -> np.ndarray:
    """sigma_max(P - S), S the spline of every other sample over x: at each sample, (n,).

    At the ends that of the next one; of P itself with fewer than four samples.
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
