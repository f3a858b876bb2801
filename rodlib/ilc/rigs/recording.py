"""Trials on a rig, one after the other: each is watched, and kept when it ends."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from tqdm import tqdm

from rodlib.ilc import arguments
from rodlib.ilc.files import alone
from rodlib.ilc.law.io import KEYS
from rodlib.ilc.law.law import Law
from rodlib.ilc.logs.log import load_ended, save_log
from rodlib.ilc.rigs.controlled import ControlledRig
from rodlib.ilc.rigs.limits import commands_beyond
from rodlib.ilc.rigs.protocol import StoppedError
from rodlib.ilc.rigs.start import Start
from rodlib.ilc.trials.diagnosis import diagnose
from rodlib.ilc.trials.run import commands_of, dataset

BEGUN = "begun"  # the note that says that v of trial 1 was given
NOTED = (*KEYS, "excitation", "loop")  # the notes of what makes the trials


@dataclass(frozen=True)
class Experiment:
    """What all trials of an experiment have in common."""

    rig: ControlledRig
    reference: np.ndarray  # shape (trial, time, output)
    commanded: np.ndarray  # of the disturbances that are inputs
    following: Callable[
        [dict[str, list]], np.ndarray
    ]  # v after the trials whose signals are given
    notes: dict[str, str]  # of what makes the trials
    law: Law | None = None
    alike: bool = True  # whether all trials start from the same state

    def run(self, pause, path) -> xr.Dataset:
        """Run the trials that are not in the log at `path` yet; all trials."""
        if path is None:
            return self.run_trials(pause, None)
        path = arguments.path("path", path)
        if not path.parent.is_dir():
            raise ValueError(f"path = '{path}' must be in a folder that exists")
        busy = f"path = '{path}' is recorded to by another process: wait, or give another path"
        with alone(path.with_name(f".{path.name}.lock"), busy):
            return self.run_trials(pause, path)

    def run_trials(self, pause, path) -> xr.Dataset:
        """As `run`, with the path of a log that nobody else writes, or None."""
        signals, notes = {name: [] for name in self.rig.recorded_signals}, {}
        if path is not None and path.exists():
            found = load_ended(path)
            self.check(found, path)
            signals = {name: list(found[name].values) for name in signals}
            notes = {key: n for key, n in found.attrs.items() if key not in NOTED}

        done, trials, said = len(signals["y"]), len(self.commanded), set()
        if done > trials:
            more = f"path = '{path}' has {done} trials, more than trials = {trials}"
            warnings.warn(
                f"{more}: none is run, and all of them are returned", stacklevel=4
            )
        if done >= trials:
            return found
        lasting = pause or 0
        samples = (trials - done) * (self.reference.shape[1] + lasting)
        samples -= 0 if done else lasting
        with self.rig.in_the_end_safe(), tqdm(total=samples, disable=None) as bar:
            for k in range(done, trials):
                v = self.following(signals)
                bar.set_description(f"trial {k + 1} of {trials}")
                try:
                    self.rig.begin(k + 1)
                    if k:
                        start = self.start(signals)
                        self.rig.pause(k + 1, pause, self.reference[k, 0], start, bar)
                    trial = self.rig.run(
                        k + 1, self.reference[k], v, self.commanded[k], bar
                    )
                except StoppedError as error:
                    raise self.stopped(error, signals, notes, path) from None
                for name, values in signals.items():
                    values.append(trial[name])
                if path is not None:
                    save_log(self.trials(signals, notes), path)
                for kind, finding in self.warnings(self.trials(signals, notes)).items():
                    if kind not in said:
                        warnings.warn(f"after trial {k + 1}: {finding}", stacklevel=4)
                    said.add(kind)
        return self.trials(signals, notes)

    def warnings(self, trials) -> dict[str, str]:
        """What the last of the trials says, with those before it."""
        k, texts = trials.sizes["trial"] - 1, {}
        r = self.reference
        if self.alike and k and np.array_equal(r[k, 0], r[0, 0]):
            y = trials.y.values
            if missed := self.start({"y": y}).missed(y[k]):
                texts["start"] = missed
        if self.law is None:
            return texts
        if self.rig.actuators:
            loop, last = self.rig.loop, trials.isel(trial=k)
            u = commands_of(loop, last.reference + last.v, last)["u"].values
            cut_off = commands_beyond(u, loop.commands, self.law.limits)
            if cut_off:
                texts["limits"] = (
                    f"{cut_off}, where they were cut off; v is learned within"
                )
        return texts | diagnose(trials, self.law, first=k + 1)

    def start(self, signals) -> Start:
        """Where the first trial started."""
        loop = self.rig.loop
        units = [loop.units[name] for name in loop.outputs]
        return Start.of(signals["y"][0], self.reference[0], loop.outputs, units)

    def stopped(self, error, signals, notes, path) -> StoppedError:
        """The error, with what is kept and how to go on."""
        kept, where = len(signals["y"]), "the attribute trials of this error"
        where = where if path is None else f"'{path}'"
        more = StoppedError(
            f"{error}. The rig is left safe; {kept} trial(s) are kept in {where}. If units, signs "
            "and wires are right, learn less, by a smaller gain or a lower cut-off, in another "
            "log; or go on with wider limits, by stop"
        )
        more.trials = self.trials(signals, notes) if kept else None
        return more

    def trials(self, signals, notes) -> xr.Dataset:
        """The signals of all trials, put together."""
        loop, signals = (
            self.rig.loop,
            {name: np.stack(each) for name, each in signals.items()},
        )
        signals["reference"] = self.reference[: len(signals["y"])]
        names = loop.outputs, loop.controls, self.rig.recorded
        trials = dataset(loop.Ts, *names, loop.units, **signals)
        return trials.assign_attrs(notes | trials.attrs | self.notes)

    def check(self, found, path) -> None:
        """Refuse the trials of another experiment."""
        pairs = zip(found.reference.values, self.reference, strict=False)
        own = [np.array_equal(one, other) for one, other in pairs]
        differing = [] if all(own) else ["reference"]
        differing += [k for k in NOTED if found.attrs.get(k) != self.notes.get(k)]
        first = self.rig.rounded_v(self.following({"y": [], "v": []}))
        if BEGUN in self.notes and not np.array_equal(found.v[0], first):
            differing.append("v of trial 1")
        sources = found.source.values.tolist() if "source" in found.coords else []
        if sources != self.rig.recorded:
            differing.append("disturbances")
        if found.trial.values.tolist() != list(range(1, found.sizes["trial"] + 1)):
            differing.append("numbers of the trials")
        if differing:
            raise ValueError(
                f"path = '{path}' holds another experiment, see its {', '.join(differing)}: give "
                "another path, or go on with the same"
            )
