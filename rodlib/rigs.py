"""The virtual rig that takes the place of the laboratory.

The code of the rig uses neither the design model nor the code that runs an experiment. The rig has
other material parameters than the design model. With a real rod, only the rig object is replaced,
see :class:`.protocol.Rig`. The rig here is linear. The rig of :mod:`rodlib.peltier_rig` is not
linear, and recorded the logs in data/rig.
"""

from dataclasses import dataclass

import numpy as np

from ilctools import arguments
from rodlib.rod import Rod, modes

# Material parameters that differ by several percent from the design model.
MISMATCHED = Rod(density=8100.0, heat_capacity=440.0, heat_transfer=160.0, conductivity=51.0)


@dataclass(frozen=True)
class RigParameters:
    """Properties in which the rig differs from the design model.

    All values are assumed, as the paper does not give them. The lag must differ from the time
    constants of the rod's modes.

    See Also
    --------
    VirtualRig : the rig with these properties

    Examples
    --------
    >>> from rodlib import RigParameters, VirtualRig
    >>> quiet = VirtualRig(parameters=RigParameters(modes=20, noise=0.0, quantum=0.0))
    >>> quiet.limits["Q1"]
    (-60.0, 60.0)
    """

    modes: int = 300
    noise: float = 0.02  # standard deviation of the sensor noise, K
    quantum: float = 0.01  # resolution of the sensors, K
    lag: float = 4.0  # time constant of the Peltier elements, s
    limit: float = 60.0  # largest heat flow of an element, W
    ambient_rate: float = 5e-5  # rise of the ambient temperature, K/s

    def __post_init__(self):
        arguments.whole("modes", self.modes, 1, 10_000)
        for name in ("noise", "quantum", "lag"):
            arguments.not_negative(name, getattr(self, name))
        if np.any(self.limit != np.inf):  # np.inf is no limit
            what = "a heat flow in W, 0 or more, or np.inf"
            arguments.not_negative("limit", self.limit, what)
        arguments.number("ambient_rate", self.ambient_rate, "a finite number")


class Bench:
    """The common part of all rigs: a room that warms up, noisy sensors, and a clock in samples."""

    def __init__(self, rod: Rod, parameters, Ts: float, seed: int):
        arguments.instance("rod", rod, Rod)
        self.rod, self.parameters = rod, parameters
        self.Ts = arguments.sampling_period("Ts", Ts)
        self.seed = arguments.whole("seed", seed, 0)
        self.time = 0.0
        self._random = np.random.default_rng(self.seed)

    @property
    def inputs(self) -> list[str]:
        """Names of the heat flows, in the order of :meth:`apply`."""
        return self.rod.inputs[:-1]

    @property
    def measured(self) -> dict[str, float]:
        """The signals that are measured besides the outputs: the ambient temperature, K."""
        return {"theta_a": self.ambient}

    def clock(self) -> float:
        """Return the time, s; time stands still between two samples here."""
        return self.time

    @property
    def ambient(self) -> float:
        """Ambient temperature above its initial value, K, as a thermometer in the room shows it."""
        return self.parameters.ambient_rate * self.time

    def read(self) -> np.ndarray:
        """Read the sensors: K above the initial ambient temperature, shape (m,)."""
        theta, quantum = self._state @ self._sensors.T, self.parameters.quantum
        theta = theta + self.parameters.noise * self._random.standard_normal(len(self._sensors))
        return (np.rint(theta / quantum) * quantum).round(9) if quantum else theta


class Restarting:
    """A rig that begins every trial at rest, in a room at its initial temperature.

    The sensor noise of a trial depends only on `seed` and on the number of the trial. An experiment
    may therefore go on in another process.
    """

    def begin(self, trial: int) -> None:
        """Begin a trial, counted from 1."""
        trial = arguments.whole("trial", trial, 1)
        self._random = np.random.default_rng([self.seed, trial])
        self._rest()
        self.time = 0.0


class VirtualRig(Bench):
    """Simulate a rod in the laboratory, sample by sample.

    Parameters
    ----------
    rod : Rod
    parameters : RigParameters
    Ts : float
        Sampling period, s.
    seed : int
        Seed of the sensor noise.

    See Also
    --------
    RestartingRig : a rig that begins each trial at rest
    PeltierRig : a rig that is not linear

    Notes
    -----
    With theta = sum_n T_n(t) cos(n pi z / l), (1)-(4) of the paper separate into one first-order
    equation per mode. Commands are held for a period and then pass the lag of the elements. Modes
    and lag are integrated exactly.

    Examples
    --------
    >>> from rodlib import RigParameters, VirtualRig
    >>> rig = VirtualRig(parameters=RigParameters(modes=20))
    >>> for _ in range(60):
    ...     rig.apply([20.0, 0.0, 20.0, 0.0])
    ...
    >>> (rig.read() > 0).tolist()
    [True, True]
    """

    def __init__(
        self,
        rod: Rod = MISMATCHED,
        parameters: RigParameters = RigParameters(),
        Ts: float = 1.0,
        seed: int = 1,
    ):
        p = arguments.instance("parameters", parameters, RigParameters)
        super().__init__(rod, parameters, Ts, seed)
        s, B, self._sensors = modes(rod, np.arange(p.modes))
        gain, rate = B[:, :-1], 1 / p.lag if p.lag else np.inf  # 1/s
        self._decay, self._lag = np.exp(s * Ts), np.exp(-rate * Ts)
        self._held = (np.expm1(s * Ts) / s)[:, None] * gain
        self._lagging = ((self._lag - self._decay) / (-rate - s))[:, None] * gain
        self._air = -np.expm1(s[0] * Ts)
        self._rest()

    def _rest(self):
        self._state = np.zeros(self.parameters.modes)  # amplitudes of the modes, K
        self._flows = np.zeros(self.rod.sections)

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest heat flow of each element that has a limit, W."""
        limit = self.parameters.limit
        return {name: (-limit, limit) for name in self.inputs if np.isfinite(limit)}

    def apply(self, heat_flows) -> None:
        """Command heat flows (W), shape (sections,), and let one sampling period pass."""
        command = arguments.array("heat_flows", heat_flows, self._flows.shape)
        limit = self.parameters.limit
        command = np.minimum(np.maximum(command, -limit), limit)
        self._state *= self._decay
        self._state += self._held @ command + self._lagging @ (self._flows - command)
        self._state[0] += self._air * self.ambient
        self._flows = command + self._lag * (self._flows - command)
        self.time += self.Ts


class RestartingRig(Restarting, VirtualRig):
    """A virtual rig that begins every trial at rest.

    See Also
    --------
    VirtualRig : a rig that has to cool down
    record : runs trials on a rig

    Examples
    --------
    >>> from rodlib import RestartingRig, RigParameters
    >>> rig = RestartingRig(parameters=RigParameters(modes=20, noise=0.0))
    >>> rig.apply([20.0, 0.0, 20.0, 0.0])
    >>> rig.begin(1)
    >>> rig.read().tolist()
    [0.0, 0.0]
    """
