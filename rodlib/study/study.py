"""For which rods does it converge? Many plants: sampled, simulated in batches, on dask, resumable.

A :class:`Study` says which rods may be, and what is to be found out about each of them; :func:`run`
finds it out for the first so many.
"""

import hashlib
import json
import re
import reprlib
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, lru_cache, partial
from importlib import import_module
from pathlib import Path

import cloudpickle
import control
import numpy as np
import scipy
import xarray as xr

from rodlib.case import assumed_reference
from rodlib.ilc import arguments, files
from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth
from rodlib.ilc.loop import CurrentTrialLoop
from rodlib.ilc.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.trials import check_law
from rodlib.rod import Rod
from rodlib.specimens import MATERIAL, Grid, Spread, check_loop, draw
from rodlib.study import batches
from rodlib.study.course import Course

SIZE = 100  # rods in a batch: a second or two
ADDRESS = re.compile(r"(\w+://)?[^/\s]+:\d+")  # of a dask scheduler
TOGETHER = 4  # specimens simulated at once: what fits into the processor's cache
CODE = ("rod", "held", "case", "specimens", "study.course", "study.study")
CODE += tuple(f"ilc.{name}" for name in ("models", "loop", "filters", "problem", "trials"))
UNITS = {"density": "kg/m3", "heat_capacity": "J/(kg K)", "heat_transfer": "W/(m2 K)"}
UNITS |= {"conductivity": "W/(m K)", "sensors": "m", "gains": "1", "unstable_poles": "1"}
UNITS |= {"rate": "1", "rate_omega": "rad/s", "objective": "1"}


