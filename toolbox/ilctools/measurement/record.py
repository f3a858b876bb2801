"""Records of one plant, checked once, from which a response is estimated.

A log may hold further inputs of the plant as its signal `disturbance`. These inputs were measured,
but no loop commands them. If a disturbance varies, the estimate treats the disturbance as an input,
like the commanded inputs. If a log lacks a disturbance that another log has, the disturbance counts
as constant in this log, and its effect counts as noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.errors import LogError
from ilctools.law.limits import Actuators
from ilctools.law.notes import RESET, limits_of, loop_of
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.measurement.arx.trials import Trials, longest_of
from ilctools.signals import Signals, check_match, period_of

FEWEST_SAMPLES = 20  # smallest number of samples of a trial
# A disturbance that varies less than this, relative to its size, is constant except for rounding.
ROUNDING_OF_DISTURBANCE = 1e-12
# The radius is computed from the fourth power of P. If signals move by 1e30 and 1e-30, this power
# is at most 1e240, which a double still holds. No quantity of a rig has such a size in SI units.
LARGEST_MOVES, SMALLEST_MOVES = 1e30, 1e-30


class Sizes(NamedTuple):
    """RMS value of each signal in all trials.

    The mean of each trial is subtracted beforehand.
    """

    inputs: np.ndarray  # (m,)
    outputs: np.ndarray  # (p,)


@dataclass(frozen=True)
class Record:
    """Inputs and outputs of logs, in units of `sizes`.

    Each signal is relative to its value before the trial.
    """

    groups: tuple[Trials, ...]  # one group of trials for each length
    inputs: list[str]
    sizes: Sizes
    delay: np.ndarray  # samples after which y responds at the earliest, (input,)
    direct: bool  # whether y(t) may depend on the inputs at t, or at t - delay
    source: str  # the inputs: "w" or "u"
    loop: Loop  # the loop of the record; a ClosedLoop without P, if the logs name none
    disturbances: tuple[str, ...] = ()  # known disturbances that vary: further inputs

    @classmethod
    def of(
        cls, logs: xr.Dataset | Sequence[xr.Dataset], source: str | None = None, delay=None
    ) -> "Record":
        """Make a record from one log or several logs, which are checked.

        `source` and `delay` have the meaning of `of` and `delay` in
        :func:`ilctools.measured_response`.
        """
        logs = [logs] if isinstance(logs, xr.Dataset) else logs
        logs = [log.transpose("trial", "time", ...) for log in logs]
        named = {f"log[{i}]" if len(logs) > 1 else "log": log for i, log in enumerate(logs)}
        check_match(**{name: Signals.of_log(log) for name, log in named.items()})
        source = _source_of(logs, source)
        loop = _loop_of(logs[0], source)
        inputs = loop.learned if source == "w" else logs[0].control.values.tolist()
        moves = [_moves(name, log, source) for name, log in named.items()]
        u, y, first = [one.u for one in moves], [one.y for one in moves], next(iter(named))
        remedy = "its effect is not known. Record it while it moves, by a step or by noise"
        check_moved(u, inputs, f"{first}.{source}", remedy)
        check_moved(y, loop.outputs, f"{first}.y", "is its sensor connected?")
        delay = _samples_of(arguments.by_channel("delay", delay, inputs), len(inputs))
        disturbances, known = _known_disturbances(moves)
        sizes = Sizes(_sizes(u), _sizes(y))
        return cls(
            groups=_groups(moves, known, sizes),
            inputs=inputs,
            sizes=sizes,
            delay=delay,
            direct=source == "w" or "reference" not in logs[0] or delay.min() > 0,
            source=source,
            loop=loop,
            disturbances=disturbances,
        )

    @property
    def longest(self) -> int:
        """Number of samples of the longest trial."""
        return longest_of(self.groups)

    def __str__(self):
        trials = sum(len(group.y) for group in self.groups)
        names = ", ".join(self.disturbances)
        known = f"the known disturbances {names}, other " if names else ""
        return (
            f"{trials} trials of up to {self.longest} samples, from {self.source} to y; "
            f"assumed: y is moved only by {self.source}, {known}disturbances that repeat in "
            "all trials of the same length, noise and drift"
        )


class _Moves(NamedTuple):
    """The signals of a log; each signal is relative to its value before the trial."""

    u: np.ndarray  # (trial, time, channel)
    y: np.ndarray  # (trial, time, channel)
    disturbance: dict[str, np.ndarray]  # (trial, time) each, by name
    titles: tuple[str, ...]  # of the trials, in messages


def _groups(moves, known, sizes):
    """Group trials by their length.

    The same disturbance may repeat in all trials of one length.
    """
    alike = {}
    for one, disturbances in zip(moves, known, strict=True):
        u = np.concatenate([one.u / sizes.inputs, disturbances], axis=2)
        trials = Trials(u, one.y / sizes.outputs, one.titles, disturbances.shape[2])
        alike.setdefault(one.y.shape[1], []).append(trials)
    return tuple(
        Trials(
            u=np.concatenate([trials.u for trials in group]),
            y=np.concatenate([trials.y for trials in group]),
            names=tuple(name for trials in group for name in trials.names),
            known=group[0].known,
        )
        for group in alike.values()
    )


def _source_of(logs, asked):
    """Return the requested inputs, w or u.

    The default is w if all logs have a reference, and u otherwise.
    """
    if asked is None:
        return "w" if all("reference" in log for log in logs) else "u"
    return arguments.choice("of", asked, ["u", "w"])


def _known_disturbances(moves):
    """Return the disturbances that vary in any log: their names, and their changes in each log.

    The changes are relative to the first sample of a trial, in units of their RMS. Their shape is
    (trial, time, disturbance).
    """
    names = {name: 0 for one in moves for name, signal in one.disturbance.items() if signal.any()}
    if not names:
        return (), [one.y[..., :0] for one in moves]
    known = [
        np.stack([one.disturbance.get(name, 0 * one.y[..., 0]) for name in names], axis=2)
        for one in moves
    ]
    check_moved(known, names, "disturbance", "leave it out")
    return tuple(names), [x / _sizes(known) for x in known]


def _loop_of(log, source):
    """Return the loop that a log names.

    If the input is not w, or if the log names no loop, a loop without P is returned.
    """
    outputs, units = log.output.values.tolist(), log.output_unit.values.tolist()
    named = loop_of(log) if source == "w" else None
    units = dict(zip(outputs, units, strict=True))
    return named or ClosedLoop(None, period_of(log), outputs, units=units)


def _moves(name, log, source):
    """Return the inputs, the outputs and the known disturbances of a log.

    Each signal is relative to its value before the trial.
    """
    u, before, others = _inputs(name, log, source)
    u = arguments.array(f"{name}.{source}", u, ("trial", "time", "channel"))
    y = arguments.array(f"{name}.y", log.y.values, (*u.shape[:2], "channel"))
    if len(y[0]) < FEWEST_SAMPLES:
        raise LogError(
            f"{name} has {len(y[0])} samples in a trial, but must have {FEWEST_SAMPLES} or more"
        )
    known = _disturbances_of(name, log, y.shape[:2]) | others
    if RESET in log.attrs:  # trials continue where the last one ended: one record
        u, y, before = (signal.reshape(1, -1, signal.shape[2]) for signal in (u, y, before))
        known = {source: signal.reshape(1, -1) for source, signal in known.items()}
    with np.errstate(over="ignore"):  # check_moved refuses an overflow
        known = {source: _without_rounding(signal) for source, signal in known.items()}
        return _Moves(u - before[:, :1], y - y[:, :1], known, _titles(log, len(y), name))


def _inputs(name, log, source):
    """Return the inputs, their values before each trial, and known disturbances by name.

    The first row of the second signal is the value at which the inputs rest before a trial. Inputs
    of a loop that take only a reference count as known disturbances.
    """
    if source == "w" and "reference" not in log:
        raise LogError(f"{name} has no reference, and therefore no w: take of = 'u'")
    if source == "u" and "u" not in log:
        raise LogError(
            f"{name} has no commands u: take of = 'w', or name them in `inputs` of read_table"
        )
    if source == "u":  # commands rest at their own first row
        u = log.get("applied", log.u).values
        return u, u, {}
    limits, loop, r = limits_of(log), loop_of(log), log.reference.values
    if loop is None and "input" in log.coords:
        raise LogError(
            f"{name} has a v of inputs, but names no loop, which would state what "
            "else drives these inputs"
        )
    v = log.v.values if "v" in log else 0 * r
    if limits and loop:  # the v that corresponds to the applied commands
        asked = np.asarray(loop.asked(log))
        v = loop.realised(v, asked, Actuators.of(limits, loop).follow(asked))
    if loop is None or loop.one_for_one:
        return r + v, r, {}  # w rests at the reference's first row
    w, before = loop.w(r, v), loop.w(r, 0 * v)
    others = {n: w[..., i] for i, n in enumerate(loop.inputs) if n not in loop.learned}
    return w @ loop.G, before @ loop.G, others


def _without_rounding(signal):
    """Subtract from each trial its first sample; the signal has the shape (trial, time).

    If the remaining changes are mere rounding errors, they are set to zero.
    """
    moves = signal - signal[:, :1]
    return moves * (np.abs(moves).max() > ROUNDING_OF_DISTURBANCE * np.abs(signal).max())


def _disturbances_of(name, log, shape):
    """Return the known disturbances of a log by name.

    Each disturbance has the shape (trial, time).
    """
    if "disturbance" not in log:
        return {}
    signals = arguments.array(f"{name}.disturbance", log.disturbance.values, (*shape, "source"))
    names = arguments.different(f"{name}.source", log.source.values.tolist())
    return dict(zip(names, np.moveaxis(signals, 2, 0), strict=True))


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
    """Refuse signals with a channel that never changes.

    The signal of each log has the shape (trial, time, channel). Signals whose changes are too large
    or too small for floating-point numbers are also refused.
    """
    with np.errstate(over="ignore"):
        each = [np.abs(x - x[:, :1]).max(axis=(0, 1)) for x in signals]
    moves = np.max(each, axis=0)
    if still := [name for name, most in zip(names, moves, strict=True) if most == 0]:
        raise LogError(f"{what} of {', '.join(still)} never moved: {remedy}")
    for name, most in zip(names, moves, strict=True):
        if not SMALLEST_MOVES <= most <= LARGEST_MOVES:
            raise LogError(
                f"{what} of {name} moves by {most:.3g}: choose a unit in which it moves by "
                f"{SMALLEST_MOVES:g} to {LARGEST_MOVES:g}"
            )


def _sizes(signals):
    """Compute the RMS of each channel, relative to the mean of each trial.

    The signals have the shape (trial, time, channel).
    """
    moves = [(x - x.mean(axis=1, keepdims=True)).reshape(-1, x.shape[2]) for x in signals]
    return np.sqrt(np.mean(np.concatenate(moves) ** 2, axis=0))
