"""Running an experiment on a rig, trial by trial: learning by the ILC law, or shaking the loop."""

import os
from dataclasses import dataclass

import numpy as np
import xarray as xr
from tqdm import tqdm

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningFilter, LearningOperator, ZeroPhaseButterworth, update
from rodlib.ilc.laboratory.bench import Bench, Rig
from rodlib.ilc.laboratory.excitation import Excitation
from rodlib.ilc.laboratory.loading import load_ended
from rodlib.ilc.laboratory.notes import MADE_BY, with_excitation, with_law
from rodlib.ilc.laboratory.saving import append_log, save_log
from rodlib.ilc.loop import CurrentTrialLoop
from rodlib.ilc.trials import check_law, dataset


def record(
    rig: Rig,
    loop: CurrentTrialLoop,
    Q: ZeroPhaseButterworth,
    L: LearningOperator | None,
    reference,
    disturbance=None,
    trials: int = 10,
    pause: int = 600,
    *,
    path=None,
    rest: int = 0,
    step: float = 1.0,
    decimals: dict[str, int] | None = None,
) -> xr.Dataset:
    """Run an experiment of several trials on a rig and record it.

    Between two trials the controller keeps running for `pause` samples, as in the paper, so that
    the rig is back at the start of the reference when the next trial begins. However this ends,
    the rig is left in a safe state. On a terminal, progress is shown.

    Parameters
    ----------
    rig : Rig
    loop : CurrentTrialLoop
        Its names and units are those of the record.
    Q, L : ZeroPhaseButterworth, LearningOperator
        L None switches learning off. A log can name no other L than a LearningFilter.
    reference : array_like, shape (time, m)
    disturbance : array_like, shape (time, d) or (trial, time, d), optional
        What to command to those of ``loop.disturbances`` that are inputs of the rig. What it
        measures of them is recorded instead of the values given here; of others nothing is known,
        and they must be zero. Further trials than those recorded are ignored. Default zero.
    trials, pause : int
    path : path-like, optional
        Of a log, where each trial is written when it ends. If the log is there, its trials must be
        of the same experiment, and the next one follows; what a killed process has left of a trial
        is dropped. Without a path, a fault costs all trials.
    rest : int
        Number of samples at the end of every trial in which v is held at zero.
    step : float
        Of :func:`rodlib.update`, in (0, 1], the same after every trial.
    decimals : dict, optional
        Of v, u (rounded before they act), delta and measured disturbances. Default: all digits.

    Returns
    -------
    xarray.Dataset
        As from :func:`rodlib.run_trials`, with the disturbances that are commanded or measured.

    Raises
    ------
    ValueError
        If something is missing from the rig, the filters, the loop and the rig do not belong
        together, a signal has the wrong shape or a gap, a unit is unknown, or the log at `path` is
        that of another experiment; before anything is applied.
    RigError
        If a reading is not finite or has the wrong shape: the trial ends, those before it stay.

    Warns
    -----
    UserWarning
        After a trial in which samples were not on time, if the rig has a clock, or commands beyond
        what it follows, if it has limits.
    """
    bench = Bench(rig, loop, decimals)
    Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
    check_law(loop, Q, L, rig=Ts)
    if path is not None and L is not None:
        arguments.instance("L", L, LearningFilter)  # or the log could not say what made it
    trials = arguments.whole("trials", trials, 1)
    pause = arguments.whole("pause", pause, 0)
    reference = arguments.array("reference", reference, ("time", loop.plant.noutputs))
    rest = arguments.whole("rest", rest, 0, len(reference) - 1)
    step = arguments.share("step", step)
    commanded = bench.commanded(disturbance, trials, len(reference))
    plan = _Learning(loop, reference, bench.recorded, Q, L, rest, step)
    return _conduct(bench, plan, commanded, pause, path)


def shake(
    rig: Rig,
    loop: CurrentTrialLoop,
    excitation: Excitation,
    *,
    path=None,
    decimals: dict[str, int] | None = None,
) -> xr.Dataset:
    """Shake the loop on a rig, w = v, and record it: the trials from which P can be estimated.

    Each experiment of the excitation is a trial; the reference is zero, there is no pause. However
    this ends, the rig is left in a safe state. On a terminal, progress is shown.

    Parameters
    ----------
    rig : Rig
    loop : CurrentTrialLoop
        Of the controller that runs, whose names and units are those of the record.
    excitation : Excitation
        From :func:`multisine`.
    path : path-like, optional
        Of a log, as in :func:`record`: what is there is gone on with.
    decimals : dict, optional
        As in :func:`record`.

    Returns
    -------
    xarray.Dataset
        As from :func:`record`, with the excitation and the limits of the rig noted in the metadata.
        For :func:`measured_response`.

    Raises
    ------
    ValueError
        As in :func:`record`; if the excitation is for another number of channels.
    RigError
        If a reading is not finite or has the wrong shape: the trial ends, those before it stay.

    Warns
    -----
    UserWarning
        After a trial in which samples were not on time, if the rig has a clock, or commands beyond
        what it follows, if it has limits.
    """
    bench = Bench(rig, loop, decimals)
    arguments.instance("excitation", excitation, Excitation)
    Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
    arguments.one_period(loop=loop.Ts, rig=Ts, excitation=excitation.Ts)
    signals = excitation.signals
    m = loop.plant.noutputs
    if excitation.channels != m:
        raise ValueError(f"excitation is for {excitation.channels} channels, but the loop has {m}")
    commanded = bench.commanded(None, *signals.shape[:2])
    reference = np.zeros(signals.shape[1:])
    limits = {name: bench.limits[name] for name in loop.controls if name in bench.limits}
    plan = _Shaking(loop, reference, bench.recorded, excitation, signals, limits)
    return _conduct(bench, plan, commanded, 0, path)


