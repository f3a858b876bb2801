"""Trials on a rig, one after the other: each is watched, and kept when it ends."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from tqdm import tqdm

from ilctools import arguments
from ilctools.files import alone
from ilctools.law.io import BEGUN, KEYS, RESET
from ilctools.law.law import Law
from ilctools.law.limits import CUT_OFF, commands_beyond
from ilctools.logs.format import save_log
from ilctools.logs.reader import load_log
from ilctools.rigs.controlled import ControlledRig
from ilctools.rigs.protocol import StoppedError
from ilctools.trials.diagnosis import (
    GROWTH,
    ROUNDING,
    SIGNIFICANCE,
    chance,
    degrees_of_freedom,
    diagnose,
    histories,
    rms,
    spectrum,
)
from ilctools.trials.run import commands_of, dataset
from ilctools.trials.start import Start

LATE = 0.1  # sampling periods that a sample may be off the clock
NOTED = (*KEYS, RESET, "excitation", "loop")  # the notes of what makes the trials
SIGNALS = ("v", "u", "y", "applied", "delta", "disturbance")  # that a trial may have
Trial = dict[str, np.ndarray]  # its signals, shape (time, channel)


@dataclass(frozen=True)
class Experiment:
    """What all trials of an experiment have in common."""

    rig: ControlledRig
    reference: np.ndarray  # shape (trial, time, output)
    commanded: np.ndarray  # of the disturbances that are inputs
    following: Callable[[list[Trial]], np.ndarray]  # v after these trials
    notes: dict[str, str]  # of what makes the trials
    law: Law | None = None
    alike: bool = True  # whether all trials start from the same state

    def run(self, pause: int | None, path) -> xr.Dataset:
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
        """As `run`, with the path of a log that this process alone writes, or None."""
        trials, notes, count = [], {}, len(self.reference)
        if path is not None and path.exists():
            log = load_log(path)
            self.check(log, path)
            notes = {key: n for key, n in log.attrs.items() if key not in NOTED}
            names = [name for name in SIGNALS if name in log]
            for k in range(log.sizes["trial"]):
                trials.append({name: log[name].values[k] for name in names})
            if len(trials) > count:
                warnings.warn(
                    f"path = '{path}' has {len(trials)} trials, more than trials = {count}: all of "
                    "them are returned",
                    stacklevel=4,
                )
            if len(trials) >= count:
                return log

        first, shown = len(trials), set()
        samples = (count - first) * self.reference.shape[1]
        with self.rig.safe_in_the_end(), tqdm(total=samples, disable=None) as bar:
            if self.rig.goes_on:
                self.rig.begin(first + 1)
            for k in range(first, count):
                bar.set_description(f"trial {k + 1} of {count}")
                try:
                    trials.append(self.run_trial(k, trials, pause, bar))
                except StoppedError as error:
                    raise self.stopped(error, trials, notes, path) from None
                data = self.dataset(trials, notes)
                if path is not None:
                    save_log(data, path)
                for kind, text in self.warnings(data, trials, k == first).items():
                    if kind not in shown:
                        warnings.warn(text, stacklevel=4)
                    shown.add(kind)
        return data

    def run_trial(self, k, trials, pause, bar) -> Trial:
        """Run trial k, counted from 0, after those before it."""
        if self.rig.goes_on:
            return self.run_on(k, trials, bar)
        v, reference = self.rig.rounded("v", self.following(trials)), self.reference[k]
        self.rig.begin(k + 1)
        if k and self.rig.waits:
            self.rig.pause(k + 1, pause, reference[0], self.start(trials))
        signals = self.rig.run(k + 1, reference + v, self.commanded[k], bar)
        return {"v": v} | signals

    def run_on(self, k, trials, bar) -> Trial:
        """Run trial k from where the last one ended, in parts whose v follows from those before."""
        reference, commanded, parts, done = self.reference[k], self.commanded[k], [], 0
        while done < len(reference):
            v = self.rig.rounded("v", self.following(trials + parts))
            v = v[: len(reference) - done]
            now = slice(done, done + len(v))
            signals = self.rig.run(k + 1, reference[now] + v, commanded[now], bar, done)
            parts.append({"v": v} | signals)
            done += len(v)
        return in_succession(parts)

    def warnings(self, data: xr.Dataset, trials: list[Trial], resumed: bool) -> dict:
        """What the last trial shows, with those before it, by kinds; each is warned of once."""
        texts, rig, trial, number = {}, self.rig, trials[-1], len(trials)
        reference, cut_off = self.reference[number - 1], rig.actuators is not None
        u = commands_of(rig.loop, reference + trial["v"], trial)["u"]
        limits = self.law.limits if cut_off else rig.limits
        beyond = commands_beyond(u, rig.commands, limits)
        if beyond and cut_off:
            texts["limits"] = beyond + CUT_OFF
        if self.alike and number > 1 and np.array_equal(reference[0], self.reference[0, 0]):
            start = self.start(trials)
            learns = self.law is not None and self.law.L is not None
            texts["start"] = start.missed(trial["y"]) or (learns and start.away(reference))
        if self.law is not None:
            texts |= diagnose(data, self.law, first=number)
            if resumed:
                texts["resumed"] = departs(data, self.law)
        texts = {kind: f"after trial {number}: {text}" for kind, text in texts.items() if text}
        if beyond and not cut_off:  # of every trial
            text = f"{beyond}; what the rig cuts off, the law does not know"
            texts[f"trial {number}"] = f"trial {number}: {text}"
        count = np.sum(np.array(rig.late) > LATE * rig.Ts)
        if count:
            texts[f"clock in trial {number}"] = (
                f"trial {number}: {count} samples were not on time, by up to {max(rig.late):.3g} s"
            )
        return texts

    def start(self, trials) -> Start:
        """Where the first trial started."""
        return Start.of(trials[0]["y"], self.reference[0], self.rig.loop)

    def stopped(self, error, trials, notes, path) -> StoppedError:
        """The error, with the trials before it and how to go on."""
        where = "the attribute trials of this error" if path is None else f"'{path}'"
        stopped = StoppedError(
            f"{error}. The rig is left safe; {len(trials)} trial(s) are kept in {where}. If units, "
            "signs and wires are right, learn less, by a smaller gain or a lower cut-off, in "
            "another log; or go on with wider limits, by stop"
        )
        stopped.trials = self.dataset(trials, notes) if trials else None
        return stopped

    def dataset(self, trials, notes) -> xr.Dataset:
        """The signals of all trials, put together."""
        loop = self.rig.loop
        signals = {name: np.stack([t[name] for t in trials]) for name in trials[0]}
        signals["reference"] = self.reference[: len(trials)]
        channels = loop.outputs, loop.controls, self.rig.recorded
        data = dataset(loop.Ts, *channels, loop.units, **signals)
        return data.assign_attrs(notes | data.attrs | self.notes)

    def check(self, log, path) -> None:
        """Refuse to go on with the trials of another experiment."""
        sources = log.source.values.tolist() if "source" in log.coords else []
        numbers = log.trial.values.tolist()
        both = min(len(numbers), len(self.reference))
        same = {
            "reference": np.array_equal(log.reference[:both], self.reference[:both]),
            **{key: log.attrs.get(key) == self.notes.get(key) for key in NOTED},
            "disturbances": sources == [*self.rig.recorded],
            "numbers of the trials": numbers == [*range(1, len(numbers) + 1)],
        }
        if BEGUN in self.notes:
            first = self.rig.rounded("v", self.following([]))
            same["v of trial 1"] = np.array_equal(log.v[0], first)
        differing = [what for what, is_same in same.items() if not is_same]
        if differing:
            raise ValueError(
                f"path = '{path}' holds another experiment, see its {', '.join(differing)}: give "
                "another path, or go on with the same"
            )


def in_succession(parts: list[Trial]) -> Trial:
    """The signals of trials, or of parts of one, as of one trial."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def departs(data: xr.Dataset, law: Law) -> str:
    """F test of the first trial after those of a log, against how the last of them followed; "".

    What the model leaves of the changes from trial to trial, or without one all of them, shrinks
    (Lemma 1) down to noise. Null hypothesis: it is noise of the variance and spectrum of the last.
    """
    for history in histories(data, law):
        last = len(history.e) - 1
        if history.since[last] > last - 2:
            continue
        unlearned = history.e if history.P is None else history.free
        changes = np.diff(unlearned[-3:], axis=0)
        before, now = np.maximum(rms(changes), ROUNDING * np.abs(history.e).max())
        freedom = degrees_of_freedom(spectrum(changes[0])).item()
        if now > GROWTH * before and chance(now / before, freedom, 2) < SIGNIFICANCE:
            return (
                f"its error{history.of_outputs} is off by {now:.3g} from what follows from the "
                f"last trial of the log, which was off by {before:.3g}: are plant, loop and "
                "disturbances the same? If not, give another path"
            )
    return ""
