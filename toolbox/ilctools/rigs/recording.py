"""Trials on a rig, one after the other: each is watched, and kept when it ends."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from tqdm import tqdm

from ilctools import arguments
from ilctools.files import alone, append, regular
from ilctools.law.io import BEGUN, KEYS, RESET
from ilctools.law.limits import CUT_OFF, commands_beyond
from ilctools.logs.format import columns_of, rows_as_text, signals_of, write_log
from ilctools.logs.reader import read_log
from ilctools.rigs.controlled import ControlledRig
from ilctools.rigs.protocol import RigError, StoppedError
from ilctools.trials.diagnosis import diagnose
from ilctools.trials.run import dataset
from ilctools.trials.start import Start

LATE = 0.1  # sampling periods that a sample may be off the clock
NOTED = (*KEYS, RESET, "excitation", "loop")  # the notes of what makes the trials
SIGNALS = ("v", "u", "y", "applied", "delta", "disturbance")  # that a trial may have
Trial = dict[str, np.ndarray]  # its signals, shape (time, channel)
ENDS = ("SIGINT", "SIGTERM", "SIGHUP")  # Ctrl-C; kill, a service's stop; a closed terminal
USUAL = (signal.SIG_DFL, signal.default_int_handler)
BREATH = 1e-4  # s, between two pieces of a log, in which a sample that is due gets the processor


@dataclass
class Experiment:
    """What all trials of an experiment have in common; `log` are those that have ended."""

    rig: ControlledRig
    reference: np.ndarray  # shape (trial, time, output)
    commanded: np.ndarray  # of the disturbances that are inputs
    following: Callable[[list[Trial]], np.ndarray]  # v after these trials
    notes: dict[str, str]  # of what makes the trials
    log: xr.Dataset | None = None
    trials: list[Trial] = field(default_factory=list)
    lost: bool = False  # whether rounding left nothing of the last v
    size: int | None = None  # of the log, in bytes, as this experiment left it

    def run(self, pause: int | None, path) -> Iterator[str]:
        """Run the trials that are not in the log at `path` yet; what there is to be warned of."""
        lock = nullcontext()
        if path is not None:
            path = regular(arguments.path("path", path))
            if not path.parent.is_dir():
                raise ValueError(f"path = '{path}' must be in a folder that exists")
            busy = f"path = '{path}' is recorded to by another process: wait, or give another path"
            lock = alone(path.with_name(f".{path.name}.lock"), busy)
        with lock:
            if path is not None and path.exists():
                self.go_on_from(read_log(path, ended=True), path)
            ended, count = len(self.trials), len(self.reference)
            if ended > count:
                number = f"{ended} trials, more than trials = {count}"
                yield f"path = '{path}' has {number}: all of them are returned"
            if ended < count:
                if ended:
                    self.save(path, self.log)
                yield from self.run_on(pause, path)

    def run_on(self, pause, path) -> Iterator[str]:
        """Run the trials that follow those that have ended; leave the rig safe on every way out."""
        rig, ended, count, shown = self.rig, len(self.trials), len(self.reference), set()
        samples = (count - ended) * self.reference.shape[1]
        try:
            with (
                ThreadPoolExecutor(1) as writer,
                left_safe(rig.make_safe),
                tqdm(total=samples, disable=None) as bar,
            ):
                saved = writer.submit(int)
                if rig.goes_on:
                    rig.begin(ended + 1)
                for k in range(ended, count):
                    bar.set_description(f"trial {k + 1} of {count}")
                    trial, late = self.run_trial(k, pause, bar)
                    self.trials.append(trial)
                    self.log = self.dataset()
                    saved.result()  # or the error of what was written meanwhile
                    if path is not None:
                        saved = writer.submit(self.save, path, self.log)
                        if not rig.goes_on:
                            saved.result()
                    texts = {"pause": late} | self.warnings()
                    new = {kind: texts[kind] for kind in texts if texts[kind] and kind not in shown}
                    shown |= new.keys() - {"pause", "clock", "rig"}  # which are of each trial
                    yield from new.values()
                saved.result()
        except RigError as error:
            text = f"{rig.place}: {error}. Nothing was applied after it"
            if isinstance(error, StoppedError):
                raise self.stopped(text, path) from None
            raise type(error)(text) from None
        except Exception as error:
            error.add_note(f"in {rig.place}")
            raise

    def save(self, path, log) -> None:
        """Add the last trial of a log to its file, or write all where that is not as it was left.

        In pieces, because meanwhile the next trial may run.
        """
        if path.exists() and path.stat().st_size == self.size:
            k, breath = len(log.trial) - 1, BREATH * self.rig.goes_on
            trial = self.trials[k] | {"reference": self.reference[k]}
            names = columns_of(signals_of(log), log)
            rows = rows_as_text(k + 1, log.time.values, [trial[name] for name in names])
            append(path, (piece for piece in rows if time.sleep(breath) is None))
        else:
            write_log(log, path)
        self.size = path.stat().st_size

    def run_trial(self, k, pause, bar) -> tuple[Trial, str]:
        """Run trial k, counted from 0, and what there is to say of the pause before it.

        If the rig goes on, in parts whose v follows from those before; else it is one part.
        """
        rig, reference, commanded = self.rig, self.reference[k], self.commanded[k]
        parts, done, late = [], 0, ""
        while done < len(reference):
            following = self.following(self.trials + parts)[: len(reference) - done]
            v = rig.rounded("v", following)
            self.lost = bool(following.any() and not v.any())
            if not rig.goes_on:
                rig.begin(k + 1)
                late = rig.pause(k + 1, pause, reference[0], self.start()) if k else ""
            now = slice(done, done + len(v))
            signals = rig.run(k + 1, reference[now] + v, commanded[now], bar, done)
            parts.append({"v": v} | signals)
            done += len(v)
        return in_succession(parts), late

    def warnings(self) -> dict[str, str]:
        """What the last trial shows, with those before it, by kinds."""
        rig, trial, number = self.rig, self.trials[-1], len(self.trials)
        reference, after, texts = self.reference[number - 1], f"after trial {number}: ", {}
        u = rig.loop.asked(reference + trial["v"], trial.get("u"))
        limits = rig.limits if rig.actuators is None else rig.law.limits
        beyond = commands_beyond(u, rig.commands, limits)
        if beyond and rig.actuators is not None:
            texts["limits"] = after + beyond + CUT_OFF
        elif beyond:
            what = "what the rig cuts off, the law does not know"
            texts["rig"] = f"trial {number}: {beyond}; {what}"
        if rig.law is not None:
            for kind, text in diagnose(self.log, rig.law, first=number).items():
                texts[kind] = after + text
            text = self.another_start()
            texts["start"] = text and after + text
        if self.lost:
            texts["decimals"] = f"{after}decimals rounds all of v to zero: give it more digits"
        late = np.array(rig.late)
        count = np.sum(late > LATE * rig.Ts)
        if count:
            words = f"{count} samples were not on time, by up to {late.max():.3g} s"
            texts["clock"] = f"trial {number}: {words}"
        return texts

    def another_start(self) -> str:
        """How far the last trial started from where the first one did, in words."""
        number = len(self.trials)
        reference = self.reference[number - 1]
        alike = np.array_equal(reference[0], self.reference[0, 0])
        if self.rig.goes_on or number == 1 or not alike:
            return ""
        start = self.start()
        away = "" if self.rig.law.L is None else start.away(reference)
        return start.missed(self.trials[-1]["y"]) or away

    def start(self) -> Start:
        """Where the first trial started."""
        return Start.of(self.trials[0]["y"], self.reference[0], self.rig.loop)

    def stopped(self, text, path) -> StoppedError:
        """The error, with the trials before it and how to go on."""
        where = "the attribute trials of this error" if path is None else f"'{path}'"
        stopped = StoppedError(
            f"{text}. The rig is left safe; {len(self.trials)} trial(s) are kept in {where}. If "
            "units, signs and wires are right, learn less, by a smaller gain or a lower cut-off, "
            "in another log; or go on with wider limits, by stop"
        )
        stopped.trials = self.log
        return stopped

    def dataset(self) -> xr.Dataset:
        """The signals of all trials, put together."""
        loop, trials = self.rig.loop, self.trials
        signals = {name: np.stack([t[name] for t in trials]) for name in trials[0]}
        signals["reference"] = self.reference[: len(trials)]
        sources = self.rig.recorded
        data = dataset(loop.Ts, loop.outputs, loop.controls, sources, loop.units, **signals)
        return data.assign_attrs(self.notes)

    def go_on_from(self, log, path) -> None:
        """Take the trials of a log, and its notes; refuse those of another experiment."""
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
        names = [name for name in SIGNALS if name in log]
        self.trials = [{name: log[name].values[k] for name in names} for k in range(len(numbers))]
        self.log, self.notes = log, log.attrs | self.notes


@contextmanager
def left_safe(make_safe: Callable[[], None]) -> Iterator[None]:
    """Leave a rig safe on every way out of a block, and let no signal cut that short.

    In the main thread, signals that end a process, unless somebody else handles them, end the block
    by an exception; a later one counts when the rig is safe.
    """
    came, leaving = [], False

    def note(number, frame):
        came.append(number)
        if not leaving and len(came) == 1:
            leave()

    def leave():
        raise KeyboardInterrupt if came[0] == signal.SIGINT else SystemExit(128 + came[0])

    main = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in ENDS if main and hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler in USUAL}
    try:
        try:
            for number in before:
                signal.signal(number, note)
            yield
        finally:
            leaving = True
    finally:  # also where the first signal has come just before
        try:
            make_safe()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        if came:
            leave()


def in_succession(parts: list[Trial]) -> Trial:
    """The signals of trials, or of parts of one, as of one trial."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
