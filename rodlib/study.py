"""For which rods does it converge? Many rods: drawn, judged and simulated in batches, on dask.

A :class:`Study` says which rods may be, and what is to be found out about each of them; :func:`run`
finds it out for the first so many. A batch is computed by itself, by whichever worker, so that any
number of workers finds the same to the byte. A finished one is a file in a folder, with all that it
depends on in its name; what is there is not computed again.
"""

import hashlib
import io
import json
import logging
import re
import reprlib
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import control
import numpy as np
import xarray as xr
from tqdm import tqdm

from rodlib.case import assumed_reference
from rodlib.course import Course
from rodlib.ilc import arguments, files
from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth
from rodlib.ilc.loop import CurrentTrialLoop
from rodlib.ilc.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.trials import check_law
from rodlib.rod import Rod
from rodlib.specimens import MATERIAL, Grid, Spread, check_loop, draw

SIZE = 500  # rods in a batch: a few seconds
TOGETHER = 4  # rods simulated at once: what fits into the processor's cache
ADDRESS = re.compile(r"(\w+://)?[^/\s]+:\d+")  # of a dask scheduler
MEMORY = {  # for the workers: what is fetched anew for every array costs as much as the arithmetic
    "MALLOC_TRIM_THRESHOLD_": 2**30,
    "MALLOC_MMAP_THRESHOLD_": 2**25,
}
FOUND = {  # what is found out about each rod: over which dimensions, in which unit
    "density": (("rod",), "kg/m3"),
    "heat_capacity": (("rod",), "J/(kg K)"),
    "heat_transfer": (("rod",), "W/(m2 K)"),
    "conductivity": (("rod",), "W/(m K)"),
    "unstable_poles": (("rod",), "1"),
    "sensors": (("rod", "channel"), "m"),
    "gains": (("rod", "element"), "1"),
    "rate": (("rod", "filter"), "1"),
    "rate_omega": (("rod", "filter"), "rad/s"),
    "objective": (("rod", "filter"), "1"),
    "rms": (("rod", "filter", "trial"), None),  # that of the outputs
}


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
        If the filters do not belong to the loop, or the loop is not that of a rod.
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
        omega = arguments.frequencies("omega", omega, loop.Ts)
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
        """A hash of all parameters and of rodlib itself: the same name, the same results."""
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
        law = self.loop, self.Q, list(self.filters.values())
        return Course(*law, self.reference, self.disturbance, self.trials, self.rest)

    def judge(self, start: int, stop: int) -> dict[str, np.ndarray]:
        """Find out what is asked about some rods: the variables of :func:`run`, the rods first."""
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

    Parameters
    ----------
    study : Study
    rods : int
    folder : path, optional
        Where finished batches are kept, one file each, written as a whole or not at all: a run that
        was interrupted goes on, and one with more rods begins with those that are known. Default:
        nowhere.
    scheduler : str, optional
        Address of a dask scheduler, such as ``"tcp://host:8786"``, whose workers have this very
        rodlib. Default: a cluster on this computer, for the time of the call.
    workers : int, optional
        Number of processes of that cluster. Default: one for each core. 0 does the work in this
        process, which takes less than a cluster takes to start if the work is short; how many
        threads its linear algebra has may then decide on last digits.

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
    RuntimeError
        If another process works in the folder, or a worker has another rodlib.
    OSError
        If there is no scheduler at that address.
    """
    arguments.instance("study", study, Study)
    rods = arguments.whole("rods", rods, 1)
    workers = None if workers is None else arguments.whole("workers", workers, 0)
    if not (scheduler is None or (isinstance(scheduler, str) and ADDRESS.fullmatch(scheduler))):
        raise ValueError(
            f"scheduler = {reprlib.repr(scheduler)} must be an address, such as 'tcp://host:8786'"
        )
    kept = TemporaryDirectory() if folder is None else nullcontext(arguments.path("folder", folder))
    with kept as where:
        found = _in_batches(study, rods, files.folder(Path(where)), scheduler, workers)
    return _dataset(study, found)


def _in_batches(study, rods, where, scheduler, workers):
    """Judge the batches that are not in the folder yet, and put together all that are."""
    parts = [(start, min(start + SIZE, rods)) for start in range(0, rods, SIZE)]
    paths = {part: where / f"{study.name}-{part[0]:06}-{part[1]:06}.npz" for part in parts}
    with files.alone(where / "lock", f"another process is at work in {where}: wait or stop it"):
        missing = [part for part in parts if not paths[part].exists()]
        bar = tqdm(total=len(parts), initial=len(parts) - len(missing), disable=None)
        with bar, closing(_judged(study, missing, scheduler, workers)) as results:
            for part, found in results:
                content = io.BytesIO()
                np.savez(content, **found)
                files.write_pieces(paths[part], [content.getbuffer()])
                bar.update()
    kept = [dict(np.load(path)) for path in paths.values()]
    return {name: np.concatenate([found[name] for found in kept]) for name in kept[0]}


def _judged(study, parts, scheduler, workers):
    """Judge batches in this process or on dask, and give each as soon as it is finished."""
    if not parts or (workers == 0 and scheduler is None):
        yield from ((part, study.judge(*part)) for part in parts)
        return
    from distributed import Client, as_completed  # here, since that takes a second

    here = nullcontext(scheduler) if scheduler else _cluster(workers, len(parts))
    with here as address, Client(address) as client:
        # A copy, as what the original may have computed need not travel.
        judged = {
            client.submit(_judge, replace(study), study.name, *part, pure=False): part
            for part in parts
        }
        for future in as_completed(judged):
            yield judged[future], future.result()


def _cluster(workers, most):
    """A dask cluster on this computer, for the time of a run."""
    import dask
    from dask.system import CPU_COUNT
    from distributed import LocalCluster

    settings = {f"distributed.nanny.pre-spawn-environ.{name}": x for name, x in MEMORY.items()}
    with dask.config.set(settings):
        return LocalCluster(
            n_workers=min(workers or CPU_COUNT, most),
            threads_per_worker=1,
            dashboard_address=":0",  # any free port: another cluster may be running
            silence_logs=logging.CRITICAL,
        )


def _judge(study, name, start, stop):
    if study.name != name:
        raise RuntimeError("a worker has another rodlib than this process, or other parameters")
    return study.judge(start, stop)


@cache
def _code():
    """A hash of all modules."""
    paths = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()


def _within(omega, band):
    return (band[0] <= omega) & (omega <= band[1])


def _plain(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, control.StateSpace):
        matrices = [getattr(value, name).tolist() for name in "ABCD"]
        return [*matrices, value.dt, value.input_labels, value.output_labels]
    raise TypeError(f"{value!r} has no plain form")


def _dataset(study, found):
    unit = study.loop.units[study.loop.outputs[0]]
    variables = {
        name: (dimensions, found[name], {"units": own or unit})
        for name, (dimensions, own) in FOUND.items()
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