def _conduct(bench, plan, commanded, pause, path):
    """Run the trials of a plan that are not in the log at `path` yet; all trials."""
    path = None if path is None else arguments.path("path", path)
    if path is not None and not path.parent.is_dir():
        raise ValueError(f"path = '{path}' must be in a folder that exists")
    signals = plan.go_on(path) if path is not None and path.exists() else plan.nothing()

    done, trials, reference = len(signals["y"]), len(commanded), plan.reference
    total = max(0, trials - done) * (len(reference) + pause) - (0 if done else pause)
    with bench.in_the_end_safe(done < trials), tqdm(total=total, disable=None) as bar:
        for k in range(done, trials):
            v = plan.v(signals)
            bar.set_description(f"trial {k + 1} of {trials}")
            bench.begin(k + 1)
            bench.pause(k + 1, pause if k else 0, reference[0], bar)
            trial = bench.run(k + 1, reference, v, commanded[k], bar)
            for name, values in signals.items():
                values.append(trial[name])
            if path is not None:
                one = plan.trials({name: values[-1:] for name, values in signals.items()}, k + 1)
                (append_log if k else save_log)(one, path)
    return plan.trials(signals)


@dataclass(frozen=True)
class _Plan:
    """What all trials of an experiment have in common."""

    loop: CurrentTrialLoop
    reference: np.ndarray
    sources: list[str]  # of the disturbances that are recorded

    def nothing(self) -> dict[str, list]:
        """The signals of no trials yet."""
        names = ("v", "u", "y", "delta", *(["disturbance"] if self.sources else []))
        return {name: [] for name in names}

    def trials(self, signals, first: int = 1) -> xr.Dataset:
        """The signals of some trials, put together, with what made them noted."""
        loop, count = self.loop, len(signals["y"])
        stacked = {name: np.stack(values) for name, values in signals.items()}
        stacked["reference"] = np.broadcast_to(self.reference, stacked["y"].shape)
        run = dataset(
            loop.Ts, loop.outputs, loop.controls, self.sources, loop.units, **stacked
        )  # fmt: skip
        return self.noted(run.assign_coords(trial=np.arange(first, first + count)))

    def go_on(self, path) -> dict[str, list]:
        """The signals of the trials in a log, of which a part of a last trial is cut off."""
        found, size = load_ended(path)
        own = [np.array_equal(reference, self.reference) for reference in found.reference]
        differing = [] if all(own) else ["reference"]
        wanted = self.noted(xr.Dataset()).attrs
        differing += [key for key in MADE_BY if found.attrs.get(key) != wanted.get(key)]
        sources = found.source.values.tolist() if "source" in found.coords else []
        if sources != self.sources:
            differing.append("disturbances")
        if found.trial.values.tolist() != list(range(1, found.sizes["trial"] + 1)):
            differing.append("numbers of the trials")
        if differing:
            raise ValueError(
                f"path = '{path}' holds another experiment, see its {', '.join(differing)}: give "
                "another path, or go on with the same"
            )
        os.truncate(path, size)
        return {name: list(found[name].values) for name in self.nothing()}


@dataclass(frozen=True)
class _Learning(_Plan):
    """Trials under the ILC law."""

    Q: ZeroPhaseButterworth
    L: LearningOperator | None
    rest: int
    step: float

    def v(self, signals) -> np.ndarray:
        """That of the trial after those given."""
        if self.L is None or not signals["y"]:
            return np.zeros_like(self.reference)
        e = self.reference - signals["y"][-1]
        return update(signals["v"][-1], e, self.Q, self.L, self.rest, self.step)

    def noted(self, run: xr.Dataset) -> xr.Dataset:
        return with_law(run, self.Q, self.L, self.rest, self.loop, self.step)


@dataclass(frozen=True)
class _Shaking(_Plan):
    """Trials in which v is given."""

    excitation: Excitation
    signals: np.ndarray
    limits: dict[str, list[float]]

    def v(self, signals) -> np.ndarray:
        """That of the trial after those given."""
        return self.signals[len(signals["y"])]

    def noted(self, run: xr.Dataset) -> xr.Dataset:
        return with_excitation(run, self.excitation, self.loop, self.limits)
