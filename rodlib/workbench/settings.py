"""The settings of the workbench, and the Python that makes the same filter."""

from dataclasses import dataclass

import numpy as np

from ilctools import arguments
from ilctools.filters import ZeroPhaseButterworth, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.problem.problem import Problem
from rodlib.workbench.plant import Plant

FREQUENCIES = 200  # of the design; the paper has 1000
LIVELY = 20  # order up to which a filter takes a second, with bounds at every frequency


@dataclass(frozen=True)
class Settings:
    """A plant, and the position of every knob; :func:`rodlib.try_out` checks them.

    See Also
    --------
    try_out : what they lead to

    Examples
    --------
    >>> from rodlib import Settings, paper_loop
    >>> from rodlib.workbench.plant import Plant
    >>> settings = Settings.of(Plant("rodlib.paper_loop()", paper_loop()), M_max=0.8)
    >>> settings.M_max, settings.cutoff
    (0.8, 0.1)
    """

    plant: Plant
    L_max: float  # bound on sigma_max(L)
    cutoff: float  # of Q, rad/s
    band: tuple[float, float]  # of the sum in (39), rad/s
    order: int  # of the learning filter
    M_max: float = Problem.M_max  # bound on sigma_max(M)
    Q_order: int = 2
    structure: str = Problem.structure  # "diagonal" or "full"
    uncertainty: float = 0.0  # radius around P, in percent of ||P||
    noise: float = 0.0  # std of white noise in each output, in its unit, in the trials

    @classmethod
    def of(cls, plant: Plant, **changes) -> "Settings":
        """The defaults of the synthesis but for the plant's choices and `changes`."""
        Ts = arguments.instance("plant", plant, Plant).loop.Ts
        choices = plant.choices | changes
        cutoff = arguments.positive("cutoff", choices.pop("cutoff", 0.1 / Ts))
        cutoff = float(f"{cutoff:.3g}")
        problem = pose(plant.loop, zero_phase_butterworth(2, cutoff, Ts), _omega(Ts), Ts)
        low, high = problem.band
        defaults = {"L_max": problem.L_max, "band": (low, float(f"{high:.3g}"))}
        defaults["order"] = min(problem.order, LIVELY)
        choices.pop("base", None)  # an order is given: that of the paper's L
        return cls(plant, cutoff=cutoff, **defaults | choices)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.plant.loop.Ts

    @property
    def omega(self) -> np.ndarray:
        """The design frequencies, rad/s."""
        return _omega(self.Ts)

    @property
    def Q(self) -> ZeroPhaseButterworth:
        """The Q-filter."""
        arguments.whole("Q_order", self.Q_order, 1, 100)
        return zero_phase_butterworth(self.Q_order, self.cutoff, self.Ts)

    @property
    def problem(self) -> dict:
        """Further arguments of the synthesis, by keyword.

        Between the frequencies nothing bounds an uncertain P, so there `everywhere` is left out.
        """
        names = ("order", "M_max", "L_max", "band", "structure")
        problem = {name: getattr(self, name) for name in names}
        share = arguments.not_negative("uncertainty", self.uncertainty, "zero or more (%)") / 100
        if not share:
            return problem | {"everywhere": True}
        P = self.plant.loop.frequency_response(self.omega)
        return problem | {"uncertainty": share * np.linalg.norm(P, 2, axis=(1, 2))}

    @property
    def python(self) -> str:
        """The lines of Python that make the same filter, to the last digit, and its law."""
        problem = {name: repr(value) for name, value in self.problem.items()}
        if "uncertainty" in problem:
            size = "np.linalg.norm(P.frequency_response(omega), 2, axis=(1, 2))"
            problem["uncertainty"] = f"{self.uncertainty / 100!r} * {size}"
        words = ", ".join(f"{name}={value}" for name, value in problem.items())
        return f"""import ilctools
import numpy as np
import rodlib

P, omega = {self.plant.source}, np.geomspace(1e-4, np.pi, {FREQUENCIES}) / {self.Ts!r}
Q = ilctools.zero_phase_butterworth({self.Q_order}, {self.cutoff!r}, {self.Ts!r})
design = ilctools.synthesise(P, Q, omega, {self.Ts!r}, {words})
law = design.law(rest={self.plant.rest})
"""


def _omega(Ts):
    """The design frequencies, rad/s."""
    return np.geomspace(1e-4, np.pi, FREQUENCIES) / Ts
