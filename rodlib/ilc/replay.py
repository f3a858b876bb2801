"""A log, run again through its law and its loop: what both would have given.

The law and the loop are those that the log itself names. Where it names none, what would need
them is left out; report.py says so, and judges the rest.
"""

import reprlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.law.io import law_of
from rodlib.ilc.law.law import Law
from rodlib.ilc.law.limits import realised
from rodlib.ilc.logs.log import signals_of
from rodlib.ilc.logs.notes import loop_of
from rodlib.ilc.loop.closed import ClosedLoop, Loop
from rodlib.ilc.models import state_sequence
from rodlib.ilc.rigs.recording import BEGUN
from rodlib.ilc.rigs.start import Start
from rodlib.ilc.trials.diagnosis import Course, rates_of
from rodlib.ilc.trials.run import commands_of, run_trials

DEPARTS = 1e-3  # of the largest v, that it is off where another law may have made it
EXPLAINS = 0.01  # of that, which a mistake may leave


@dataclass(frozen=True)
class Replay:
    """A log, and what its law and its loop make of it; None stands for what they are needed for."""

    trials: xr.Dataset  # in the order of their numbers
    loop: Loop | None
    law: Law | None
    untold: tuple[str, ...]  # disturbances that the simulation is not told of

    @property
    def rest(self) -> int:
        """Samples at the end of every trial in which v was held at zero."""
        return 0 if self.law is None else self.law.rest

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return self.trials.output.values.tolist()

    @property
    def numbers(self) -> list[int]:
        """Numbers of the trials."""
        return self.trials.trial.values.tolist()

    @property
    def sources(self) -> list[str]:
        """Names of the disturbances that were recorded."""
        return (
            self.trials.source.values.tolist() if "source" in self.trials.coords else []
        )

    @cached_property
    def disturbance(self) -> np.ndarray | None:
        """What was recorded of the loop's disturbances, shape (trial, time, d); zero of others."""
        if self.loop is None:
            return None
        names = self.loop.disturbances
        d = np.zeros((len(self.numbers), self.trials.sizes["time"], len(names)))
        for i, name in enumerate(names):
            if name in self.sources:
                d[..., i] = self.trials.disturbance.sel(source=name)
        return d

    @cached_property
    def simulated(self) -> xr.Dataset | None:
        """The same experiment on the model: the law, each trial's reference, the disturbances."""
        if self.loop is None or self.law is None or self.loop.P is None:
            return None
        if not self.from_the_first:
            return None
        reference = self.trials.reference.values
        unknown = (
            self.loop.disturbances if isinstance(self.loop, ClosedLoop) else self.untold
        )
        told = self.disturbance * [
            name not in unknown for name in self.loop.disturbances
        ]
        v = self.trials.v.values[0] if self.begun else None
        with warnings.catch_warnings(action="ignore"):  # the log's own findings say it
            return run_trials(self.loop, self.law, reference, told, len(reference), v=v)

    @cached_property
    def predicted(self) -> np.ndarray | None:
        """Outputs of the model, from zero, under what was recorded of its inputs; no feedback.

        Of a ClosedLoop, whose model is that of the loop, these are w.
        """
        if self.loop is None or self.loop.P is None or self.diverges:
            return None
        closed = isinstance(self.loop, ClosedLoop)
        if not closed and "u" not in self.trials:
            return None
        model, signals = (
            self.loop.P if closed else self.loop.plant,
            self._commands["applied"],
        )
        signals = (
            signals if closed else np.concatenate([signals, self.disturbance], axis=2)
        )
        zero = np.zeros(model.nstates)
        states = np.stack(
            [state_sequence(model.A, s @ model.B.T, zero) for s in signals]
        )
        return states @ model.C.T + signals @ model.D.T

    @cached_property
    def _commands(self):
        """What was asked for, u, and what was applied of it, shape (trial, time, m)."""
        w = (self.trials.reference + self.trials.v).values
        signals = {name: x.values for name, x in self.trials.items()}
        commands = commands_of(self.loop, w, signals)
        actuators = self.law and self.law.actuators
        applied = actuators.follow(commands["u"]) if actuators else commands["u"]
        return {"applied": applied} | commands

    @property
    def fit(self) -> pd.DataFrame | None:
        """1 - ||y - y-hat|| / ||y - mean y|| by trial and output: 1 is a perfect prediction."""
        if self.predicted is None:
            return None
        y = self.trials.y.values
        spread = np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1)
        missed = np.linalg.norm(y - self.predicted, axis=1)
        missed = np.divide(
            missed, spread, out=np.full_like(spread, np.nan), where=spread > 0
        )
        return pd.DataFrame(
            1 - missed, pd.Index(self.numbers, name="trial"), self.outputs
        )

    @cached_property
    def departure(self) -> pd.DataFrame | None:
        """How far v is at most from what follows from the trial before, if that is in the log."""
        if self.law is None:
            return None
        v, found = self.trials.v.values, {}
        for k, number in enumerate(self.numbers):
            if not self.begun and (number == 1 or self.law.L is None):
                expected = 0.0
            elif k and self.numbers[k - 1] == number - 1:
                expected = self._after(k - 1)
            else:
                expected = np.nan
            found[number] = np.abs(v[k] - expected).max(axis=0)
        return pd.DataFrame.from_dict(found, "index", columns=self.outputs).rename_axis(
            "trial"
        )

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """What speaks against the trials: they do not converge, or start elsewhere."""
        trials = self.trials
        if np.any(np.diff(self.numbers) != 1):
            return ()
        y, reference = trials.y.values, trials.reference.values
        names = self.outputs, trials.output_unit.values.tolist()
        found = {}
        if self.from_the_first:
            start = Start.of(y[0], reference[0], *names)
            for k in range(1, len(y)):
                alike = np.array_equal(reference[k, 0], reference[0, 0])
                if alike and (missed := start.missed(y[k])):
                    found.setdefault("start", f"trial {k + 1}: {missed}")
        if self._course is not None:
            found |= self._course.all_findings()
        if slip := self._slip():
            found["law"] = slip
        return tuple(found.values())

    @cached_property
    def _course(self):
        """The trials with what the law and the loop promise of them."""
        if self.law is None or self.law.L is None:
            return None
        P = None if self.loop is None else self.loop.P
        promised = (None, None) if P is None else rates_of(P, self.law.Q, self.law.L)
        v, e, reference = (self.trials[name].values for name in ("v", "e", "reference"))
        v = realised(self.loop, v, **self._commands) if self.law.limits else v
        units = self.trials.output_unit.values.tolist()
        return Course(
            v, e, reference, self.outputs, units, self.numbers[0], P, *promised
        )

    def reached(self, trial: int = 2) -> pd.DataFrame | None:
        """The rate that a trial reached, by octaves, see :meth:`Course.reached`; for all outputs.

        None if law, model or trial before are not there, if the law or the reference changed
        there, or if the outputs have different units.
        """
        course, k = self._course, arguments.whole("trial", trial, 1) - self.numbers[0]
        if course is None or course.P is None or not 0 < k < len(self.numbers):
            return None
        changed = not np.array_equal(*course.reference[k - 1 : k + 1])
        if changed or len({*course.units}) > 1 or np.any(np.diff(self.numbers) != 1):
            return None
        table = pd.DataFrame(course.reached(k - 1)).set_index("frequency")
        return table.assign(promised=1 - self.law.gain * (1 - table.promised))

    def _slip(self):
        """What made v, if not the law but the law with a usual mistake, as elsewhere programmed."""
        law = self.law
        if self.departure is None or law.L is None or law.limits:
            return None
        v, e = (self.trials[name].values for name in ("v", "e"))
        for k in range(1, len(v)):
            off = np.abs(self._after(k - 1) - v[k]).max()
            if off <= DEPARTS * np.abs(v).max():
                continue
            slips = {
                "e with the wrong sign, y - reference": law.next(v[k - 1], -e[k - 1]),
                "v and e exchanged": law.next(e[k - 1], v[k - 1]),
            }
            for words, slip in slips.items():
                if np.abs(slip - v[k]).max() <= EXPLAINS * off:
                    return (
                        f"v of trial {self.numbers[k]} is what the law makes of {words}"
                    )
            return None
        return None

    @property
    def following(self) -> np.ndarray | None:
        """The v to apply in the trial after the last one, shape (time, m)."""
        return None if self.law is None else self._after(-1)

    def _after(self, k):
        """The v that follows the trial `k` of the log by the law."""
        trial = self.trials.isel(trial=k)
        commands = {}
        if self.law.limits:
            commands = {name: signal[k] for name, signal in self._commands.items()}
        return self.law.next(trial.v.values, trial.e.values, **commands)

    @property
    def begun(self) -> bool:
        """Whether v of the first trial was given."""
        return BEGUN in self.trials.attrs

    @property
    def from_the_first(self) -> bool:
        """Whether all trials from the first on are there."""
        return self.numbers == list(range(1, len(self.numbers) + 1))

    @property
    def diverges(self) -> bool:
        """Whether the model without feedback runs away; an integrator does not."""
        model = self.loop.P if isinstance(self.loop, ClosedLoop) else self.loop.plant
        return model is not None and np.abs(model.poles()).max(initial=0) > 1 + 1e-9


def replay_of(trials: xr.Dataset, untold: Sequence[str] = ()) -> Replay:
    """Replay a log with the law and the loop that its metadata name.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`rodlib.load_log` or :func:`rodlib.record`.
    untold : sequence of str, optional
        Names of disturbances that the simulation shall not be told of.

    Warns
    -----
    UserWarning
        Each of the findings: trials that do not converge (`trials.diagnosis`), or that
        start elsewhere than the first.
    """
    arguments.instance("trials", trials, xr.Dataset)
    signals_of(trials, "reference", "v")  # which checks that it has all that a log has
    trials = trials.sortby("trial").transpose("trial", "time", ...)
    listed = isinstance(untold, Sequence) and not isinstance(untold, str)
    if not (listed and all(isinstance(name, str) for name in untold)):
        raise ValueError(f"untold = {reprlib.repr(untold)} must be a list of names")
    law, loop = law_of(trials), loop_of(trials)
    controlled = isinstance(loop, ClosedLoop) or "u" in trials
    if law is not None and law.limits and (loop is None or not controlled):
        law = None  # whose projection cannot be computed
    replay = Replay(trials, loop, law, tuple(untold))
    for finding in replay.findings:
        warnings.warn(finding, stacklevel=2)
    return replay
