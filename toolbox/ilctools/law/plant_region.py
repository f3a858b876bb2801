"""Plants in the time domain: models, each with a bound of its error at each frequency."""

from dataclasses import dataclass

import control
import numpy as np

from ilctools.models import frequency_response, from_rest
from ilctools.response.door import in_all_directions
from ilctools.response.response import Response
from ilctools.response.scale import Scale
from ilctools.signals import check_match
from ilctools.singular_values import largest_singular_values

POINTS = 2048  # number of further frequencies at which a model is compared with samples


@dataclass(frozen=True, eq=False)
class PlantRegion:
    """Models P_k and radii r_k: the plant is one P_k + Delta with ||Delta(omega)|| <= r_k(omega).

    P, Delta and the radii are in units of `scale`. The radii are linear between the frequencies,
    and constant below the first frequency and above the last.
    """

    models: tuple[control.StateSpace, ...]
    angles: np.ndarray  # omega Ts, (n,)
    radii: np.ndarray  # (plants, n)
    scale: Scale
    outputs: list[str]
    inputs: list[str]
    estimated: bool = False  # whether the radius is from an estimate, with its confidence

    @classmethod
    def of(cls, response: Response, model: control.StateSpace | None) -> "PlantRegion":
        """Make the region from the response of a design.

        If the response is known by samples, the region is centred at `model`. The distance of the
        model from the samples is added to the radius of the samples.
        """
        response = in_all_directions(response)
        scale, omega = response.scale, response.omega
        if not response.sampled:
            models, radii = response.models, np.tile(response.radii, (len(response.models), 1))
        elif model is None or len(response.models) > 1:
            raise ValueError(
                "model = None, but P is known by samples only, and limits of outputs need a "
                "model in the time domain, of one plant: pass a model, such as loop.P, or "
                "P.model() of a measured P"
            )
        else:
            check_match(model=model, P=response.signals)
            models = (np.diag(1 / scale.y) * model * np.diag(scale.v),)
            omega = np.union1d(omega, np.linspace(0, np.pi / response.Ts, POINTS))
            P, radius = response.anywhere(0, omega)
            off = largest_singular_values(P - frequency_response(models[0], omega))
            radii = (radius + off)[None]
        outputs, inputs = ([str(name) for name in names] for names in response.names)
        estimated = response.low is not None
        return cls(models, omega * response.Ts, radii, scale, outputs, inputs, estimated)

    sampled = False  # this and the next members are as in Response, in the plants' own units

    @property
    def radius(self) -> np.ndarray | None:
        """The radius of the nominal plant, (n,).

        If the plant is exactly one of the models, the value is None.
        """
        return None if self.exact else self.radii[0] / self.scale.of_P.min()

    def anywhere(self, plant: int, omega) -> tuple[np.ndarray, np.ndarray]:
        """Compute the response (k, p, m) of a plant, and its radius (k,), at any omega, rad/s."""
        model, back = self.models[plant], self.scale.inverse.of_P
        radius = np.interp(omega * model.dt, self.angles, self.radii[plant])
        return frequency_response(model, omega) * back, radius * back.max()

    def output(self, v) -> np.ndarray:
        """Compute the output of the nominal plant from rest, (time, p), for v (time, m)."""
        return from_rest(self.models[0], v / self.scale.v) * self.scale.y

    @property
    def exact(self) -> bool:
        """Whether P is taken to be exactly one of the models, because all radii are zero."""
        return not self.radii.any()
