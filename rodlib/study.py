"""For which rods does it converge? Many rods: drawn, judged and simulated.

Rods are judged in batches, each by itself, so that any number of workers finds the same.
"""

from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr
from scipy.fft import irfft, next_fast_len, rfft

from ilctools import arguments
from ilctools.evidence.convergence import convergence
from ilctools.filters import LearningFilter, ZeroPhaseButterworth
from ilctools.law.law import Law
from ilctools.loop.closed import CurrentTrialLoop
from rodlib.case import assumed_reference
from rodlib.rod import Rod
from rodlib.specimens import (
    MATERIAL,
    PAPER,
    Spread,
    check_loop,
    draw,
    impulse_responses,
    responses,
    unstable_poles,
)

SIZE = 100  # rods in a batch: some seconds
UNITS = {
    "density": "kg/m3",
    "heat_capacity": "J/(kg K)",
    "heat_transfer": "W/(m2 K)",
    "conductivity": "W/(m K)",
    "sensors": "m",
    "at": "rad/s",
    "rms": "K",
}


@dataclass(frozen=True)
class Study:
    """Which rods may be, and under which laws the loop around them learns.

    See Also
    --------
    draw : one rod
    synthesise : a filter for several plants

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import LearningFilter, zero_phase_butterworth
    >>> from rodlib import Spread, Study, paper_loop
    >>> filters = {"weak": LearningFilter(0.1 * np.eye(2)[:, :, None], Ts=1.0)}
    >>> Q, spread = zero_phase_butterworth(2, 0.1, 1.0), Spread.of_all(0.05)
    >>> study = Study(paper_loop(), Q, filters, spread, reference=np.ones((200, 2)), trials=2)
    >>> study.run(rods=2).sizes["rod"]
    2
    """

    loop: CurrentTrialLoop  # of a rod, as designed; the controller stays
    Q: ZeroPhaseButterworth
    filters: dict[str, LearningFilter]  # by name
    spread: Spread  # how far off the rods are
    nominal: Rod = PAPER  # what they were meant to be
    root: int = 0  # of the random numbers
    omega: np.ndarray | None = None  # default: 1000 from 1e-4 rad/s to Nyquist
    reference: np.ndarray | None = None  # (time, m); default: that of rodlib.case
    trials: int = 5

    def __post_init__(self):
        arguments.instance("nominal", self.nominal, Rod)
        draw(self.spread, 0, self.root, self.nominal)  # which checks the other two
        loop = self.loop
        check_loop(loop, self.nominal)
        if not arguments.instance("filters", self.filters, dict):
            raise ValueError("filters = {} must hold at least one learning filter, by name")
        for name, L in self.filters.items():
            arguments.instance(f"filters[{name!r}]", L, LearningFilter)
            Law(self.Q, L, loop=loop)  # which checks that they fit together
        omega, reference = self.omega, self.reference
        if omega is None:
            omega = np.geomspace(1e-4, np.pi, 1000) / loop.Ts
        if reference is None:
            reference = assumed_reference()
        omega = arguments.increasing_frequencies("omega", omega, loop.Ts)
        shape = ("time", len(loop.outputs))
        reference = arguments.array("reference", reference, shape)
        vars(self).update(omega=omega, reference=reference)
        arguments.whole("trials", self.trials, 1)

    def run(self, rods: int, client=None) -> xr.Dataset:
        """Draw so many rods and judge them.

        Parameters
        ----------
        rods : int
        client : dask.distributed.Client, optional
            Whose workers do it; they need this rodlib. Default: this process.

        Returns
        -------
        xarray.Dataset
            Of each rod its parameters, `sensors` and `gains`, and the number of unstable poles of
            the loop around it. Of each rod and filter `gamma`, the largest sigma_max(M) over the
            frequencies (below one the error converges monotonically, Lemma 1), `at`, where that is,
            and `spectral_radius`, the largest of M (below one the error converges). `rms` of each
            rod, filter and trial. NaN where the loop is unstable. Units, the spread, the root and
            Ts as attributes.
        """
        rods = arguments.whole("rods", rods, 1)
        numbers = [range(rods)[k : k + SIZE] for k in range(0, rods, SIZE)]
        if client is None:
            batches = [self._judge(batch) for batch in numbers]
        else:
            batches = client.gather(client.map(self._judge, numbers))
        attributes = {"root": self.root, "Ts": self.loop.Ts}
        for name, share in asdict(self.spread).items():
            attributes[f"spread_{name}"] = share
        return xr.concat(batches, "rod").assign_attrs(attributes)

    def _judge(self, numbers):
        """The dataset of some rods, by their numbers."""
        loop, filters = self.loop, self.filters.values()
        specimens = [draw(self.spread, k, self.root, self.nominal) for k in numbers]
        unstable = unstable_poles(loop, specimens)
        P = responses(loop, specimens, self.omega)
        results = [convergence(P, self.Q, L, self.omega) for L in filters]
        impulses = impulse_responses(loop, specimens, len(self.reference))
        stable = unstable == 0
        rms = np.full((len(filters), len(specimens), self.trials), np.nan)
        count = next_fast_len(2 * len(self.reference), real=True)
        P = rfft(impulses[stable], count, axis=1)
        rms[:, stable] = [self._rms(P, count, L) for L in filters]
        variables = {name: ("rod", [getattr(s.rod, name) for s in specimens]) for name in MATERIAL}
        variables["sensors"] = ("rod", "channel"), [s.rod.sensors for s in specimens]
        variables["gains"] = ("rod", "element"), [s.gains for s in specimens]
        variables["unstable_poles"] = "rod", unstable
        for name in ("gamma", "at", "spectral_radius"):
            values = np.array([getattr(result, name) for result in results])
            variables[name] = ("filter", "rod"), np.where(stable, values, np.nan)
        variables["rms"] = ("filter", "rod", "trial"), rms
        coordinates = {
            "rod": list(numbers),
            "filter": list(self.filters),
            "trial": np.arange(1, self.trials + 1),
            "channel": loop.outputs,
            "element": self.nominal.inputs[:-1],
        }
        data = xr.Dataset(variables, coordinates).transpose("rod", ...)
        for name in data:
            data[name].attrs["units"] = UNITS.get(name, "1")
        return data

    def _rms(self, P, count, L):
        """RMS(e_k) of trials (23) around rods, by transforms of the loop over `count` samples."""
        samples = len(self.reference)
        v = np.zeros((len(P), *self.reference.shape))
        rms = np.empty((len(P), self.trials))
        for k in range(self.trials):
            w = rfft(self.reference + v, count, axis=1)
            y = irfft(np.einsum("rnij,rnj->rni", P, w), count, axis=1)
            e = self.reference - y[:, :samples]
            rms[:, k] = np.sqrt((e**2).sum(axis=2).mean(axis=1))
            if k + 1 < self.trials:
                v = self.Q.apply(v + L.apply(e))  # (23)
        return rms
