"""A rig with Peltier elements, driven by currents: not linear in the heat flows of the design.

The rod is cut into cells. Under each section of the rod is an element, and below the element is a
sink with a fan. A current moves heat from the sink to the rod and heats both. The warmer side gives
heat back to the colder side. The top of the rod loses heat by natural convection and radiation. An
inner map turns the heat flow that the controller asks for into a current. The map uses the
parameters of the elements that the laboratory knows. All parameters are assumed: the paper gives
none.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.constants import Stefan_Boltzmann
from scipy.linalg import expm

from ilctools import arguments
from rodlib.rigs import MISMATCHED, Bench, Restarting
from rodlib.rod import Rod, finite_volumes


@dataclass(frozen=True)
class PeltierElement:
    """A Peltier element with constant parameters, in the usual one-dimensional model.

    The defaults are the rounded parameters of a common element of 127 couples and 6 A.

    Notes
    -----
    Half of the Joule heat R I^2 goes to each side. With absolute temperatures T, the heat flows are

        to the rod     S T_rod I + R I^2 / 2 - K (T_rod - T_sink)
        from the sink  S T_sink I - R I^2 / 2 - K (T_rod - T_sink) ,

    and their difference is the electrical power S (T_rod - T_sink) I + R I^2. For the model, and
    the way from a data sheet to its parameters, see S. Lineykin and S. Ben-Yaakov, "Modeling and
    analysis of thermoelectric modules", IEEE Trans. Ind. Appl. 43(2), 2007.

    With a column of resistances, a :class:`PeltierRig` simulates several rigs side by side, one for
    each row. Readings, commands and states then have a row for each rig. All rigs have the same
    sensor noise.
    """

    seebeck: float = 0.05  # S, V/K
    resistance: float = 2.0  # R, ohm
    conductance: float = 0.5  # K, W/K
    limit: float = 6.0  # largest current either way, A

    def __post_init__(self):
        arguments.positive("seebeck", self.seebeck)
        smallest = arguments.array("resistance", self.resistance, (...,)).min()
        arguments.not_negative("resistance", float(smallest))
        for name in ("conductance", "limit"):
            arguments.not_negative(name, getattr(self, name))

    def heat(self, current, rod, sink):
        """Return the heat flow to the rod, W, from a current (A) and the temperatures (K)."""
        joule = self.resistance * np.square(current) / 2
        return self.seebeck * rod * current + joule - self.conductance * (rod - sink)

    def current(self, heat, rod, sink):
        """Return the smallest current (A) that gives a heat flow (W).

        If the element cannot cool as much, the current with the most cooling is returned. Beyond
        S T_rod / R, more cooling current adds more Joule heat than cooling.
        """
        peltier, twice = self.seebeck * rod, 2 * self.resistance
        least = -(peltier**2) / (twice + 1e-300)  # no limit without Joule heat
        wanted = np.maximum(heat + self.conductance * (rod - sink), least)
        root = np.sqrt(np.maximum(peltier**2 + twice * wanted, 0))
        return 2 * wanted / (peltier + root)


@dataclass(frozen=True)
class PeltierParameters:
    """Parameters of elements, sinks, surface and sensors of the rig, and of its inner map.

    All parameters are assumed. The convection is Nu = 0.54 Ra^(1/4), with the Nusselt number Nu and
    the Rayleigh number Ra, for a warm plate that faces up in air at 300 K, whose length is its area
    divided by its perimeter (W. H. McAdams, Heat Transmission, 1954). The formula holds from
    Ra = 1e4 on. If the rod is 10 K warmer than the air, Ra is only half of this limit. A cold rod
    has the same convection in this model, although its true convection is smaller.

    See Also
    --------
    PeltierRig : the rig with these parameters

    Examples
    --------
    >>> from rodlib import PeltierParameters
    >>> from rodlib.peltier_rig import PeltierElement
    >>> weak = PeltierParameters(element=PeltierElement(seebeck=0.04))
    >>> weak.element == weak.known
    False
    """

    element: PeltierElement = PeltierElement()
    known: PeltierElement = PeltierElement()  # as the laboratory knows it, for the inner map
    sink_capacity: float = 400.0  # of one sink, J/K
    fan: float = 4.0  # heat transfer from one sink to the room, W/K
    convection: float = 3.8  # coefficient of the rod, W/(m2 K^(5/4))
    emissivity: float = 0.8  # of an oxidised surface
    temperature: float = 293.15  # initial temperature of the room, K
    lag: float = 2.0  # time constant of the sensors, s
    noise: float = 0.02  # standard deviation of the sensor noise, K
    quantum: float = 0.01  # resolution of the sensors, K
    ambient_rate: float = 5e-5  # rise of the ambient temperature, K/s
    cells: int = 16  # of each section

    def __post_init__(self):
        for name in ("element", "known"):
            arguments.instance(name, getattr(self, name), PeltierElement)
        for name in ("sink_capacity", "temperature", "lag"):
            arguments.positive(name, getattr(self, name))
        for name in ("fan", "convection", "emissivity", "noise", "quantum"):
            arguments.not_negative(name, getattr(self, name))
        arguments.number("ambient_rate", self.ambient_rate, "a finite number")
        arguments.whole("cells", self.cells, 1, 100)


class PeltierRig(Bench):
    """Simulate a rod on Peltier elements in the laboratory, sample by sample.

    Parameters
    ----------
    rod : Rod
        The rod. Its `heat_transfer` is not used: the heat that the rod loses follows from the
        elements and the surface, see :attr:`linearised`.
    parameters : PeltierParameters
    Ts : float
        Sampling period, s.
    seed : int
        Seed of the sensor noise.

    See Also
    --------
    RestartingPeltierRig : a rig that begins each trial at rest
    VirtualRig : a linear rig

    Notes
    -----
    Cells of the rod exchange heat with each other by conduction. Cells and elements exchange
    heat by :meth:`PeltierElement.heat`, each cell at its own temperature. Cells and room exchange
    heat by convection, c |theta - theta_a|^(5/4), and by radiation. A sink has
    C dT/dt = - (heat from the sink) - fan (T - T_a). Currents are held for a period. Each period is
    one step of the exponential Runge-Kutta method of second order (S. M. Cox and P. C. Matthews,
    J. Comput. Phys. 176, 2002, ETD2RK). Conduction, fan and lag are linear and fast, and are
    integrated exactly.

    Examples
    --------
    >>> from rodlib import PeltierRig
    >>> rig = PeltierRig()
    >>> low, high = rig.limits["Q1"]
    >>> low < 0 < high
    True
    """

    def __init__(
        self,
        rod: Rod = MISMATCHED,
        parameters: PeltierParameters = PeltierParameters(),
        Ts: float = 1.0,
        seed: int = 1,
    ):
        arguments.instance("parameters", parameters, PeltierParameters)
        super().__init__(rod, parameters, Ts, seed)
        p, sections, m = parameters, rod.sections, len(rod.sensors)
        # cells that conduct, but lose next to nothing to the air: a Rod must lose some heat
        conducting = finite_volumes(replace(rod, heat_transfer=1e-11), p.cells)
        cells, C = conducting.nstates, p.sink_capacity
        A = _linear_part(conducting, p)
        self._decay, self._first, self._second = _exponentials(A, self.Ts)
        self._sensors = np.eye(m, len(A), cells + sections)

        # K/s of every state: for 1 W from the elements, and for half of the Joule heat
        warmed = conducting.B[:, :-1]
        self._elements = np.hstack([warmed.T, -np.eye(sections) / C, np.zeros((sections, m))])
        self._halves = np.abs(self._elements) / 2
        # K/s of every state: for 1 K of the room, and for 1 W/m2 from the surface above each cell
        self._fan = np.repeat([0.0, p.fan / C, 0.0], [cells, sections, m])
        surface = np.repeat([1 / (rod.kappa_1 * rod.height), 0.0], [cells, sections + m])
        self._convection = p.convection * surface
        self._radiation = p.emissivity * Stefan_Boltzmann * surface
        self._rest()

    def _rest(self):
        rigs = np.shape(self.parameters.element.resistance)[:-1]
        # cells, sinks, sensors, K above the room
        self._state = np.zeros((*rigs, len(self._fan)))
        self.currents = np.zeros((*rigs, self.rod.sections))  # A

    @property
    def linearised(self) -> Rod:
        """The rod that equals this rig for small currents, with sinks at room temperature."""
        p, under = self.parameters, self.rod.width * self.rod.length / self.rod.sections
        radiation = 4 * p.emissivity * Stefan_Boltzmann * p.temperature**3
        return replace(self.rod, heat_transfer=p.element.conductance / under + radiation)

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest heat flow of each element, W, beyond which its current saturates."""
        known, T = self.parameters.known, self.parameters.temperature
        limit = self.parameters.element.limit
        most = known.seebeck * T / known.resistance if known.resistance else np.inf
        ends = known.heat(np.array([-min(limit, most), limit]), T, T)
        return dict.fromkeys(self.inputs, tuple(ends.tolist()))

    def apply(self, heat_flows) -> None:
        """Command heat flows (W), shape (sections,), and let one sampling period pass."""
        heat = arguments.array("heat_flows", heat_flows, self.currents.shape)
        p = self.parameters
        wanted = p.known.current(heat, p.temperature, p.temperature)
        limit = p.element.limit
        self.currents = np.minimum(np.maximum(wanted, -limit), limit)
        # 1/s, to be multiplied by absolute temperatures
        pumped = p.element.seebeck * self.currents @ self._elements
        joule = p.element.resistance * np.square(self.currents)
        constant = joule @ self._halves + self._fan * self.ambient
        constant += self._radiation * (p.temperature + self.ambient) ** 4
        slopes = self._slopes(self._state, pumped)
        ahead = self._state @ self._decay + (constant + slopes) @ self._first
        self._state = ahead + (self._slopes(ahead, pumped) - slopes) @ self._second
        self.time += self.Ts

    def _slopes(self, state, pumped):
        """Compute the nonlinear rates of the temperatures, K/s: those not in the exponentials."""
        above, hot = state - self.ambient, state + self.parameters.temperature
        lost = self._convection * np.sqrt(np.sqrt(np.abs(above))) * above
        return pumped * hot - lost - self._radiation * np.square(hot * hot)


