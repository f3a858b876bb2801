"""Replay of a log with its law and its loop: does the recorded v follow from the law?

The law and the loop are taken from the metadata of the log. If they are missing, the results that
need them are left out, and the reason is printed.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.law.notes import BEGUN, BETWEEN, RESET, law_of, loop_of
from ilctools.law.output_step import Step
from ilctools.logs.format import signals_of
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.signals import points_of, with_points
from ilctools.trials.diagnosis import diagnose
from ilctools.trials.learn import BETWEEN_TRIALS, next_step, next_v
from ilctools.trials.parts import from_rest_to_rest, parts_of
from ilctools.trials.points import asking
from ilctools.trials.rms import rms
from ilctools.trials.run import run_trials
from ilctools.units import by_unit, with_unit
from ilctools.warn import warn

UNSTABLE_POLE = 1 + 1e-9  # larger moduli are unstable; an integrator has 1, with rounding
DIGITS = 1e-5  # tolerance relative to the largest v, because logs may hold few digits of v


@dataclass(frozen=True)
class Replay:
    """A log, compared with its law and with the model of its loop.

    :func:`replay` makes a Replay; print it to see all results. A result is None if it needs a law
    or a loop that the log does not name.
    """

    trials: xr.Dataset  # in the order of their numbers
    loop: Loop | None
    law: Law | None
    resets: bool  # whether every trial starts from the same state

    @property
    def between(self) -> str:
        """What computes v if the reference changes: the law or :func:`ilctools.transfer`."""
        return self.trials.attrs.get(BETWEEN, BETWEEN_TRIALS[0])

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return self.trials.output.values.tolist()

    @property
    def inputs(self) -> list[str]:
        """Names of the channels of v."""
        return self.trials["input" if "input" in self.trials.coords else "output"].values.tolist()

    @property
    def numbers(self) -> list[int]:
        """Numbers of the trials."""
        return self.trials.trial.values.tolist()

    @property
    def model(self) -> control.StateSpace | None:
        """The model that the commands drive.

        For a ClosedLoop, this is P with the input w. For the current-trial loop, this is the plant.
        """
        if self.loop is None:
            return None
        return self.loop.P if isinstance(self.loop, ClosedLoop) else self.loop.plant

    @cached_property
    def disturbance(self) -> np.ndarray:
        """The disturbances of the loop, shape (trial, time, d).

        If a disturbance was not recorded, it is zero.
        """
        names = self.loop.disturbances
        if "disturbance" not in self.trials:
            return np.zeros((*self.trials.e.shape[:2], len(names)))
        return self.trials.disturbance.reindex(source=names, fill_value=0.0).values

    @cached_property
    def simulated(self) -> xr.Dataset | None:
        """The trials, simulated on the model with the same law, references and disturbances."""
        complete = self.numbers == [*range(1, len(self.numbers) + 1)]
        if self.law is None or self.model is None or not complete:
            return None
        with warnings.catch_warnings(action="ignore"):  # only warnings about the log itself count
            return run_trials(
                self.loop,
                self.law,
                self.trials.reference.values,
                None if isinstance(self.loop, ClosedLoop) else self.disturbance,
                trials=len(self.numbers),
                v=self.trials.v.values[0],
                reset=self.resets,
                between=self.between,
            )

    @cached_property
    def predicted(self) -> np.ndarray | None:
        """Outputs that the model, starting from rest, predicts from the recorded inputs.

        The prediction uses no recorded outputs. The result is None if the model is unstable. An
        integrator counts as stable.
        """
        if self.model is None or np.abs(self.model.poles()).max(initial=0) > UNSTABLE_POLE:
            return None
        if self.loop.asked(self.trials) is None:
            return None
        known = self.trials.assign(disturbance=(("trial", "time", "known"), self.disturbance))
        outputs = []
        for part in from_rest_to_rest(known):
            applied = part.get("applied", self.loop.asked(part))
            if self.law and self.law.actuators:
                applied = self.law.actuators.follow(applied)
            inputs = np.hstack([applied, part["disturbance"]]).T[: self.model.ninputs]
            outputs.append(control.forced_response(self.model, inputs=inputs, squeeze=False).y.T)
        return np.reshape(outputs, known.y.shape)

    @property
    def fit(self) -> pd.DataFrame | None:
        """The fit of the model, by trial and output.

        The fit is 1 - ||y - y-hat|| / ||y - mean y||, where y-hat is the predicted output. If the
        prediction is perfect, the fit is 1. If the fit is below a half, the loop is probably wrong
        for this log, or a signal that acts on the output was not recorded.
        """
        if self.predicted is None:
            return None
        y = self.trials.y.values
        error = np.linalg.norm(y - self.predicted, axis=1)
        size = np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1)
        return self._by_trial(1 - error / np.where(size > 0, size, np.nan))

    @cached_property
    def expected(self) -> list[tuple[np.ndarray, Step | None]] | None:
        """The v of each trial as the law computes it, and the step that keeps limits of outputs.

        If the trial before is missing, the v is NaN. The result is None if there is no law, or no
        reset between trials.
        """
        if self.law is None or not self.resets:
            return None
        parts = parts_of(self.trials)
        zero = np.zeros_like(parts[0]["v"])
        unknown = zero + np.nan
        begun = self.numbers[0] > 1 or BEGUN in self.trials.attrs
        expected = [(unknown if begun else zero, None)]
        for k, step in enumerate(np.diff(self.numbers), start=1):
            if step > 1:
                expected.append((unknown, None))
            else:
                upcoming = parts[k]["reference"]
                expected.append(next_step(self.law, self.between, parts[:k], upcoming))
        return expected

    @property
    def departure(self) -> pd.DataFrame | None:
        """Largest distance between the recorded v and the v of the law, by trial and channel.

        If the trial before is missing, the distance is NaN. The result is None if there is no law,
        or no reset between trials.
        """
        if self.expected is None:
            return None
        expected = np.array([v for v, _ in self.expected])
        return self._by_trial(np.abs(self.trials.v.values - expected).max(axis=1), self.inputs)

    @property
    def kept(self) -> pd.DataFrame | None:
        """Distance of limited outputs from their limits, and the share alpha, by trial.

        The share alpha is the part of the law's own change of v that the limits allowed before the
        trial. A negative distance means that the output exceeded a limit. The result is None
        without limits of outputs.
        """
        if self.expected is None or self.law.output_limits is None:
            return None
        limits = self.law.output_limits
        distance = [limits.distance(y) for y in self.trials.y.values]
        table = self._by_trial(distance)[[*limits.limits]]
        alpha = [np.nan if step is None else step.alpha for _, step in self.expected]
        return table.add_suffix(" to its limit").assign(alpha=alpha)

    def _by_trial(self, values, names=None):
        """Make a table of values (trial, output); `names` are the names of other channels."""
        return pd.DataFrame(values, pd.Index(self.numbers, name="trial"), names or self.outputs)

    @property
    def following(self) -> np.ndarray | None:
        """The v to apply in the trial after the last one, shape (time, m).

        Without reset, only the first samples are returned, as far as the recorded trials determine
        v.
        """
        if self.law is None:
            return None
        v, parts = self.trials.v.values[-1], parts_of(self.trials)
        return next_v(self.law, v, self.resets, self.between, parts)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of :func:`.diagnose` about the convergence of the trials."""
        if self.law is None or np.any(np.diff(self.numbers) > 1):
            return ()
        return tuple(diagnose(self.trials, self.law).values())

    @property
    def rms(self) -> pd.DataFrame:
        """RMS(e_k) by trial, in the log and in the simulation.

        The tables have a column for each unit of the outputs.
        """
        table = rms_by_trial(self.trials.e)
        if self.simulated is None:
            return table
        simulated = rms_by_trial(self.simulated.e).add_suffix(", simulation")
        return pd.concat([table.add_suffix(", log"), simulated], axis=1)

    @property
    def agreement(self) -> str:
        """A sentence on whether the recorded v agrees with the law."""
        if self.law is None:
            return "the log does not name its law (Q and L, and with limits also the loop)"
        if not self.resets:
            return "the recorded v is not checked, because the trials have no reset between them"
        departure = self.departure
        rounding = DIGITS * np.maximum.accumulate(np.abs(self.trials.v.values).max(axis=1))
        different = (departure > rounding).stack()
        if different.any():
            number, name = different.idxmax()
            units = self.trials["input_unit" if "input" in self.trials.coords else "output_unit"]
            unit = units.values[self.inputs.index(name)]
            amount = f"{departure.loc[number, name]:.1e} {unit}".strip()
            return (
                f"the recorded v differs from the law from trial {number} on, by {amount} in {name}"
            )
        unchecked = departure.index[departure.isna().all(axis=1)].tolist()
        where = (
            f"except in trials {unchecked}, which have no trial before them"
            if unchecked
            else "in every trial"
        )
        return f"the recorded v agrees with the law {where}"

    @property
    def omissions(self) -> list[str]:
        """The results that are left out, each with its reason."""
        reasons = []
        if self.simulated is None:
            reasons.append(
                "simulation: it needs the law, a loop whose P is in the log, and all trials "
                f"from 1 on; the log has trials {self.numbers}"
            )
        if self.predicted is None:
            reasons.append(
                "prediction: it needs u, and a loop whose model is stable without feedback"
            )
        recorded = np.ravel(self.trials.coords.get("source", [])).tolist()
        if ignored := sorted({*recorded} - {*getattr(self.loop, "disturbances", recorded)}):
            reasons.append(f"disturbances {ignored}: the simulation does not include them")
        return reasons

    def __repr__(self):
        lines = [
            f"{len(self.numbers)} trials of {self.trials.sizes['time']} samples, Ts = "
            f"{self.trials.attrs['Ts']:g} s",
            f"law: {self.agreement}",
            f"RMS of the error:\n{self.rms.to_string(float_format='{:.3g}'.format)}",
        ]
        if self.kept is not None:
            table = self.kept.to_string(float_format="{:.3g}".format)
            lines.append(
                "distance of the outputs from their limits, and alpha, the share of the law's own "
                f"change of v that was applied:\n{table}"
            )
        if self.fit is not None:
            mean = (100 * self.fit.mean()).round(1)
            fits = ", ".join(f"{name} {value:g} %" for name, value in mean.items())
            lines.append(f"fit of the prediction by the model, mean of all trials: {fits}")
        lines += [f"WARNING: {text}" for text in self.warnings]
        return "\n".join([*lines, *(f"left out: {text}" for text in self.omissions)])


