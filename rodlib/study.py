"""For which rods does it converge? Many rods: drawn, judged and simulated in batches, on dask.

A batch is computed by itself, so that any number of workers finds the same to the byte. A finished
one is a file, with all that it depends on in its name; what is there is not computed again.
"""

import hashlib
import json
import logging
import re
import reprlib
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import control
import numpy as np
import xarray as xr
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tqdm import tqdm

from rodlib.case import BAND, assumed_reference
from rodlib.held import HeldRod
from rodlib.ilc import arguments, files
from rodlib.ilc.evidence.convergence import spectral_radii
from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth
from rodlib.ilc.law.law import Law
from rodlib.ilc.loop.closed import CurrentTrialLoop
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.rod import Rod
from rodlib.specimens import MATERIAL, Grid, Spread, check_loop, draw

SIZE = 500  # rods in a batch: a few seconds
TOGETHER = 4  # rods simulated at once: what fits into the processor's cache
ADDRESS = re.compile(r"(\w+://)?[^/\s]+:\d+")  # of a dask scheduler
MEMORY = {  # for the workers: what is fetched anew for every array costs as much as the arithmetic
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 2**30,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 2**25,
}
ALIAS = 1e-9  # what is left of a sample after one turn of a trial's transform
WRAP = 1.6  # lengths of a trial after which its transform begins anew
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
    "spectral_rate": (("rod", "filter"), "1"),
    "objective": (("rod", "filter"), "1"),
    "rms": (("rod", "filter", "trial"), "K"),
}