@dataclass(frozen=True)
class Study:
    """Which rods may be, and what is asked about each of them. Checked when it is made.

    Attributes
    ----------
    loop : CurrentTrialLoop
        Of a rod, as designed; the controller stays.
    Q : ZeroPhaseButterworth
    filters : dict of LearningFilter
        By name. Both kinds of filter take signals as zero beyond the ends of a trial.
    spread : Spread
        How far off the rods are.
    nominal : Rod
        What they were meant to be.
    root : int
        Of the random numbers.
    omega : ndarray, shape (n,)
        Frequencies of the rate, increasing, rad/s. Default: 1000 from 1e-4 rad/s to Nyquist.
    band : tuple of float
        Over which the objective of (39) sums, rad/s.
    reference : ndarray, shape (time, m)
        Default: :func:`rodlib.case.assumed_reference`.
    disturbance : ndarray, shape (time, d) or (trials, time, d), optional
        In the order of ``loop.disturbances``. Default zero.
    trials : int
    rest : int
        As for :func:`rodlib.run_trials`.

    Raises
    ------
    ValueError
        If the filters do not belong to the loop, the loop is not that of a rod, or an argument is
        out of range; the message names it.
    """

    loop: CurrentTrialLoop
    Q: ZeroPhaseButterworth
    filters: dict[str, LearningFilter]
    spread: Spread
    nominal: Rod = field(default_factory=Rod)
    root: int = 0
    omega: np.ndarray | None = None
    band: tuple[float, float] = (1e-4, 0.02)
    reference: np.ndarray | None = None
    disturbance: np.ndarray | None = None
    trials: int = 5
    rest: int = 0

    def __post_init__(self):
        arguments.instance("nominal", self.nominal, Rod)
        draw(self.spread, 0, self.root, self.nominal)  # which checks the other two
        loop = self.loop
        check_loop(loop, self.nominal)
        if not arguments.instance("filters", self.filters, dict):
            raise ValueError("filters = {} must hold at least one learning filter, by name")
        for name, L in self.filters.items():
            check_law(loop, self.Q, arguments.instance(f"filters[{name!r}]", L, LearningFilter))
        for name, each in {"Q": self.Q, **self.filters}.items():
            if each.ends != "zero":
                raise ValueError(f"{name}.ends = {each.ends!r} must be 'zero' in a study")

        omega = np.geomspace(1e-4, np.pi, 1000) / loop.Ts if self.omega is None else self.omega
        omega = arguments.array("omega", omega, ("frequency",))
        if omega[0] < 0 or omega[-1] > np.pi / loop.Ts * (1 + 1e-9) or np.any(np.diff(omega) <= 0):
            raise ValueError(f"omega must increase within [0, {np.pi / loop.Ts:.6g}] rad/s")
        band = tuple(arguments.array("band", self.band, (2,)).tolist())
        if not _within(omega, band).any():
            raise ValueError(f"band = {band} contains none of the frequencies omega")
        trials = arguments.whole("trials", self.trials, 1)
        reference = assumed_reference() if self.reference is None else self.reference
        reference = arguments.array("reference", reference, ("time", len(loop.outputs)))
        rest = arguments.whole("rest", self.rest, 0, len(reference) - 1)
        d = self.disturbance
        if d is not None:
            shape = (trials, len(reference), len(loop.disturbances))
            d = arguments.array("disturbance", d, (...,))
            d = arguments.array("disturbance", d, shape if d.ndim != 2 else shape[1:])
        checked = {"omega": omega, "band": band, "trials": trials, "reference": reference}
        for name, value in (checked | {"rest": rest, "disturbance": d}).items():
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """A hash of all parameters and of the code that counts: the same name, the same results."""
        plain = json.dumps(asdict(self), default=_plain)
        return hashlib.sha256(f"{_code()} {plain}".encode()).hexdigest()[:24]

    @cached_property
    def _grid(self):
        return Grid(self.loop, self.omega)

    @cached_property
    def _whole(self):
        return Grid.whole(self.loop)

    @cached_property
    def _course(self):
        filters = list(self.filters.values())
        return Course(
            self.loop, self.Q, filters, self.reference, self.disturbance, self.trials, self.rest
        )

    def judge(self, start: int, stop: int) -> dict[str, np.ndarray]:
        """Find out what is asked about the rods from number `start` up to `stop`.

        Returns
        -------
        dict of ndarray
            The variables of :func:`run`, the first axis being the rods.
        """
        start = arguments.whole("start", start, 0)
        stop = arguments.whole("stop", stop, start + 1)
        drawn = [draw(self.spread, i, self.root, self.nominal) for i in range(start, stop)]
        found = {name: np.array([getattr(each.rod, name) for each in drawn]) for name in MATERIAL}
        found["sensors"] = np.array([each.rod.sensors for each in drawn])
        found["gains"] = np.array([each.gains for each in drawn])
        rods = [each.held(self.loop.Ts) for each in drawn]
        found["unstable_poles"] = np.array([self._whole.unstable_poles(rod) for rod in rods])
        q = self.Q.frequency_response(self.omega)
        L = [L.frequency_response(self.omega) for L in self.filters.values()]
        sigma = np.empty((len(rods), len(L), len(self.omega)))
        for i, rod in enumerate(rods):
            P = self._grid.P(rod)
            sigma[i] = [largest_singular_values(convergence_matrix(P, q, each)) for each in L]
        found["rate"] = sigma.max(axis=2)  # of Lemma 1
        found["rate_omega"] = self.omega[sigma.argmax(axis=2)]
        found["objective"] = sigma[:, :, _within(self.omega, self.band)].sum(axis=2)
        groups = [rods[i : i + TOGETHER] for i in range(0, len(rods), TOGETHER)]
        found["rms"] = np.concatenate([self._course.rms(group) for group in groups])
        for name in ("rate", "rate_omega", "objective", "rms"):
            found[name][found["unstable_poles"] > 0] = np.nan
        return found