def rms_by_trial(e: xr.DataArray) -> pd.DataFrame:
    """Tabulate RMS(e_k) by trial, with a column for each unit of the outputs.

    The RMS is defined in :func:`ilctools.rms`.
    """
    groups, columns = by_unit(e.output_unit.values.tolist()), {}
    for unit, channels in groups.items():
        names = f" of {', '.join(e.output.values[channels])}" if len(groups) > 1 else ""
        columns[with_unit(f"RMS{names}", unit)] = rms(e.isel(channel=channels)).values
    return pd.DataFrame(columns, pd.Index(e.trial.values, name="trial"))


def replay(trials: xr.Dataset) -> Replay:
    """Replay a log with the law and the loop that its metadata name.

    Parameters
    ----------
    trials : xarray.Dataset
        A log from :func:`ilctools.load_log` or :func:`ilctools.record`. The error is taken as
        reference - y.

    Returns
    -------
    Replay

    Warns
    -----
    UserWarning
        If the trials do not converge as predicted, see :mod:`ilctools.trials.diagnosis`.

    See Also
    --------
    load_log : loads a log
    run_trials : simulates trials

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, Law, LearningFilter, record, replay, zero_phase_butterworth
    >>> class Axis:  # simulated; yours talks to the drive
    ...     x = 0.0
    ...     def begin(self, trial):
    ...         self.x = 0.0
    ...     def read(self):
    ...         return [self.x]
    ...     def apply(self, w):
    ...         self.x += 0.2 * (w[0] - self.x)
    ...
    >>> loop = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
    >>> Q = zero_phase_butterworth(2, 60.0, loop.Ts)
    >>> law = Law(Q, LearningFilter([[[0.9]]], loop.Ts))
    >>> run = record(Axis(), loop, law, np.sin(np.arange(200) * np.pi / 200) ** 2, trials=6)
    >>> print(str(replay(run)).splitlines()[0])
    6 trials of 200 samples, Ts = 0.01 s
    """
    arguments.instance("trials", trials, xr.Dataset)
    signals_of(trials, "reference", "v")  # checks that all signals of a log are there
    trials = trials.sortby("trial").transpose("trial", "time", ...)
    error, points = trials.reference - trials.y, points_of(trials)
    trials = with_points(trials.assign(e=error.assign_attrs(trials.y.attrs)), points)
    law, loop = law_of(trials), loop_of(trials)
    if points is not None and law is not None:
        law = asking(law, points)
    if law is not None and law.known_limits and (loop is None or loop.asked(trials) is None):
        law = None  # because its projection cannot be computed
    result = Replay(trials, loop, law, resets=RESET not in trials.attrs)
    for text in result.warnings:
        warn(text)
    return result
