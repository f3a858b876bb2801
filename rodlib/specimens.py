"""Rods as they may be: drawn at random, and one controller around each of them.

A specimen is the partial differential equation itself behind a zero-order hold, with parameters and
gains that are off. The controller stays as it was designed on the nominal model.
"""

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import control
import numpy as np

from rodlib.held import HeldRod, delays
from rodlib.ilc import arguments
from rodlib.ilc.loop.closed import CurrentTrialLoop, reply
from rodlib.ilc.models import frequency_response
from rodlib.rod import Rod

MATERIAL = ("density", "heat_capacity", "heat_transfer", "conductivity")
STEP = 1.0  # rad, by which the return difference may turn between two frequencies


@dataclass(frozen=True)
class Spread:
    """How far off a rod may be: each parameter by itself, uniformly from -spread to +spread.

    Relative, 0.2 for 20 %, but for the sensors.
    """

    density: float = 0.0
    heat_capacity: float = 0.0
    heat_transfer: float = 0.0
    conductivity: float = 0.0
    gains: float = 0.0  # heat flow of each Peltier element for the one commanded
    sensors: float = 0.0  # position of each sensor, m

    def __post_init__(self):
        for name in (*MATERIAL, "gains"):
            object.__setattr__(self, name, _share(name, getattr(self, name)))
        sensors = arguments.not_negative(
            "sensors", self.sensors, "a length in metres, 0 or more"
        )
        object.__setattr__(self, "sensors", sensors)

    @classmethod
    def of_all(cls, share: float, rod: Rod | None = None) -> "Spread":
        """Everything off by the same share; the sensors by that of half a section of `rod`."""
        rod = arguments.instance("rod", Rod() if rod is None else rod, Rod)
        share = _share("share", share)
        return cls(*[share] * 5, sensors=share * rod.length / rod.sections / 2)

    def specimen(self, deviations, nominal: Rod | None = None) -> "Specimen":
        """The rod that is off by these shares of the spread.

        Parameters
        ----------
        deviations : array_like, shape (4 + sections + sensors,)
            From -1 to 1: of the four material parameters in the order above, of the gain of each
            Peltier element, of the position of each sensor.
        nominal : Rod, optional
            The one that it was meant to be. Default: the paper's.
        """
        nominal = arguments.instance(
            "nominal", Rod() if nominal is None else nominal, Rod
        )
        count = len(MATERIAL) + nominal.sections + len(nominal.sensors)
        off = arguments.array("deviations", deviations, (count,))
        if np.abs(off).max() > 1:
            raise ValueError(
                f"deviations reach {np.abs(off).max():.6g} in size, but 1 is the most"
            )
        room = min(*nominal.sensors, nominal.length - max(nominal.sensors))
        if self.sensors > room:
            raise ValueError(
                f"spread.sensors = {self.sensors} m would move a sensor of the nominal rod beyond "
                f"its end: at most {room:.6g} m"
            )
        material, gains, sensors = np.split(
            off, [len(MATERIAL), len(MATERIAL) + nominal.sections]
        )
        changed = {
            name: getattr(nominal, name) * (1 + getattr(self, name) * by)
            for name, by in zip(MATERIAL, material, strict=True)
        }
        places = np.clip(
            nominal.sensors + self.sensors * sensors, 0, nominal.length
        )  # of rounding
        rod = replace(nominal, **changed, sensors=tuple(places))
        return Specimen(rod, tuple((1 + self.gains * gains).tolist()))


def _share(name, value):
    return arguments.number(
        name, value, "from 0 to below 1 (0.2 is 20 %)", high=1, least=0
    )


@dataclass(frozen=True)
class Specimen:
    """A rod as it may be, with the heat flow that each element delivers per heat flow commanded."""

    rod: Rod
    gains: tuple[float, ...]

    def __post_init__(self):
        arguments.instance("rod", self.rod, Rod)
        arguments.array("gains", self.gains, (self.rod.sections,))

    def held(self, Ts: float) -> HeldRod:
        """Behind a zero-order hold."""
        arguments.sampling_period("Ts", Ts)
        return HeldRod(self.rod, Ts, self.gains)


def draw(
    spread: Spread, number: int, root: int = 0, nominal: Rod | None = None
) -> Specimen:
    """Draw a rod by number.

    Parameters
    ----------
    spread : Spread
    number, root : int
        Number of the rod, and of the sequence to which it belongs, 0 or more. Another spread
        stretches the same rod's deviations.
    nominal : Rod, optional
        As for :meth:`Spread.specimen`.
    """
    arguments.instance("spread", spread, Spread)
    nominal = arguments.instance("nominal", Rod() if nominal is None else nominal, Rod)
    seed = [arguments.whole("number", number, 0), arguments.whole("root", root, 0)]
    count = len(MATERIAL) + nominal.sections + len(nominal.sensors)
    return spread.specimen(np.random.default_rng(seed).uniform(-1, 1, count), nominal)


