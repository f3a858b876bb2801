"""Frequency responses of plants: P at its given frequencies, between them, and outside them.

P of a model is known at all frequencies. If P is known by samples, :mod:`.samples` gives P between
the samples and below the first sample. If P was estimated from a record, the estimate itself also
gives P below the first sample. Above the last sample, P is taken to be zero, with a radius that is
the size of P at the last sample.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import control
import numpy as np

from ilctools.models import frequency_response
from ilctools.response.directions import Directions
from ilctools.response.samples import Assumed, Samples
from ilctools.response.scale import Scale
from ilctools.signals import Signals
from ilctools.singular_values import largest_singular_values

SAME_ANGLE = 1e-9  # rad: two angles omega Ts with a smaller difference are the same frequency
POINTS_BELOW = (
    17  # number of frequencies from zero to omega[0], at which an estimated P is evaluated
)


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency responses of one or several plants, as :func:`.response_of` makes them."""

    omega: np.ndarray  # (n,): rad/s
    P: np.ndarray  # (plants, n, p, m), complex, in units of `scale`; the nominal plant first
    Ts: float  # sampling period, s
    models: tuple[control.StateSpace | None, ...]  # of the plants; None for a table of samples
    radius: np.ndarray | None  # (n,): the true plant is P + Delta, ||Delta|| <= radius; None: P
    scale: Scale
    signals: Signals  # of the nominal plant
    assumptions: tuple[str | Assumed, ...] = ()  # of a measured P and its radius, in words
    added: bool = True  # whether each v is added to the reference of an output
    # The response of the loop to references, in units of `scale.y`, if `added` is False and the
    # response is known.
    of_reference: control.StateSpace | None = None
    directions: Directions | None = (
        None  # the directions to which P is restricted; None: P has a gain in all directions
    )
    one_at_first: bool = False  # whether the loop should make P the identity at omega[0]
    low: Samples | None = None  # P from zero to omega[0], if P was estimated from a record

    @property
    def sampled(self) -> bool:
        """Whether at least one plant is known by samples only."""
        return None in self.models

    @property
    def names(self) -> tuple[list, list]:
        """The names of outputs and of learned inputs, or their numbers if they have no names."""
        return self.signals.channels(*self.scale.of_P.shape)

    @property
    def angles(self) -> np.ndarray:
        """The angles omega Ts, (n,), rad."""
        return self.omega * self.Ts

    @property
    def radii(self) -> np.ndarray:
        """The radius at each frequency, (n,).

        If P has no radius, all values are zero.
        """
        return np.zeros(len(self.omega)) if self.radius is None else self.radius

    def at(self, chosen) -> "Response":
        """Return the response at the frequencies that the mask `chosen`, (n,), selects."""
        radius = self.radii[chosen]
        return replace(
            self,
            omega=self.omega[chosen],
            P=self.P[:, chosen],
            radius=radius if radius.any() else None,
        )

    def anywhere(self, plant: int, omega) -> tuple[np.ndarray, np.ndarray]:
        """Return P (k, p, m) of a plant, and its radius (k,), at any frequencies (k,), rad/s.

        For a model, the radius is zero outside the range of `omega`.
        """
        omega, model, samples = np.asarray(omega), self.models[plant], self.samples[plant]
        if model is None:
            P, radius = samples.at(omega)
            if self.beyond is not None:
                unknown = omega > self.omega[-1]
                P[unknown], radius[unknown] = 0, self.beyond
            return P, radius
        P, radius = frequency_response(model, omega), np.zeros(len(omega))
        if self.radius is not None:
            radius = np.where(samples.outside(omega), 0, samples.radius_at(omega))
        return P, radius

    def unsampled(self, plant: int, omega) -> np.ndarray:
        """Return which frequencies are below the first sample of a plant, (k,), bool."""
        return (self.models[plant] is None) & (np.asarray(omega) < self.omega[0])

    @property
    def below_in_words(self) -> Assumed | None:
        """The assumption on P below the first sample, in words.

        If P is known there, the value is None.
        """
        if not self.sampled or self.omega[0] <= 0:
            return None
        sampled = [s for s, m in zip(self.samples, self.models, strict=True) if m is None]
        return max(sampled, key=lambda samples: samples.moves).below_in_words

    @property
    def beyond(self) -> float | None:
        """The bound on sigma_max(P) above the last sample.

        If P is known there, the value is None.
        """
        if not self.sampled or self.angles[-1] >= np.pi - SAME_ANGLE:
            return None
        samples = self.P[[model is None for model in self.models], -1]
        return float(largest_singular_values(samples).max() + self.radii[-1])

    @cached_property
    def samples(self) -> list[Samples]:
        """One :class:`.Samples` for each plant, which interpolates the response of the plant."""
        return [Samples(self.omega, P, self.radii, self.low) for P in self.P]

    @property
    def assumed(self) -> tuple[Assumed, ...]:
        """The assumptions on P below, above and between the samples, in words."""
        assumed, between = [], []
        if self.below_in_words is not None:
            assumed.append(self.below_in_words)
        if self.beyond is not None:
            text = (
                f"above {self.omega[-1]:.4g} rad/s, where P is not known, sigma_max(P) is at "
                f"most {self.beyond:.4g}, at any phase"
            )
            assumed.append(Assumed(text))
        if self.sampled:
            between.append(
                "the error of the cubic splines of P is not larger than at samples that are "
                "left out"
            )
        if self.radius is not None:
            between.append("the radius is interpolated by straight lines")
        if between:
            axis = "log omega" if self.samples[0].axis is np.log else "omega"
            assumed.append(
                Assumed(f"between the frequencies omega, {' and '.join(between)}, over {axis}")
            )
        return tuple(assumed)
