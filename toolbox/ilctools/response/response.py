"""What is known of P: frequency responses of plants, between their frequencies and beyond.

Models are known anywhere. Between samples P runs along cubic splines, the radius along straight
lines. Measured grids are linear or logarithmic, plants smooth over one or the other: both run over
omega or log omega, over that in which splines predict every other sample better.

A spline misses P between its samples. By how much is estimated by what the spline of every other
sample misses of those left out, at twice the distance. The larger of what is missed at two
neighbours, times 4 t (1 - t) from one to the other, is a radius, in which P lies if its resonances
show in the samples; what the radius of the samples covers counts once. Above the last sample P is
zero with a radius, its size there.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import control
import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.models import frequency_response
from ilctools.signals import Signals
from ilctools.singular_values import largest_singular_values

FEWEST = 4  # samples of which every other one can be left out
ROUNDING = 1e-9  # of an angle: two that are nearer are the same frequency


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency responses of one plant or several. Made by :func:`.response_of`."""

    omega: np.ndarray  # (n,): rad/s
    P: np.ndarray  # (p, n, m, m), complex, in units of `scale`; the nominal plant first
    Ts: float  # sampling period, s
    models: tuple[control.StateSpace | None, ...]  # of the plants; None of samples
    radius: np.ndarray | None  # (n,): P may be P + Delta, ||Delta|| <= radius; None: it is P
    scale: np.ndarray  # (m,): what counts as equally large in each channel
    signals: Signals  # of the nominal plant
    assumptions: tuple[str, ...] = ()  # what a measured P and its radius rest on

    @property
    def sampled(self) -> bool:
        """Whether some plant is known by samples only."""
        return None in self.models

    @property
    def angles(self) -> np.ndarray:
        """omega Ts, (n,)."""
        return self.omega * self.Ts

    def at(self, chosen) -> "Response":
        """At some of the frequencies, (n,) bool."""
        radius = None if self.radius is None else self.radius[chosen]
        return replace(
            self,
            omega=self.omega[chosen],
            P=self.P[:, chosen],
            radius=radius if np.any(radius) else None,
        )

    def anywhere(self, plant: int, omega) -> tuple[np.ndarray, np.ndarray]:
        """P (k, m, m) of a plant, and the radius (k,), at any frequencies.

        A radius of a model ends with the frequencies at which it is given.
        """
        omega, model, radius = np.asarray(omega), self.models[plant], np.zeros(len(omega))
        if model is not None and self.radius is None:
            return frequency_response(model, omega), radius
        known, place = self.axis(self.omega), self.axis(omega.clip(*self.omega[[0, -1]]))
        if self.radius is not None:
            radius = np.interp(place, known, self.radius)
        if model is not None:
            inside = (omega >= self.omega[0]) & (omega <= self.omega[-1])
            return frequency_response(model, omega), np.where(inside, radius, 0)
        P, missed = CubicSpline(known, self.P[plant])(place), self.missed[plant]
        after = np.searchsorted(known, place).clip(1, len(known) - 1)
        t = (place - known[after - 1]) / (known[after] - known[after - 1])
        radius += 4 * t * (1 - t) * np.maximum(missed[after - 1], missed[after])
        if self.beyond is not None:
            unknown = omega > self.omega[-1]
            P[unknown], radius = 0, np.where(unknown, self.beyond, radius)
        return P, radius

    @property
    def beyond(self) -> float | None:
        """The sigma_max(P) that is assumed above the last sample; None if P is known there."""
        if not self.sampled or self.angles[-1] >= np.pi - ROUNDING:
            return None
        samples = self.P[[model is None for model in self.models], -1]
        size = largest_singular_values(samples).max()
        return float(size if self.radius is None else size + self.radius[-1])

    @cached_property
    def axis(self):
        """Of omega and log omega that over which samples are interpolated."""
        return axis_of(self.omega, self.P[0])

    @cached_property
    def missed(self) -> np.ndarray:
        """What splines miss of each plant at its samples, beyond the radius, (p, n)."""
        of_all = np.array([missed(self.axis(self.omega), P) for P in self.P])
        return np.maximum(of_all - (0 if self.radius is None else self.radius), 0)

    @property
    def assumed(self) -> tuple[str, ...]:
        """What is assumed above the last sample and between them, in words."""
        texts, between = [], []
        if self.beyond is not None:
            texts.append(
                f"assumed: above {self.omega[-1]:.4g} rad/s, where P is not known, sigma_max(P) is "
                f"{self.beyond:.4g} at most, at any phase"
            )
        if self.sampled:
            between.append(
                "cubic splines miss P by no more than they miss samples that are left out"
            )
        if self.radius is not None:
            between.append("the radius is interpolated by straight lines")
        if between:
            axis = "log omega" if self.axis is np.log else "omega"
            texts.append(f"assumed: between omega, {' and '.join(between)}, over {axis}")
        return tuple(texts)


def axis_of(omega, P):
    """That of omega and log omega over which splines predict every other sample better."""
    if omega[0] <= 0 or len(omega) < FEWEST:
        return np.asarray
    return min(np.asarray, np.log, key=lambda axis: missed(axis(omega), P).max())


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