class Grid:
    """The loop as designed, at points in the z-plane, ready for other plants in its place.

    With G_0 for the plant of the design, G for the other one and D = G - G_0, the observer sees
    D u more than it expects, and the loop answers u = U w - R D u, so that y = G (I + R D)^-1 U w.

    U and R belong to the loop as designed: stable, and finite at z = 1 too, where the controller
    itself is not. The points are z = radius exp(j omega Ts), none of them inside the unit circle.
    Arrays have the points last, as numpy is then fastest.
    """

    def __init__(self, loop: CurrentTrialLoop, omega, radius: float = 1.0):
        def response(model):  # z I - A = radius (exp(j omega Ts) I - A / radius)
            A, B = model.A / radius, model.B / radius
            return _last(
                frequency_response(control.ss(A, B, model.C, model.D, model.dt), omega)
            )

        self.loop, self.omega = loop, omega
        self.step = np.expm1(np.log(radius) + 1j * omega * loop.Ts)
        self.delays = delays(self.step)
        self.G_0 = response(loop.plant[:, : loop.plant.noutputs])
        self.U, minus_R = np.split(response(reply(loop)), 2, axis=1)
        self.R = -minus_R

    @classmethod
    def whole(cls, loop: CurrentTrialLoop) -> "Grid":
        """On the unit circle, from zero to the Nyquist frequency."""
        return cls(loop, np.append(0, np.geomspace(1e-5, 1, 300) * np.pi / loop.Ts))

    def closed(self, G):
        """From w to y, shape (m, m, n)."""
        return _times(_times(G, _inverse(self._loaded(G))), self.U)

    def P(self, rod: HeldRod) -> np.ndarray:
        """From w to y around a rod, shape (n, m, m)."""
        return np.moveaxis(self.closed(self._plant(rod)), -1, 0)

    def unstable_poles(self, rod: HeldRod) -> int:
        """Number of poles outside the unit circle; the frequencies go from zero to Nyquist."""
        omega, F = self.omega, self._return_difference(rod)
        for _ in range(40):
            turns = np.angle(F[1:] / F[:-1])
            wide = np.flatnonzero(np.abs(turns) > STEP)
            if not wide.size:
                return round(
                    -turns.sum() / np.pi
                )  # on the other half circle as much again
            between = (omega[wide] + omega[wide + 1]) / 2
            values = Grid(self.loop, between)._return_difference(rod)
            omega, F = (
                np.insert(omega, wide + 1, between),
                np.insert(F, wide + 1, values),
            )
        return 1  # on the unit circle, up to rounding

    def _return_difference(self, rod):
        return np.linalg.det(np.moveaxis(self._loaded(self._plant(rod)), -1, 0))

    def _plant(self, rod):
        return _last(rod.response(self.step, self.delays, self.loop.controls))

    def _loaded(self, G):
        """I + R D, whose determinant is the return difference."""
        loaded = _times(self.R, G - self.G_0)
        loaded[range(len(G)), range(len(G))] += 1
        return loaded


def check_loop(loop: CurrentTrialLoop, rod: Rod) -> None:
    """Check that a loop is that of a rod: its signals are, by name."""
    arguments.instance("loop", loop, CurrentTrialLoop)
    strangers = {*loop.controls, *loop.disturbances} - {*rod.inputs}
    if strangers or loop.outputs != rod.outputs:
        raise ValueError(
            f"loop has the signals {[*loop.plant.input_labels, *loop.outputs]}, but must be that "
            f"of a rod, with inputs among {rod.inputs} and the outputs {rod.outputs}; for a rod "
            "with others, pass it as nominal where rods are drawn"
        )


def _held(loop, specimens):
    arguments.instance("loop", loop, CurrentTrialLoop)
    if not (isinstance(specimens, list | tuple) and specimens):
        raise ValueError(
            f"specimens = {reprlib.repr(specimens)} must be a list of them: [specimen]"
        )
    for k, each in enumerate(specimens):
        arguments.instance(f"specimens[{k}]", each, Specimen)
        check_loop(loop, each.rod)
    return [each.held(loop.Ts) for each in specimens]


def _last(response):
    return np.ascontiguousarray(np.moveaxis(response, 0, -1))


def _times(A, B):
    return np.einsum("ijn,jkn->ikn", A, B)


def _inverse(A):
    if len(A) != 2:
        return _last(np.linalg.inv(np.moveaxis(A, -1, 0)))
    (a, b), (c, d) = A  # in closed form ten times faster
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def responses(
    loop: CurrentTrialLoop, specimens: Sequence[Specimen], omega
) -> np.ndarray:
    """P of (31) around each specimen: what ``synthesise([...])`` takes as plants.

    Parameters
    ----------
    loop : CurrentTrialLoop
        Of a rod.
    specimens : sequence of Specimen
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency.

    Returns
    -------
    ndarray, shape (specimens, n, m, m), complex
        A response tells nothing if the loop is not stable: see :func:`unstable_poles`.
    """
    rods, grid = _held(loop, specimens), Grid(loop, arguments.row("omega", omega))
    return np.array([grid.P(rod) for rod in rods])


def unstable_poles(loop: CurrentTrialLoop, specimens: Sequence[Specimen]) -> np.ndarray:
    """Number of poles outside the unit circle of the loop around each specimen.

    Parameters as for :func:`responses`. As the rod has infinitely many poles, there is no matrix
    whose eigenvalues could tell. But det(I + R D) is the characteristic polynomial of the loop
    around the specimen times that of the plant of the design, over those of the loop as designed
    and of the specimen. These three have their zeros inside the unit circle, and far outside the
    quotient is one. So, along the unit circle, it winds around zero once clockwise for every
    unstable pole. Between two frequencies it must turn by less than `STEP`; where it does not, more
    are taken.
    """
    rods, grid = _held(loop, specimens), Grid.whole(loop)
    return np.array([grid.unstable_poles(rod) for rod in rods])
