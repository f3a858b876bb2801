"""Records of one plant, checked once: what an estimate is made of."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.errors import LogError
from ilctools.labels import INPUT, matched
from ilctools.law.limits import Actuators
from ilctools.law.notes import RESET, limits_of, loop_of
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.measurement.regression import Trials, longest_of
from ilctools.signals import Signals, check_match, period_of

FEWEST = 20  # samples of a trial
AXES = "trial", "time", ...


@dataclass(frozen=True)
class Record:
    """Inputs and outputs of logs from before each trial on, in units of `sizes`."""

    groups: tuple[Trials, ...]  # of each length
    inputs: list[str]
    outputs: list[str]
    sizes: tuple[np.ndarray, np.ndarray]  # RMS of the moves of inputs (m,) and outputs (p,)
    delay: np.ndarray  # after which y answers at the earliest, (input,), samples
    direct: bool  # whether y(t) may depend on the inputs at t, or when the delay is over
    source: str  # the inputs: "w" or "u"
    loop: Loop  # from whose w to y it is; a ClosedLoop without P, if the logs name none

    @classmethod
    def of(
        cls, logs: xr.Dataset | Sequence[xr.Dataset], source: str | None = None, delay=None
    ) -> "Record":
        """Of a log or several; `source` and `delay` as for :func:`ilctools.measured_response`."""
        logs = [logs] if isinstance(logs, xr.Dataset) else logs
        named = {f"log[{i}]" if len(logs) > 1 else "log": log for i, log in enumerate(logs)}
        check_match(**{name: Signals.of_log(log) for name, log in named.items()})
        if source is None:
            source = "w" if all("reference" in log for log in logs) else "u"
        arguments.choice("of", source, ["u", "w"])
        loop = _loop_of(logs[0], source)
        inputs = loop.references if source == "w" else logs[0].control.values.tolist()
        first, *_ = named
        u, y = zip(*(_moves(*pair, source) for pair in named.items()), strict=True)
        remedy = "what follows from it is not known. Record it while it moves, by a step or noise"
        check_moved(u, inputs, f"{first}.{source}", remedy)
        check_moved(y, loop.outputs, f"{first}.y", "is it connected?")
        delay = _samples_of(matched("delay", delay, {INPUT: inputs}), len(inputs))
        sizes = _sizes(u), _sizes(y)
        alike = {}  # logs of one length are one: in all of them the same disturbance may repeat
        for (name, log), x, z in zip(named.items(), u, y, strict=True):
            trials = Trials(x / sizes[0], z / sizes[1], _titles(log, len(z), name))
            alike.setdefault(len(z[0]), []).append(trials)
        groups = [Trials(*map(np.concatenate, zip(*x, strict=True))) for x in alike.values()]
        direct = source == "w" or "reference" not in logs[0] or delay.min() > 0
        return cls(tuple(groups), inputs, loop.outputs, sizes, delay, direct, source, loop)

    @property
    def longest(self) -> int:
        """Samples of the longest trial."""
        return longest_of(self.groups)

    def __str__(self):
        trials = sum(len(group.y) for group in self.groups)
        return (
            f"{trials} trials of up to {self.longest} samples, from {self.source} to y; assumed: y "
            f"is moved by {self.source}, what repeats in all trials of a length, noise, drift only"
        )


def _loop_of(log, source):
    """The loop that a log names, if it is one from w; else one without P."""
    outputs, units = log.output.values.tolist(), log.output_unit.values.tolist()
    named = loop_of(log) if source == "w" else None
    units = dict(zip(outputs, units, strict=True))
    return named or ClosedLoop(None, period_of(log), outputs, units=units)


def _moves(name, log, source):
    """Inputs and outputs, from before each trial on."""
    if source == "w" and "reference" not in log:
        raise LogError(f"{name} has no reference, and so no w: take of = 'u'")
    if source == "u" and "u" not in log:
        raise LogError(f"{name} has no commands u: take of = 'w', or read them by `inputs`")
    u = log.get("applied", log.get("u")) if source == "u" else log.reference + log.get("v", 0)
    limits, loop = limits_of(log), loop_of(log)
    if source == "w" and limits and loop:  # w that asks for what was applied
        asked = loop.asked(log).values
        u.data = loop.realised(u.values, asked, Actuators.of(limits, loop).follow(asked))
    # Before a trial w rests at the reference's first row; commands, at their own.
    signals = [u, u if source == "u" else log.reference, log.y]
    u, before, y = (signal.transpose(*AXES).values for signal in signals)
    u = arguments.array(f"{name}.{source}", u, ("trial", "time", "channel"))
    y = arguments.array(f"{name}.y", y, (*u.shape[:2], "channel"))
    if len(y[0]) < FEWEST:
        raise LogError(f"{name} has {len(y[0])} samples in a trial, but must have {FEWEST} or more")
    if RESET in log.attrs:  # trials go on where the last one ended: one record
        u, y, before = (signal.reshape(1, -1, signal.shape[2]) for signal in (u, y, before))
    return u - before[:, :1], y - y[:, :1]


def _titles(log, trials, name):
    where = "" if name == "log" else f" of {name}"
    if trials < log.sizes["trial"]:
        return ("the trials" + where,)
    return tuple(f"trial {k}{where}" for k in log.trial.values)


def _samples_of(delay, m):
    delay = [delay or 0] * m if np.ndim(delay) == 0 else delay
    delay = arguments.array("delay", delay, (m,))
    if delay.min() < 0 or np.any(delay % 1):
        raise ValueError(f"delay = {delay.tolist()} must be whole numbers of samples, 0 or more")
    return delay.astype(int)


def check_moved(signals, names, what, remedy):
    """Refuse signals, (trial, time, channel) of each record, of which one stands still."""
    still = np.all([np.ptp(x, axis=1).max(axis=0) == 0 for x in signals], axis=0)
    if still.any():
        words = ", ".join(np.array(names)[still])
        raise LogError(f"{what} of {words} never moved: {remedy}")


def _sizes(signals):
    """Root mean square of the moves of signals (trial, time, channel)."""
    moves = [(x - x.mean(axis=1, keepdims=True)).reshape(-1, x.shape[2]) for x in signals]
    return np.sqrt(np.mean(np.concatenate(moves) ** 2, axis=0))
