"""Rods that are not quite the nominal one, and the paper's loop around them.

Material parameters, positions of sensors and gains of Peltier elements of a specimen are off. The
controller stays as it was designed on the nominal model.
"""

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.fft import irfft, next_fast_len, rfftfreq

from ilctools import arguments
from ilctools.loop.closed import CurrentTrialLoop, reply
from ilctools.models import frequency_response
from rodlib.held import HeldRod, inverse_powers
from rodlib.rod import Rod

PAPER = Rod()
MATERIAL = ("density", "heat_capacity", "heat_transfer", "conductivity")
ALIAS = 1e-11  # of what a transform of an impulse response wraps around
STEP = 1.0  # rad, by which the return difference may turn between two frequencies


@dataclass(frozen=True)
class Specimen:
    """A rod as it may be, with the heat flow that each element delivers per heat flow commanded.

    See Also
    --------
    draw : one at random
    responses : the loop around it

    Examples
    --------
    >>> from rodlib import Rod, Specimen, paper_loop, responses
    >>> weak = Specimen(Rod(), gains=(0.9, 1.0, 1.0, 1.0))
    >>> responses(paper_loop(), [weak], [0.001, 0.01]).shape
    (1, 2, 2, 2)
    """

    rod: Rod
    gains: tuple[float, ...]

    def __post_init__(self):
        arguments.instance("rod", self.rod, Rod)
        arguments.array("gains", self.gains, (self.rod.sections,))

    def held(self, Ts: float) -> HeldRod:
        """Behind a zero-order hold."""
        arguments.sampling_period("Ts", Ts)
        return HeldRod(self.rod, Ts, self.gains)


@dataclass(frozen=True)
class Spread:
    """How far off a rod may be: each parameter by itself, uniformly from -spread to +spread.

    Relative, 0.2 for 20 %, except for the sensors.

    See Also
    --------
    draw : rods within it
    Study : what a law does for many of them

    Examples
    --------
    >>> from rodlib import Spread
    >>> Spread(conductivity=0.2, gains=0.05).conductivity
    0.2
    """

    density: float = 0.0
    heat_capacity: float = 0.0
    heat_transfer: float = 0.0
    conductivity: float = 0.0
    gains: float = 0.0  # heat flow of each Peltier element for the one commanded
    sensors: float = 0.0  # position of each sensor, m

    def __post_init__(self):
        for name in (*MATERIAL, "gains"):
            _check_share(name, getattr(self, name))
        arguments.not_negative("sensors", self.sensors, "a length in metres, 0 or more")

    @classmethod
    def of_all(cls, share: float, rod: Rod = PAPER) -> "Spread":
        """Everything off by the same share; the sensors by that of half a section of `rod`."""
        arguments.instance("rod", rod, Rod)
        _check_share("share", share)
        sensors = share * rod.length / rod.sections / 2
        return cls(share, share, share, share, share, sensors)

    def specimen(self, deviations, nominal: Rod = PAPER) -> Specimen:
        """The rod that is off by these shares of the spread.

        Parameters
        ----------
        deviations : array_like, shape (4 + sections + sensors,)
            From -1 to 1: of the four material parameters in the order above, of the gain of each
            Peltier element, of the position of each sensor.
        nominal : Rod
            Default: the paper's.
        """
        arguments.instance("nominal", nominal, Rod)
        deviations = arguments.array("deviations", deviations, (_count(nominal),))
        largest = np.abs(deviations).max()
        if largest > 1:
            raise ValueError(f"deviations reach {largest:.6g} in size, but 1 is the most")
        places = np.array(nominal.sensors)
        room = min(places.min(), nominal.length - places.max())
        if self.sensors > room:
            raise ValueError(
                f"spread.sensors = {self.sensors} m would move a sensor of the nominal rod beyond "
                f"its end: at most {room:.6g} m"
            )
        material, gains, sensors = np.split(deviations, [4, 4 + nominal.sections])
        parameters = {
            name: getattr(nominal, name) * (1 + getattr(self, name) * deviation)
            for name, deviation in zip(MATERIAL, material, strict=True)
        }
        places = np.clip(places + self.sensors * sensors, 0, nominal.length)
        rod = replace(nominal, **parameters, sensors=tuple(places))
        return Specimen(rod, tuple((1 + self.gains * gains).tolist()))


def draw(spread: Spread, number: int, root: int = 0, nominal: Rod = PAPER) -> Specimen:
    """Draw a rod by number.

    Parameters
    ----------
    spread : Spread
    number, root : int
        Number of the rod, and of the sequence to which it belongs, 0 or more. Another spread
        stretches the same rod's deviations.
    nominal : Rod
        As for :meth:`Spread.specimen`.

    See Also
    --------
    Spread : how far off they are
    responses : the loop around them

    Examples
    --------
    >>> from rodlib import Spread, draw
    >>> one, again = (draw(Spread.of_all(0.2), number=3) for _ in range(2))
    >>> one == again, bool(0.8 < one.rod.conductivity / 55 < 1.2)
    (True, True)
    """
    arguments.instance("spread", spread, Spread)
    arguments.instance("nominal", nominal, Rod)
    seed = [arguments.whole("number", number, 0), arguments.whole("root", root, 0)]
    deviations = np.random.default_rng(seed).uniform(-1, 1, _count(nominal))
    return spread.specimen(deviations, nominal)


