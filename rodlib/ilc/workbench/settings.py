"""The knobs of the workbench, and the Python that makes what they say."""

from dataclasses import dataclass

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth, zero_phase_butterworth
from rodlib.ilc.problem import defaults
from rodlib.ilc.problem.problem import Problem
from rodlib.ilc.workbench.plants import Plant

FREQUENCIES = 200  # of the design; the paper has 1000


@dataclass(frozen=True)
class Settings:
    """A plant, and the position of every knob. Nothing is checked before it is tried out."""

    plant: Plant
    L_max: float  # bound on sigma_max(L)
    cutoff: float  # of the Q-filter, rad/s
    band: tuple[float, float]  # of the sum in (39), rad/s
    order: int  # of the learning filter
    M_max: float = Problem.M_max  # bound on sigma_max(M)
    Q_order: int = ZeroPhaseButterworth.order
    structure: str = Problem.structure  # "diagonal" or "full"
    uncertainty: float = 0.0  # radius of what is not known of P, in percent of ||P||
    noise: float = (
        0.0  # standard deviation in each output, white, in its unit; new in every trial
    )

    @classmethod
    def of(cls, plant: Plant, **changes) -> "Settings":
        """The paper's choices but for `changes`, carried over to another plant by its Ts."""
        Ts = arguments.instance("plant", plant, Plant).loop.Ts
        cutoff = changes.get("cutoff", ZeroPhaseButterworth.cutoff / Ts)
        cutoff = float(f"{arguments.positive('cutoff', cutoff):.3g}")
        omega = _omega(Ts)
        low, high = defaults.band(cutoff, omega)
        known = plant.response
        P = known.on(omega)[0] if plant.measured else known.frequency_response(omega)
        smallest = np.linalg.svd(P, compute_uv=False)[:, -1]
        own = {
            "L_max": defaults.gain(cutoff, smallest, omega),
            "cutoff": cutoff,
            "band": (_no_lower(low), float(f"{high:.3g}")),
            "order": plant.order,
        }
        return cls(plant, **own | changes)

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
        """Further arguments of the synthesis, by keyword."""
        asked = {
            "order": self.order,
            "M_max": self.M_max,
            "L_max": self.L_max,
            "band": tuple(arguments.array("band", self.band, (2,)).tolist()),
            "structure": self.structure,
        }
        percent = arguments.not_negative(
            "uncertainty", self.uncertainty, "zero or more (%)"
        )
        if percent:
            if self.plant.measured:
                raise ValueError(
                    f"uncertainty = {percent:g} % must be 0 for a measured response, which brings "
                    "a radius of its own"
                )
            asked["uncertainty"] = percent / 100 * self.plant.size(self.omega)
        elif (
            not self.plant.measured
        ):  # within a radius nothing is known between the frequencies
            asked["everywhere"] = True
        arguments.not_negative("noise", self.noise, "zero or more")
        return asked

    @property
    def python(self) -> str:
        """Three lines that make the same filter, to the last digit, and their imports."""
        size = "np.linalg.norm(P.frequency_response(omega), 2, axis=(1, 2))"
        in_words = {
            "uncertainty": f"{self.uncertainty / 100!r} * {size}",
        }
        asked = ", ".join(
            f"{name}={in_words.get(name, repr(value))}"
            for name, value in self.problem.items()
        )
        return (
            "import numpy as np\n"
            "import rodlib\n\n"
            f"P, omega = {self.plant.source}, "
            f"np.geomspace(1e-4, np.pi, {FREQUENCIES}) / {self.Ts!r}\n"
            f"Q = rodlib.zero_phase_butterworth({self.Q_order}, {self.cutoff!r}, {self.Ts!r})\n"
            f"design = rodlib.synthesise(P, Q, omega, {self.Ts!r}, {asked})\n"
        )


def _omega(Ts):
    """The design frequencies, rad/s."""
    return np.geomspace(1e-4, np.pi, FREQUENCIES) / Ts


def _no_lower(omega):
    """In three digits, and no lower: below the first design frequency no band begins."""
    rounded = float(f"{omega:.3g}")
    return rounded if rounded >= omega else float(f"{1.005 * omega:.3g}")
