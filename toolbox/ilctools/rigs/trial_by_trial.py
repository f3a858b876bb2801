"""Run trials on a rig, one after the other; each is checked, and saved when it ends."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr

from ilctools.law.notes import BETWEEN, LAW_KEYS, RESET
from ilctools.logs.reader import read_log
from ilctools.progress import progress
from ilctools.rigs.controlled import ControlledRig
from ilctools.rigs.description import RigDescription
from ilctools.rigs.trial_log import TrialLog, log_path, without_others
from ilctools.rigs.watch import start_of, warn_once, warnings_of
from ilctools.signals import dataset, points_of, with_points
from ilctools.trials.learn import Part, joined, learn
from ilctools.trials.parts import parts_of

# notes of a log that describe how the trials are made
COMPARED_NOTES = (*LAW_KEYS, RESET, BETWEEN, "excitation", "loop")


@dataclass
class Past:
    """The trials of an experiment that have ended."""

    notes: dict[str, str]  # of the log of these trials
    trials: list[Part] = field(default_factory=list)
    log: xr.Dataset | None = None  # the log of all these trials


@dataclass(frozen=True)
class Experiment:
    """What all trials of an experiment have in common."""

    about: RigDescription
    reference: np.ndarray  # shape (trial, time, output)
    flows: np.ndarray  # commanded disturbances, shape (trial, time, commanded disturbance)
    # computes v from the trials that have ended and the next reference
    following: Callable[[list[Part], np.ndarray], np.ndarray]
    notes: dict[str, str]  # notes that describe how the trials are made
    pause: int | None  # samples between two trials; None: until the outputs are back
    points: np.ndarray | None = None  # (time, output): where the error counts, if not everywhere

    def finish(self, path) -> xr.Dataset:
        """Run the trials that are not yet in the log at `path`; return the log of all trials."""
        if path is None:
            return self.go_on(Past(self.notes), None)
        path = log_path(path)
        past = self.past_in(path)
        missing = len(self.reference) - len(past.trials)
        if missing <= 0:
            return past.log  # even from a place where nothing can be written
        if not os.access(path.parent, os.W_OK):
            raise PermissionError(
                f"path = '{path}' cannot be written to, but {missing} of {len(self.reference)} "
                "trials are not in it: give another path"
            )
        with without_others(path):  # others may have added trials until now
            return self.go_on(self.past_in(path), path)

    def past_in(self, path: Path) -> Past:
        """Read the trials of the log at `path`, if this log exists.

        The log of another experiment is refused.
        """
        if not path.exists():
            return Past(self.notes)
        log = read_log(path, ended=True)
        self.check_same(log, path)
        return Past(log.attrs | self.notes, parts_of(log), log)

    def check_same(self, log: xr.Dataset, path: Path) -> None:
        """Refuse a log of another experiment."""
        sources = log.source.values.tolist() if "source" in log.coords else []
        asked = self.reference[: len(log.trial)]
        same = {
            "reference": np.array_equal(log.reference[: len(asked)], asked),
            "v of trial 1": np.array_equal(log.v[0], self.v_after([], self.reference[0])),
            **{key: log.attrs.get(key) == self.notes.get(key) for key in COMPARED_NOTES},
            "disturbances": sources == self.about.signals.disturbances,
            "points": np.array_equal(points_of(log), self.points),
            "numbers": log.trial.values[-1] == len(log.trial),
        }
        if differing := [what for what, is_same in same.items() if not is_same]:
            raise ValueError(
                f"path = '{path}' holds another experiment, which differs in "
                f"{', '.join(differing)}: give another path, or continue with the same "
                "arguments"
            )

    def v_after(self, trials: list[Part], upcoming) -> np.ndarray:
        """Compute the next v after some trials, for the next reference.

        v is rounded to the digits that are recorded.
        """
        return self.about.rounded("v", self.following(trials, upcoming))

    def go_on(self, past: Past, path: Path | None) -> xr.Dataset:
        """Run the missing trials; leave the rig safe, however the run ends."""
        if len(past.trials) >= len(self.reference):
            return past.log
        file = TrialLog(path)
        if past.trials:
            file.replace(past.log)  # without an incomplete last trial
        rig = ControlledRig(self.about)
        try:
            with file.thread:
                try:
                    rig.interrupts.watch()
                    self.add_trials(rig, past, file)
                finally:
                    rig.interrupts.leave()
        except Exception as error:
            error.trials = past.log
            error.add_note(
                f"This happened in {rig.place}. After it, only the commands that leave the rig "
                f"safe were applied. The attribute trials of this error has {len(past.trials)} "
                f"trials (path = {path})"
            )
            raise
        return past.log

    def add_trials(self, rig: ControlledRig, past: Past, file: TrialLog) -> None:
        """Run the missing trials; save each trial, and warn of problems that it shows."""
        ended, count, kinds_warned_of = len(past.trials), len(self.reference), set()
        with progress(total=self.reference[ended:, :, 0].size) as bar:
            if self.about.goes_on:
                rig.begin(ended + 1)
            for number in range(ended + 1, count + 1):
                bar.set_description(f"trial {number} of {count}", refresh=False)
                past.trials.append(self.trial_on(rig, past.trials, bar))
                past.log = self.log_of(past)
                file.add(past.log, past.trials[-1])
                if not self.about.goes_on:
                    file.finish()
                shown = warnings_of(self.about, past.log, past.trials, rig.late)
                warn_once({"pause": rig.pause_warning} | shown, kinds_warned_of)
            file.finish()

    def trial_on(self, rig: ControlledRig, past: list[Part], bar) -> Part:
        """Run the trial that follows the trials `past`.

        If trials are not reset, the trial is run in parts.
        """
        number, reference = len(past) + 1, self.reference[len(past)]

        def respond(w, now):
            if not self.about.goes_on:
                rig.begin(number)
                if past:
                    start = start_of(self.about, past[0])
                    rig.pause_warning = rig.pause(number, self.pause, reference[0], start)
            return rig.drive(number, w, self.flows[number - 1, now], bar, now.start)

        loop = self.about.loop
        return joined(learn(loop, respond, self.v_after, reference, past))  # (22), (23)

    def log_of(self, past: Past) -> xr.Dataset:
        """Make the log of the trials that have ended."""
        loop, signals = self.about.loop, joined(past.trials, np.stack)
        names = loop.outputs, loop.controls, self.about.signals.disturbances
        learned = () if loop.one_for_one else loop.learned
        log = dataset(loop.Ts, *names, loop.units, learned=learned, **signals)
        return with_points(log, self.points).assign_attrs(past.notes)