def run(
    study: Study,
    rods: int,
    *,
    folder=None,
    scheduler: str | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Find out what a study asks about its first so many rods.

    What has been found out before is read from the folder: a run that was interrupted goes on, and
    one with more rods begins with those that are known.

    Parameters
    ----------
    study : Study
    rods : int
    folder : path, optional
        Where finished batches are kept. Default: build/study of the repository.
    scheduler, workers : optional
        Of dask, as for :func:`rodlib.study.batches.complete`.

    Returns
    -------
    xarray.Dataset
        Of each rod its parameters, `sensors` and `gains`, and the number of unstable poles of the
        loop around it. Of each rod and filter `rate`, the largest sigma_max(M) over the frequencies
        (below one the error converges monotonically, Lemma 1), `rate_omega`, where that is, and
        `objective`, the sum of (39). `rms` of each rod, filter and trial. NaN where the loop is not
        stable. Units as attributes; the spread, the root and the study's name, too.

    Raises
    ------
    ValueError
        If an argument is not what it should be.
    RuntimeError
        If another process works in the folder, if a worker has another rodlib, or without `folder`
        outside a clone of the repository.
    """
    arguments.instance("study", study, Study)
    rods = arguments.whole("rods", rods, 1)
    workers = None if workers is None else arguments.whole("workers", workers, 0)
    if not (scheduler is None or (isinstance(scheduler, str) and ADDRESS.fullmatch(scheduler))):
        raise ValueError(
            f"scheduler = {reprlib.repr(scheduler)} must be an address, such as 'tcp://host:8786'"
        )
    if folder is None:
        folder = files.results("rodlib.study.run") / "study"
    where = arguments.path("folder", folder)
    # A copy, as what the original may have computed need not travel.
    work = partial(_judge, cloudpickle.dumps(replace(study)), _code())
    found = batches.complete(
        work, study.name, rods, SIZE, where, scheduler=scheduler, workers=workers
    )
    return _dataset(study, found)


def _judge(pickled, code, start, stop):
    if code != _code():
        raise RuntimeError("a worker has another rodlib, numpy or scipy: give it the one here")
    return _unpickled(pickled).judge(start, stop)


@lru_cache(maxsize=1)
def _unpickled(pickled):
    """The study, kept from batch to batch with what it has computed for all of them."""
    return cloudpickle.loads(pickled)


def _within(omega, band):
    return (band[0] <= omega) & (omega <= band[1])


def _plain(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, control.StateSpace):
        matrices = [getattr(value, name).tolist() for name in "ABCD"]
        return [*matrices, value.dt, value.input_labels, value.output_labels]
    raise TypeError(f"{value!r} has no plain form")


@lru_cache
def _code():
    """A hash of the modules that the results come from, and the versions of what they build on."""
    sources = [Path(import_module(f"rodlib.{name}").__file__).read_bytes() for name in CODE]
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}"
    return hashlib.sha256(b"\0".join([versions.encode(), *sources])).hexdigest()


def _dataset(study, found):
    dimensions = {name: ("rod",) for name in (*MATERIAL, "unstable_poles")}
    dimensions |= {"sensors": ("rod", "channel"), "gains": ("rod", "element")}
    dimensions |= {name: ("rod", "filter") for name in ("rate", "rate_omega", "objective")}
    dimensions["rms"] = ("rod", "filter", "trial")
    units = UNITS | {"rms": study.loop.units[study.loop.outputs[0]]}
    variables = {
        name: (axes, found[name], {"units": units[name]}) for name, axes in dimensions.items()
    }
    coordinates = {
        "rod": np.arange(len(found["rms"])),
        "filter": list(study.filters),
        "trial": np.arange(1, study.trials + 1),
        "channel": np.arange(1, len(study.loop.outputs) + 1),
        "element": study.nominal.inputs[:-1],
    }
    spread = {f"spread_{field.name}": getattr(study.spread, field.name) for field in fields(Spread)}
    attributes = {"root": study.root, "study": study.name, "Ts": study.loop.Ts, **spread}
    return xr.Dataset(variables, coordinates, attributes)