@dataclass(frozen=True)
class Study:
    """Which rods may be, and what is asked about each of them. Checked when it is made."""

    loop: CurrentTrialLoop  # of a rod, as designed; the controller stays
    Q: ZeroPhaseButterworth  # takes signals as zero beyond the ends of a trial, as do the others
    filters: dict[str, LearningFilter]  # by name
    spread: Spread  # how far off the rods are
    nominal: Rod = field(default_factory=Rod)  # what they were meant to be
    root: int = 0  # of the random numbers
    omega: np.ndarray | None = (
        None  # of the rate; default: 1000 from 1e-4 rad/s to Nyquist
    )
    reference: np.ndarray | None = None  # (time, m); default: that of rodlib.case
    trials: int = 5

    def __post_init__(self):
        arguments.instance("nominal", self.nominal, Rod)
        draw(self.spread, 0, self.root, self.nominal)  # which checks the other two
        loop = self.loop
        check_loop(loop, self.nominal)
        if not arguments.instance("filters", self.filters, dict):
            raise ValueError(
                "filters = {} must hold at least one learning filter, by name"
            )
        for name, L in self.filters.items():
            arguments.instance(f"filters[{name!r}]", L, LearningFilter)
            Law(self.Q, L, loop=loop)  # which checks that they fit together
        for name, each in {"Q": self.Q, **self.filters}.items():
            if each.ends != "zero":
                raise ValueError(
                    f"{name}.ends = {each.ends!r} must be 'zero' in a study"
                )
        omega = (
            np.geomspace(1e-4, np.pi, 1000) / loop.Ts
            if self.omega is None
            else self.omega
        )
        reference = assumed_reference() if self.reference is None else self.reference
        checked = {
            "omega": arguments.frequencies("omega", omega, loop.Ts),
            "reference": arguments.array(
                "reference", reference, ("time", len(loop.outputs))
            ),
            "trials": arguments.whole("trials", self.trials, 1),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """A hash of all parameters and of rodlib itself: the same name, the same results."""
        plain = json.dumps(asdict(self), default=_plain)
        return hashlib.sha256(f"{_code()} {plain}".encode()).hexdigest()[:24]

    def judge(self, start: int, stop: int) -> dict[str, np.ndarray]:
        """Find out what is asked about some rods: the variables of :func:`run`, the rods first."""
        start = arguments.whole("start", start, 0)
        stop = arguments.whole("stop", stop, start + 1)
        drawn = [
            draw(self.spread, i, self.root, self.nominal) for i in range(start, stop)
        ]
        found = {
            name: np.array([getattr(each.rod, name) for each in drawn])
            for name in MATERIAL
        }
        found["sensors"] = np.array([each.rod.sensors for each in drawn])
        found["gains"] = np.array([each.gains for each in drawn])
        rods = [each.held(self.loop.Ts) for each in drawn]
        whole, grid = Grid.whole(self.loop), Grid(self.loop, self.omega)
        found["unstable_poles"] = np.array([whole.unstable_poles(rod) for rod in rods])
        q = self.Q.frequency_response(self.omega)
        L = [L.frequency_response(self.omega) for L in self.filters.values()]
        sigma, radius = np.empty((2, len(rods), len(L), len(self.omega)))
        for i, rod in enumerate(rods):
            P = grid.P(rod)
            M = [convergence_matrix(P, q, each) for each in L]
            sigma[i] = [largest_singular_values(each) for each in M]
            radius[i] = [spectral_radii(each) for each in M]
        found["rate"] = sigma.max(axis=2)  # of Lemma 1
        found["rate_omega"] = self.omega[sigma.argmax(axis=2)]
        found["spectral_rate"] = radius.max(axis=2)
        low, high = BAND
        band = (low <= self.omega) & (self.omega <= high)
        found["objective"] = sigma[:, :, band].sum(axis=2)
        course = Course(
            self.loop, self.Q, [*self.filters.values()], self.reference, self.trials
        )
        groups = [rods[i : i + TOGETHER] for i in range(0, len(rods), TOGETHER)]
        found["rms"] = np.concatenate([course.rms(group) for group in groups])
        for name in ("rate", "rate_omega", "spectral_rate", "objective", "rms"):
            found[name][found["unstable_poles"] > 0] = np.nan
        return found


class Course:
    """Trials under the ILC law around rods that have no model: each trial at once."""

    # On a circle |z| = r > 1 the z-transform of a signal that is weighted by r^-p is a Fourier
    # transform, and the loop is a product, if it is stable. What wraps around after N samples comes
    # back as r^-N: nothing to speak of. Both filters are products, too, since beyond the ends of a
    # trial signals are zero; to filter in time, as the law does, would take two thirds longer.

    def __init__(self, loop, Q, filters, reference, trials):
        self.loop, self.trials, T = loop, trials, len(reference)
        order = max(L.order for L in filters)
        tail = int(
            np.log(ALIAS**3) / np.log(np.abs(Q.poles).max())
        )  # of Q, as far as it may wrap
        self.samples, self.N = (
            T,
            next_fast_len(max(int(WRAP * T), T + order + tail), real=True),
        )
        r = ALIAS ** (-1 / self.N)
        self.growth, self.decay = r ** np.arange(max(T, order)), r ** -np.arange(self.N)
        omega = rfftfreq(self.N, loop.Ts / (2 * np.pi))
        self.grid = Grid(loop, omega, r)
        z = r * np.exp(1j * omega * loop.Ts)
        self.Q = _butterworth(Q, z) * _butterworth(Q, 1 / z)
        self.ahead = z ** np.arange(1, order + 1)[:, None]
        c = np.zeros((len(filters), *filters[0].coefficients.shape[:2], 2 * order))
        for f, L in enumerate(filters):
            c[f, :, :, : L.order] = L.coefficients
        self.L = np.einsum("fijk,kn->fijn", c[..., :order], self.ahead)
        # q samples before the trial, L sees c_(q + p) e(p).
        self.first = np.lib.stride_tricks.sliding_window_view(c, order, axis=3)[
            :, :, :, :order
        ]
        self.w = self._transform(reference.T)

    def rms(self, rods: Sequence[HeldRod]) -> np.ndarray:
        """RMS(e_k) of every trial, shape (rods, filters, trials)."""
        G = [
            self._transform(rod.impulse_response(self.N, self.loop.controls))
            for rod in rods
        ]
        P = np.array([self.grid.closed(each) for each in G])
        V = np.zeros((len(rods), 1, *self.w.shape))  # one filter is like another as yet
        rms = np.empty((len(rods), len(self.L), self.trials))
        for k in range(self.trials):
            Y = np.einsum("gijn,gfjn->gfin", P, self.w + V)
            e = irfft(self.w - Y, self.N)  # weighted by r^-p
            e[..., self.samples :] = 0
            plain = e[..., : len(self.growth)] * self.growth
            rms[:, :, k] = np.sqrt(
                np.einsum("gfit,gfit->gf", plain, plain) / self.samples
            )
            if k + 1 < self.trials:
                V = (
                    V
                    + np.einsum("fijn,gfjn->gfin", self.L, rfft(e))
                    - self._before(plain)
                )
                v = irfft(self.Q * V, self.N)
                v[..., self.samples :] = 0
                V = rfft(v)  # (23)
        return rms

    def _before(self, e):
        """What L looks ahead to from before the trial, where it is not applied."""
        first = np.einsum(
            "fijqp,gfjp->gfiq", self.first, e[..., : self.first.shape[-1]]
        )
        return (first @ self.ahead.view(float)).view(complex)

    def _transform(self, signal):
        return rfft(signal * self.decay[: signal.shape[-1]], self.N)


def _butterworth(Q, z):
    """The forward half of the Q-filter."""
    return np.prod(
        [np.polyval(s[:3], z) / np.polyval(s[3:], z) for s in Q.sections], axis=0
    )


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
        Where finished batches are kept, one file each, so that a run that was interrupted, or one
        with more rods, goes on. Default: nowhere.
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
        (below one the error converges monotonically, Lemma 1), `rate_omega`, where that is,
        `spectral_rate`, the largest spectral radius of M (below one the error converges), and
        `objective`, the sum of (39). `rms` of each rod, filter and trial. NaN where the loop is not
        stable. Units as attributes; the spread, the root and the study's name, too.
    """
    arguments.instance("study", study, Study)
    rods = arguments.whole("rods", rods, 1)
    workers = None if workers is None else arguments.whole("workers", workers, 0)
    if not (
        scheduler is None
        or (isinstance(scheduler, str) and ADDRESS.fullmatch(scheduler))
    ):
        raise ValueError(
            f"scheduler = {reprlib.repr(scheduler)} must be an address, such as 'tcp://host:8786'"
        )
    kept = (
        TemporaryDirectory()
        if folder is None
        else nullcontext(arguments.path("folder", folder))
    )
    with kept as where:
        found = _in_batches(study, rods, files.folder(Path(where)), scheduler, workers)
    return _dataset(study, found)


def _in_batches(study, rods, where, scheduler, workers):
    """Judge the batches that are not in the folder yet, and put together all that are."""
    parts = [(start, min(start + SIZE, rods)) for start in range(0, rods, SIZE)]
    paths = {
        part: where / f"{study.name}-{part[0]:06}-{part[1]:06}.npz" for part in parts
    }
    with files.alone(
        where / "lock", f"another process is at work in {where}: wait or stop it"
    ):
        missing = [part for part in parts if not paths[part].exists()]
        judged = _judged(study, missing, scheduler, workers)
        for part, found in tqdm(judged, total=len(missing), disable=None):
            with (
                files.replacing(paths[part]) as temporary,
                open(temporary, "wb") as file,
            ):
                np.savez(file, **found)
    kept = [dict(np.load(path)) for path in paths.values()]
    return {name: np.concatenate([found[name] for found in kept]) for name in kept[0]}


def _judged(study, parts, scheduler, workers):
    """Judge batches in this process or on dask, and give each as soon as it is finished."""
    if not parts or (workers == 0 and scheduler is None):
        yield from ((part, study.judge(*part)) for part in parts)
        return
    import dask  # here, since that takes a second
    from dask.system import CPU_COUNT
    from distributed import Client, as_completed

    cluster = {
        "n_workers": min(workers or CPU_COUNT, len(parts)),
        "threads_per_worker": 1,
        "dashboard_address": ":0",  # any free port: another cluster may be running
        "silence_logs": logging.CRITICAL,
    }
    with (
        dask.config.set(MEMORY),
        Client(scheduler, **({} if scheduler else cluster)) as client,
    ):
        name = study.name
        judged = {
            client.submit(_judge, study, name, *part, pure=False): part
            for part in parts
        }
        for future in as_completed(judged):
            yield judged[future], future.result()


def _judge(study, name, start, stop):
    if study.name != name:
        raise RuntimeError(
            "a worker has another rodlib than this process, or other parameters"
        )
    return study.judge(start, stop)


@cache
def _code():
    """A hash of all modules."""
    paths = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()


def _plain(value):
    if isinstance(value, control.StateSpace):
        return [
            *control.ssdata(value),
            value.dt,
            value.input_labels,
            value.output_labels,
        ]
    return value.tolist()


def _dataset(study, found):
    variables = {
        name: (dimensions, found[name], {"units": unit})
        for name, (dimensions, unit) in FOUND.items()
    }
    coordinates = {
        "rod": np.arange(len(found["rms"])),
        "filter": list(study.filters),
        "trial": np.arange(1, study.trials + 1),
        "channel": np.arange(1, len(study.loop.outputs) + 1),
        "element": study.nominal.inputs[:-1],
    }
    spread = {
        f"spread_{field.name}": getattr(study.spread, field.name)
        for field in fields(Spread)
    }
    attributes = {
        "root": study.root,
        "study": study.name,
        "Ts": study.loop.Ts,
        **spread,
    }
    return xr.Dataset(variables, coordinates, attributes)