class RestartingPeltierRig(Restarting, PeltierRig):
    """A rig with Peltier elements that begins every trial at rest.

    See Also
    --------
    PeltierRig : a rig that has to come to rest
    record : runs trials on a rig

    Examples
    --------
    >>> from rodlib import RestartingPeltierRig
    >>> rig = RestartingPeltierRig()
    >>> rig.begin(1)
    >>> rig.read().shape
    (2,)
    """


def _linear_part(conducting, p):
    """Make the state matrix A of the linear parts: conduction, sinks and sensors, in 1/s.

    The states are the temperatures of cells and sinks, and the values that the sensors show.
    """
    warmed, (m, _) = conducting.B[:, :-1], conducting.C.shape  # K/s of a cell for 1 W
    cells, sections = warmed.shape
    mean = np.kron(np.eye(sections), np.full(p.cells, 1 / p.cells))  # of each section
    K, C, follows = p.element.conductance, p.sink_capacity, 1 / p.lag
    through = np.diag(K * warmed.sum(axis=1))
    return np.block(
        [
            [conducting.A - through, K * warmed, np.zeros((cells, m))],
            [K / C * mean, -(K + p.fan) / C * np.eye(sections), np.zeros((sections, m))],
            [follows * conducting.C, np.zeros((m, sections)), -follows * np.eye(m)],
        ]
    )


def _exponentials(A, Ts):
    """Compute exp(A Ts), int_0^Ts exp(A s) ds and int_0^Ts exp(A s) (1 - s / Ts) ds.

    The matrices are transposed, because states are rows.
    """
    one, zero = np.eye(len(A)), np.zeros(A.shape)
    blocks = expm(Ts * np.block([[A, one, zero], [zero, zero, one], [zero] * 3]))
    # states are rows, so that the states of several rigs are a matrix
    decay, first, second = np.split(blocks[: len(A)].T.copy(), 3)
    return decay, first, second / Ts
