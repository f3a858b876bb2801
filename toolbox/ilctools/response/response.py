"""What is known of P: frequency responses of plants, at, between and beyond their frequencies.

Models are known at all frequencies. Between the first and the last sample, and below the first
one, :mod:`.samples` gives P. A measured response has its own P below the first sample. Above the
last sample, P is zero with a radius, which is the size of P at the last sample.
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

SAME_ANGLE = 1e-9  # difference of two angles, below which they are the same frequency
POINTS_BELOW = (
    17  # frequencies from zero to the first one of omega, at which a measured P is evaluated
)


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency responses of one plant or of several. :func:`.response_of` makes it."""

    omega: np.ndarray  # (n,): rad/s
    P: np.ndarray  # (plants, n, p, m), complex, in units of `scale`; the nominal plant first
    Ts: float  # sampling period, s
    models: tuple[control.StateSpace | None, ...]  # of the plants; None for samples
    radius: np.ndarray | None  # (n,): P may be P + Delta, ||Delta|| <= radius; None: it is P
    scale: Scale
    signals: Signals  # of the nominal plant
    assumptions: tuple[str | Assumed, ...] = ()  # what a measured P and its radius rest on
    added: bool = True  # whether v is added to references, one for each output
    # else the response of the loop to references, in units of `scale.y`, if it is known
    of_reference: control.StateSpace | None = None
    directions: Directions | None = (
        None  # the directions to which P is restricted; None: P passes all
    )
    one_at_first: bool = False  # whether the loop makes P the identity at the first frequency
    low: Samples | None = None  # from zero to the first frequency, if a measured P knows it

    @property
    def sampled(self) -> bool:
        """Whether at least one plant is known by samples only."""
        return None in self.models

    @property
    def names(self) -> tuple[list, list]:
        """The names of outputs and of learned inputs, or their numbers if they have no names."""
        p, m = map(len, self.scale)
        labels = self.signals.labels or [*range(p), *range(m)]
        return labels[:p], labels[p:]

    @property
    def angles(self) -> np.ndarray:
        """The angles omega Ts, (n,), rad."""
        return self.omega * self.Ts

    @property
    def radii(self) -> np.ndarray:
        """The radius at each frequency, (n,); zeros if P has no radius."""
        return np.zeros(len(self.omega)) if self.radius is None else self.radius

    def at(self, chosen) -> "Response":
        """Return the response at some of its frequencies, chosen by (n,) bool."""
        radius = self.radii[chosen]
        return replace(
            self,
            omega=self.omega[chosen],
            P=self.P[:, chosen],
            radius=radius if radius.any() else None,
        )

    def anywhere(self, plant: int, omega) -> tuple[np.ndarray, np.ndarray]:
        """Return P (k, p, m) of a plant, and its radius (k,), at any frequencies (k,), rad/s.

        The radius of a model is zero outside the frequencies at which it is given.
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
        """What is assumed below the first sample, in words; None if P is known there."""
        if not self.sampled or self.omega[0] <= 0:
            return None
        sampled = [s for s, m in zip(self.samples, self.models, strict=True) if m is None]
        return max(sampled, key=lambda samples: samples.moves).below_in_words

    @property
    def beyond(self) -> float | None:
        """The sigma_max(P) that is assumed above the last sample; None if P is known there."""
        if not self.sampled or self.angles[-1] >= np.pi - SAME_ANGLE:
            return None
        samples = self.P[[model is None for model in self.models], -1]
        return float(largest_singular_values(samples).max() + self.radii[-1])

    @cached_property
    def samples(self) -> list[Samples]:
        """The samples of each plant."""
        return [Samples(self.omega, P, self.radii, self.low) for P in self.P]

    @property
    def assumed(self) -> tuple[Assumed, ...]:
        """What is assumed below the samples, above them and between them."""
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
