"""Trials on a rig, one after the other: each is watched, and kept when it ends."""

import errno
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.files import alone, append, regular
from ilctools.law.limits import CUT_OFF, commands_beyond
from ilctools.law.notes import KEYS, RESET
from ilctools.logs.format import columns_of, rows_as_text, signals_of, write_log
from ilctools.logs.reader import read_log
from ilctools.progress import progress
from ilctools.rigs.controlled import ControlledRig
from ilctools.signals import dataset
from ilctools.trials.diagnosis import diagnose
from ilctools.trials.learn import Part, joined, learn
from ilctools.trials.recorded import parts_of
from ilctools.trials.start import Start

DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)  # of a file or a folder that is read only
LATE = 0.1  # sampling periods that a sample may be off the clock
NOTED = (*KEYS, RESET, "excitation", "loop")  # the notes of what makes the trials


@dataclass
class Experiment:
    """What all trials of an experiment have in common; `log` are those that have ended."""

    rig: ControlledRig
    reference: np.ndarray  # shape (trial, time, output)
    commanded: np.ndarray  # of the disturbances that are inputs
    following: Callable[[list[Part]], np.ndarray]  # v after these trials
    notes: dict[str, str]  # of what makes the trials
    log: xr.Dataset | None = None
    trials: list[Part] = field(default_factory=list)
    size: int | None = None  # of the log, in bytes, as this experiment left it

    def run(self, pause: int | None, path) -> xr.Dataset:
        """Run the trials that are not in the log at `path` yet; the log of all."""
        with ExitStack() as locks:
            if path is not None:
                # absolute, because a driver may change the working directory
                path = regular(arguments.path("path", path)).absolute()
                if not path.parent.is_dir():
                    raise ValueError(f"path = '{path}' must be in a folder that exists")
                self.open_log(path, locks)
            if len(self.trials) < len(self.reference):
                if self.trials:
                    write_log(self.log, path)  # without a last trial that is torn
                    self.size = path.stat().st_size
                self.run_on(pause, path)
        return self.log

    def open_log(self, path, locks) -> None:
        """Keep other processes from the log at `path`, and take the trials that it has.

        Where nothing can be written, a log that has all trials is still read.
        """
        denied, lock = None, path.with_name(f".{path.name}.lock")
        busy = f"path = '{path}' is recorded to by another process: wait, or give another"
        try:
            locks.enter_context(alone(lock, busy))
        except OSError as error:
            if error.errno not in DENIED:
                raise
            denied = error
        if path.exists():
            self.go_on_from(read_log(path, ended=True), path)
        missing = len(self.reference) - len(self.trials)
        if denied and missing > 0:
            raise PermissionError(
                f"path = '{path}' cannot be written to, but {missing} of {len(self.reference)} "
                f"trials are not in it: give another path ({denied})"
            )

    def run_on(self, pause, path) -> None:
        """Run the trials that follow those that have ended; leave the rig safe on every way out."""
        rig = self.rig
        try:
            with ThreadPoolExecutor(1) as writer:
                try:
                    rig.interrupts.watch()
                    self.run_trials(pause, path, writer)
                finally:
                    rig.interrupts.leave()
        except Exception as error:
            error.trials = self.log
            error.add_note(
                f"in {rig.place}; nothing was applied after it but what leaves the rig safe; the "
                f"attribute trials of this error has {len(self.trials)} (path = {path})"
            )
            raise

    def run_trials(self, pause, path, writer) -> None:
        """Run them, each of which is saved, and warn of what it shows."""
        rig, ended, count, shown = self.rig, len(self.trials), len(self.reference), set()
        loop, names = rig.loop, (rig.loop.outputs, rig.loop.controls, rig.recorded)
        with progress(total=self.reference[ended:, :, 0].size) as bar:
            saved = writer.submit(int)
            if rig.goes_on:
                rig.begin(ended + 1)
            for k in range(ended, count):
                bar.set_description(f"trial {k + 1} of {count}", refresh=False)
                trial, late = self.run_trial(k, pause, bar)
                self.trials.append(trial)
                signals = joined(self.trials, np.stack)
                data = dataset(loop.Ts, *names, loop.units, **signals)
                self.log = data.assign_attrs(self.notes)
                saved.result()  # or the error of what was written meanwhile
                if path is not None:
                    saved = writer.submit(self.save, path, self.log)
                    if not rig.goes_on:
                        saved.result()
                for kind, text in ({"pause": late} | self.warnings()).items():
                    if text and kind not in shown:
                        warnings.warn(text, stacklevel=5)
                        shown |= {kind} - {"pause", "clock", "rig"}  # which are of each trial
            saved.result()

    def save(self, path, log) -> None:
        """Add the last trial of a log to its file, or write all where there is none.

        By rows, because meanwhile the next trial may run. What others wrote there is left alone.
        """
        if not path.exists():
            write_log(log, path)
        elif path.stat().st_size == self.size:
            k, names = len(log.trial), columns_of(signals_of(log), log)
            rows = rows_as_text(k, log.time.values, [self.trials[k - 1][name] for name in names])
            append(path, rows)
        else:
            raise FileExistsError(
                f"path = '{path}' was changed by another program during a trial, and is left as it "
                "is: save the attribute trials of this error by save_log, at another path"
            )
        self.size = path.stat().st_size

    def run_trial(self, k, pause, bar) -> tuple[Part, str]:
        """Run trial k, counted from 0, and what there is to say of the pause before it.

        If the rig goes on, in parts whose v follows from those before; else it is one part.
        """
        rig, reference, late = self.rig, self.reference[k], ""

        def run(w, now):
            nonlocal late
            if not rig.goes_on:
                rig.begin(k + 1)
                late = rig.pause(k + 1, pause, reference[0], self.start()) if k else ""
            return rig.run(k + 1, w, self.commanded[k, now], bar, now.start)

        following = lambda trials: rig.rounded("v", self.following(trials))  # noqa: E731
        return joined(learn(run, following, reference, self.trials)), late

    def warnings(self) -> dict[str, str]:
        """What the last trial shows, with those before it, by kinds."""
        rig, trial, number, texts = self.rig, self.trials[-1], len(self.trials), {}
        limits = (rig.law and rig.law.limits) or rig.limits
        beyond = commands_beyond(rig.loop.asked(trial), rig.commands, limits)
        if beyond and rig.actuators is not None:
            texts["limits"] = beyond + CUT_OFF
        elif beyond:
            texts["rig"] = f"{beyond}; what the rig cuts off, the law does not know"
        if rig.law is not None:
            texts |= diagnose(self.log, rig.law, first=number)
            texts["start"] = self.another_start()
        if late := [off for off in rig.late if off > LATE * rig.Ts]:
            texts["clock"] = f"{len(late)} samples were not on time, by up to {max(late):.3g} s"
        return {kind: text and f"after trial {number}: {text}" for kind, text in texts.items()}

    def another_start(self) -> str:
        """How far the last trial started from where the first one did, in words."""
        first, trial = self.trials[0], self.trials[-1]
        alike = np.array_equal(trial["reference"][0], first["reference"][0])
        if self.rig.goes_on or trial is first or not alike:
            return ""
        missed = self.start().missed(trial["y"])
        return missed or (self.rig.law.L and self.start().away(trial["reference"]))

    def start(self) -> Start:
        """Where the first trial started."""
        return Start.of(self.trials[0]["y"], self.reference[0], self.rig.loop)

    def go_on_from(self, log, path) -> None:
        """Take the trials of a log, and its notes; refuse those of another experiment."""
        sources = log.source.values.tolist() if "source" in log.coords else []
        asked = self.reference[: len(log.trial)]
        same = {
            "reference": np.array_equal(log.reference[: len(asked)], asked),
            "v of trial 1": np.array_equal(log.v[0], self.rig.rounded("v", self.following([]))),
            **{key: log.attrs.get(key) == self.notes.get(key) for key in NOTED},
            "disturbances": sources == [*self.rig.recorded],
            "numbers": log.trial.values[-1] == len(log.trial),
        }
        if differing := [what for what, is_same in same.items() if not is_same]:
            raise ValueError(
                f"path = '{path}' holds another experiment, see its {', '.join(differing)}: give "
                "another path, or go on with the same"
            )
        self.trials, self.log, self.notes = parts_of(log), log, log.attrs | self.notes
