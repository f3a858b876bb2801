"""Rods that differ from the nominal rod, and the paper's loop around these rods.

A specimen has other material parameters, sensor positions and gains of Peltier elements than the
nominal rod. The controller remains as it was designed for the nominal model.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import control
import numpy as np

from ilctools import arguments
from ilctools.loop.closed import CurrentTrialLoop
from ilctools.threads import on_one_thread
from rodlib.held import sampled_response
from rodlib.rod import PAPER_ROD, Rod, labelled, midr

BATCH = 100  # specimens per batch of a worker: some 0.1 s, long compared with the transfer
MATERIAL = ("density", "heat_capacity", "heat_transfer", "conductivity")


@dataclass(frozen=True)
class Specimen:
    """A rod that differs from the nominal rod, and the gains of its Peltier elements.

    A gain is the delivered heat flow divided by the commanded heat flow.

    See Also
    --------
    draw : a random specimen
    responses : the loop around specimens

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

    def model(self, Ts: float) -> control.StateSpace:
        """Return a model of the specimen, sampled behind a zero-order hold.

        The model is computed by :func:`rodlib.midr` with degree 12.
        """
        model = midr(self.rod, degree=12)
        B = model.B * np.append(self.gains, 1)  # columns of the elements, and of the air
        return control.sample_system(labelled(self.rod, model.A, B, model.C), Ts, method="zoh")


@dataclass(frozen=True)
class Spread:
    """How far the parameters of a rod may differ from their nominal values.

    Each parameter deviates independently of the others, uniformly from -spread to +spread. The
    spread of the sensors is a length in metres. All other spreads are relative: 0.2 stands for
    20 %.

    See Also
    --------
    draw : rods within a spread
    responses : the loop around these rods

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
    gains: float = 0.0  # delivered heat flow of each Peltier element, relative to the command
    sensors: float = 0.0  # position of each sensor, m

    def __post_init__(self):
        for name in (*MATERIAL, "gains"):
            _check_share(name, getattr(self, name))
        arguments.not_negative("sensors", self.sensors, "a length in metres, 0 or more")

    @classmethod
    def of_all(cls, share: float, rod: Rod = PAPER_ROD) -> "Spread":
        """Make a spread with the same share for all parameters.

        The spread of the sensors is this share of half a section of `rod`.
        """
        arguments.instance("rod", rod, Rod)
        _check_share("share", share)
        sensors = share * rod.length / rod.sections / 2
        return cls(*[share] * 5, sensors=sensors)

    def specimen(self, deviations, nominal: Rod = PAPER_ROD) -> Specimen:
        """Return the rod whose parameters deviate by these shares of the spread.

        Parameters
        ----------
        deviations : array_like, shape (4 + sections + sensors,)
            The deviations as shares of the spread, from -1 to 1. First come the four material
            parameters, in the order of the fields of :class:`Spread`. Then come the gain of each
            Peltier element, and the position of each sensor.
        nominal : Rod
            The nominal rod. Default: the paper's rod. If a sensor is beyond the end of the rod,
            :class:`rodlib.Rod` raises a ValueError.
        """
        arguments.instance("nominal", nominal, Rod)
        deviations = arguments.array("deviations", deviations, (_count(nominal),))
        material, gains, sensors = np.split(deviations, [4, 4 + nominal.sections])
        parameters = {
            name: getattr(nominal, name) * (1 + getattr(self, name) * deviation)
            for name, deviation in zip(MATERIAL, material, strict=True)
        }
        places = tuple(nominal.sensors + self.sensors * sensors)
        rod = replace(nominal, **parameters, sensors=places)
        return Specimen(rod, tuple((1 + self.gains * gains).tolist()))


def draw(spread: Spread, number: int, root: int = 0, nominal: Rod = PAPER_ROD) -> Specimen:
    """Draw a random rod by its number.

    The same number gives the same rod, wherever and in whatever order rods are drawn.

    Parameters
    ----------
    spread : Spread
    number, root : int
        Number of the rod, and number of the sequence to which the rod belongs, 0 or more. With
        another spread, the same number gives the same deviations relative to this spread.
    nominal : Rod
        As for :meth:`Spread.specimen`.

    See Also
    --------
    Spread : how far the rods may differ
    responses : the loop around the rods

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


def responses(
    loop: CurrentTrialLoop, specimens: Sequence[Specimen], omega, executor: Executor | None = None
) -> np.ndarray:
    """Compute P of (31) of the paper around each specimen, as plants for ``synthesise([...])``.

    The method is :meth:`CurrentTrialLoop.frequency_response`, with the
    :func:`rodlib.sampled_response` of each specimen.

    Parameters
    ----------
    loop : CurrentTrialLoop
        The loop of a rod.
    specimens : list of Specimen
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency.
    executor : concurrent.futures.Executor, optional
        The executor that computes: a pool of processes, or the executor of an engine for clusters.
        The specimens are handed over in batches of 100. The result does not depend on the number of
        workers. Default: this process.

    Returns
    -------
    ndarray, shape (specimens, n, m, m), complex
        The responses. A response is meaningful only if the loop around the specimen is stable. This
        is not checked here. If the loop is unstable, ``loop.around(specimen.model(loop.Ts))``
        raises a ValueError.

    See Also
    --------
    draw : specimens
    synthesise : bounds that hold for all specimens

    Examples
    --------
    >>> from rodlib import Spread, draw, paper_loop, responses
    >>> specimens = [draw(Spread.of_all(0.1), number) for number in range(3)]
    >>> responses(paper_loop(), specimens, [0.001, 0.01]).shape
    (3, 2, 2, 2)
    """
    arguments.instance("loop", loop, CurrentTrialLoop)
    arguments.instance("specimens", specimens, list)
    if not specimens or {*map(type, specimens)} != {Specimen}:
        raise ValueError("specimens must be a list of one or more Specimen objects")
    inputs = specimens[0].rod.inputs
    if not {*loop.controls} <= {*inputs}:
        raise ValueError(
            f"loop has the controls {loop.controls}, but the rod has the inputs "
            f"{inputs}: pass a loop of this rod"
        )
    omega = arguments.row("omega", omega)
    if executor is not None:
        arguments.instance("executor", executor, Executor)
    batches = [specimens[k : k + BATCH] for k in range(0, len(specimens), BATCH)]
    mapped = map if executor is None else executor.map
    return np.concatenate([*mapped(partial(_responses, loop, omega), batches)])


@on_one_thread
def _responses(loop, omega, specimens):
    """Compute P around each specimen of a batch."""
    columns = [specimens[0].rod.inputs.index(name) for name in loop.controls]
    plants = [
        sampled_response(specimen.rod, omega, loop.Ts)[:, :, columns]
        * np.array(specimen.gains)[columns]
        for specimen in specimens
    ]
    return loop.frequency_response(omega, np.array(plants))


def _count(rod):
    """Count the parameters of a rod that may deviate."""
    return len(MATERIAL) + rod.sections + len(rod.sensors)


def _check_share(name, value):
    arguments.number(name, value, "from 0 to below 1 (0.2 is 20 %)", high=1, least=0)