def responses(loop: CurrentTrialLoop, specimens: Sequence[Specimen], omega) -> np.ndarray:
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
        Meaningful where the loop around the specimen is stable: see :func:`unstable_poles`.

    See Also
    --------
    draw : specimens
    synthesise : bounds that hold for all of them

    Examples
    --------
    >>> from rodlib import Spread, draw, paper_loop, responses
    >>> specimens = [draw(Spread.of_all(0.1), number) for number in range(3)]
    >>> responses(paper_loop(), specimens, [0.001, 0.01]).shape
    (3, 2, 2, 2)
    """
    rods = _held(loop, specimens)
    points = Points(loop, arguments.row("omega", omega))
    return np.array([points.P(points.response(rod)) for rod in rods])


def impulse_responses(
    loop: CurrentTrialLoop, specimens: Sequence[Specimen], count: int
) -> np.ndarray:
    """The first samples of P's impulse response, shape (specimens, count, m, m).

    On a circle abs(z) = r > 1, P(z) is the Fourier transform of p_k r^-k. Of N samples, what comes
    after the last one wraps around to the first one; by then it has fallen to `ALIAS` = r^-N of
    itself, even if P decays slowly.
    """
    rods = _held(loop, specimens)
    N = next_fast_len(2 * count + 100, real=True)
    radius = ALIAS ** (-1 / N)
    points = Points(loop, rfftfreq(N, loop.Ts / (2 * np.pi)), radius)
    P = np.array([points.P(points.response(rod)) for rod in rods])
    growth = radius ** np.arange(count)
    return irfft(P, N, axis=1)[:, :count] * growth[:, None, None]


def unstable_poles(loop: CurrentTrialLoop, specimens: Sequence[Specimen]) -> np.ndarray:
    """Number of poles outside the unit circle of the loop around each specimen.

    Parameters as for :func:`responses`. The rod has infinitely many poles, so that there is no
    matrix whose eigenvalues would be those of the loop. But det(I + R D) of :class:`Points` is the
    characteristic polynomial of the loop around the specimen times that of the plant of the design,
    over those of the loop as designed and of the specimen. These three have their zeros inside the
    unit circle, and far outside the quotient is one. So, along the unit circle, it winds around
    zero once clockwise for every unstable pole. Between two frequencies it must turn by less than
    `STEP`; where it turns by more, the interval is halved.
    """
    rods = _held(loop, specimens)
    omega = np.append(0, np.geomspace(1e-5, 1, 300) * np.pi / loop.Ts)
    points = Points(loop, omega)
    return np.array([_winding_number(points, rod) for rod in rods])


class Points:
    """The loop as designed, at points in the z-plane, ready for other plants in its place.

    With G_0 for the plant of the design, G for the other one and D = G - G_0, the observer sees
    D u more than it expects, and the loop answers u = U w - R D u, so that y = G (I + R D)^-1 U w.

    U and R belong to the loop as designed: stable, and finite at z = 1 too, where the controller
    itself is not. The points are z = radius exp(j omega Ts), none of them inside the unit circle.
    """

    def __init__(self, loop: CurrentTrialLoop, omega, radius: float = 1.0):
        def response(model):  # z I - A = radius (exp(j omega Ts) I - A / radius)
            A, B, C, D = model.A / radius, model.B / radius, model.C, model.D
            return frequency_response(control.ss(A, B, C, D, model.dt), omega)

        m = loop.plant.noutputs
        self.loop, self.omega = loop, omega
        self.step = np.expm1(np.log(radius) + 1j * omega * loop.Ts)  # z - 1
        self.powers = inverse_powers(self.step)
        self.G_0 = response(loop.plant[:, :m])
        replies = response(reply(loop))
        self.U, self.R = replies[:, :, :m], -replies[:, :, m:]

    def response(self, rod: HeldRod) -> np.ndarray:
        """G of a rod from the controls of the loop, shape (n, m, m)."""
        return rod.response(self.step, self.loop.controls, self.powers)

    def P(self, G) -> np.ndarray:
        """From w to y around another plant G, shape (n, m, m)."""
        return G @ np.linalg.solve(self._loaded(G), self.U)

    def return_difference(self, G) -> np.ndarray:
        """det(I + R D), shape (n,)."""
        return np.linalg.det(self._loaded(G))

    def _loaded(self, G):
        return np.eye(G.shape[1]) + self.R @ (G - self.G_0)


def _winding_number(points, rod):
    loop, omega = points.loop, points.omega
    values = points.return_difference(points.response(rod))
    for _ in range(40):
        turns = np.angle(values[1:] / values[:-1])
        wide = np.flatnonzero(np.abs(turns) > STEP)
        if not wide.size:  # the other half of the circle turns by as much again
            return round(-turns.sum() / np.pi)
        between = Points(loop, (omega[wide] + omega[wide + 1]) / 2)
        more = between.return_difference(between.response(rod))
        omega = np.insert(omega, wide + 1, between.omega)
        values = np.insert(values, wide + 1, more)
    return 1  # on the unit circle, up to rounding


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
    if not (isinstance(specimens, list | tuple) and specimens):
        raise ValueError(
            f"specimens = {reprlib.repr(specimens)} must be a list of them: [specimen]"
        )
    for k, specimen in enumerate(specimens):
        arguments.instance(f"specimens[{k}]", specimen, Specimen)
        check_loop(loop, specimen.rod)
    return [specimen.held(loop.Ts) for specimen in specimens]


def _count(rod):
    """Number of parameters that may be off."""
    return len(MATERIAL) + rod.sections + len(rod.sensors)


def _check_share(name, value):
    arguments.number(name, value, "from 0 to below 1 (0.2 is 20 %)", high=1, least=0)
