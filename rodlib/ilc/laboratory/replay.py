"""What a log says of its experiment: was the law followed, is the model right, what comes next.

The law and the loop are those that the log itself names. Where it names none, what would need
them is left out, and the findings say so.
"""

import json
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.files import write_pieces
from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth, update
from rodlib.ilc.laboratory.notes import law_of, loop_of, rest_of, step_of
from rodlib.ilc.laboratory.saving import quoted, signals_of
from rodlib.ilc.laboratory.tables import few, rows
from rodlib.ilc.loop import CurrentTrialLoop
from rodlib.ilc.trials import rms, run_trials, state_sequence

AGREES = 1e-5  # of the largest v of an output: logs may hold few digits of it


@dataclass(frozen=True)
class Replay:
    """A log, and what its law and its loop make of it; None stands for what they are needed for.

    Attributes
    ----------
    trials : xarray.Dataset
        The log, its trials in the order of their numbers.
    loop : CurrentTrialLoop or None
    law : tuple of ZeroPhaseButterworth and LearningFilter (or None), or None
    rest : int
        Samples at the end of every trial in which v was held at zero.
    step : float
        Of the law, from each trial to the next.
    untold : tuple of str
        Disturbances that the simulation is not told of.
    """

    trials: xr.Dataset
    loop: CurrentTrialLoop | None
    law: tuple[ZeroPhaseButterworth, LearningFilter | None] | None
    rest: int
    step: float
    untold: tuple[str, ...]

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
        return self.trials.source.values.tolist() if "source" in self.trials.coords else []

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
        if self.loop is None or self.law is None or not self._from_the_first:
            return None
        told = [name not in self.untold for name in self.loop.disturbances]
        reference = self.trials.reference.transpose("trial", "time", "channel").values
        return run_trials(
            self.loop, *self.law, reference, self.disturbance * told, len(reference),
            rest=self.rest, step=self.step,
        )  # fmt: skip

    @cached_property
    def predicted(self) -> np.ndarray | None:
        """Outputs of the model under the recorded controls and disturbances, without feedback.

        Every trial begins with the model at zero. Shape (trial, time, m).
        """
        if self.loop is None or self._diverges:
            return None
        plant, m = self.loop.plant, len(self.outputs)
        signals = np.concatenate([self.trials.u.values, self.disturbance], axis=2)
        zero = np.zeros(plant.nstates)
        states = np.stack([state_sequence(plant.A, s @ plant.B.T, zero) for s in signals])
        return states @ plant.C.T + signals[..., m:] @ plant.D[:, m:].T

    @property
    def fit(self) -> pd.DataFrame | None:
        """1 - ||y - y-hat|| / ||y - mean y|| by trial and output: 1 is a perfect prediction."""
        if self.predicted is None:
            return None
        y = self.trials.y.values
        spread = np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1)
        missed = np.linalg.norm(y - self.predicted, axis=1)
        missed = np.divide(missed, spread, out=np.full_like(spread, np.nan), where=spread > 0)
        return pd.DataFrame(1 - missed, pd.Index(self.numbers, name="trial"), self.outputs)

    @cached_property
    def departure(self) -> pd.DataFrame | None:
        """How far the recorded v is from that of the law, at most, by trial and output.

        The law is applied to what was recorded of the trial before; NaN if that is not in the log.
        """
        if self.law is None:
            return None
        v, found = self.trials.v.values, {}
        for k, number in enumerate(self.numbers):
            if number == 1 or self.law[1] is None:
                expected = np.zeros_like(v[k])
            elif k and self.numbers[k - 1] == number - 1:
                expected = self._after(k - 1)
            else:
                expected = np.full_like(v[k], np.nan)
            found[number] = np.abs(v[k] - expected).max(axis=0)
        return pd.DataFrame.from_dict(found, "index", columns=self.outputs).rename_axis("trial")

    @property
    def following(self) -> np.ndarray | None:
        """The v to apply in the trial after the last one, shape (time, m)."""
        return None if self.law is None else self._after(-1)

    def _after(self, k):
        """The v that follows the trial `k` of the log by the law."""
        Q, L = self.law
        trial = self.trials.isel(trial=k)
        if L is None:
            return np.zeros_like(trial.v.values)
        return update(trial.v.values, trial.e.values, Q, L, self.rest, self.step)

    def save_following(self, path) -> None:
        """Write the next trial's v as a table; the file is replaced as a whole or not at all.

        Parameters
        ----------
        path : path-like
            CSV: the time in s, then a column for each output, as in a log. Lines that begin with
            ``#`` say which trial it is for, and the units.

        Raises
        ------
        ValueError
            If the log does not say which law made it.
        """
        path = arguments.path("path", path)
        if self.law is None:
            raise ValueError("the log does not say which law made it: there is no next trial")
        titles = [f"v_{name}" for name in self.outputs]
        units = dict(zip(titles, self.trials.output_unit.values.tolist(), strict=True))
        head = (
            f"# ILC signal v of trial {self.numbers[-1] + 1}, to be added to the reference\n"
            f"# units: {json.dumps({'time': 's'} | units, ensure_ascii=False)}\n"
            f"{','.join(['time', *map(quoted, titles)])}\n"
        )
        write_pieces(path, [head.encode(), rows((self.trials.time.values,), [self.following])])

    @property
    def about_the_law(self) -> str:
        """Whether the recorded v is that of the law, in a sentence."""
        if self.law is None:
            return "the log does not say which law made it"
        largest = np.abs(self.trials.v.values).max(axis=(0, 1))
        wrong = self.departure > AGREES * largest
        if wrong.to_numpy().any():
            number, name = wrong.stack().idxmax()
            unit = self.trials.output_unit.values[self.outputs.index(name)]
            amount = f"{self.departure.loc[number, name]:.1e} {unit}".strip()
            return f"v departs from the law from trial {number} on, by {amount} in {name}"
        unknown = self.departure.index[self.departure.isna().all(axis=1)].tolist()
        if unknown:
            which = ", ".join(few([str(number) for number in unknown]))
            return f"the recorded v is that of the law, as far as the trials before {which} tell"
        return "the recorded v is that of the law in every trial"

    @property
    def left_out(self) -> list[str]:
        """What was left out, and why."""
        reasons = []
        if self.law is None:
            reasons.append(
                "law check, next trial and simulation: the log does not say which law made it; "
                "its metadata need Q and L"
            )
        if self.loop is None:
            reasons.append(
                "simulation and prediction: the log does not say which loop made it; its metadata "
                "need loop"
            )
            return reasons
        if not self._from_the_first:
            reasons.append(f"simulation: not all trials from 1 on are there, but {self.numbers}")
        if self._diverges:
            reasons.append("prediction: without feedback the model is unstable")
        unknown = [name for name in self.sources if name not in self.loop.disturbances]
        if unknown:
            reasons.append(f"disturbances {unknown}: the model does not know them")
        if told := [name for name in self.sources if name in self.untold]:
            reasons.append(f"disturbances {told}: the simulation is not told of them")
        return reasons

    @property
    def _from_the_first(self):
        return self.numbers == list(range(1, len(self.numbers) + 1))

    @property
    def _diverges(self):
        return np.abs(self.loop.plant.poles()).max() > 1 + 1e-9  # an integrator does not

    def __str__(self) -> str:
        table = rms_by_trial(self.trials.e)
        if self.simulated is not None:
            simulated = rms_by_trial(self.simulated.e).add_suffix(", simulation")
            table = pd.concat([table.add_suffix(", log"), simulated], axis=1)
        lines = [
            f"{len(self.numbers)} trials of {self.trials.sizes['time']} samples, Ts = "
            f"{self.trials.attrs['Ts']:g} s",
            f"law: {self.about_the_law}",
            f"RMS of the error:\n{table.to_string(float_format='{:.3g}'.format)}",
        ]
        if self.fit is not None:
            mean = (100 * self.fit.mean()).round(1)
            fits = ", ".join(f"{name} {value:g} %" for name, value in mean.items())
            lines.append(f"fit of the model's prediction, mean of all trials: {fits}")
        return "\n".join([*lines, *(f"left out: {reason}" for reason in self.left_out)])


def replay_of(
    trials: xr.Dataset, loop: CurrentTrialLoop | None = None, untold: Sequence[str] = ()
) -> Replay:
    """Replay a log with the law and the loop that its metadata name.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`rodlib.load_log` or :func:`rodlib.record`.
    loop : CurrentTrialLoop, optional
        For a log that does not say which it was. Its channels are those of the log in their order.
    untold : sequence of str, optional
        Names of disturbances that the simulation shall not be told of.

    Returns
    -------
    Replay

    Raises
    ------
    LogError
        If the law or the loop is noted, but cannot be understood.
    ValueError
        If `loop` has another number of channels or another sampling period than the log.
    """
    arguments.instance("trials", trials, xr.Dataset)
    signals_of(trials)  # which checks that it has all that a log has
    trials = trials.sortby("trial").transpose("trial", "time", ...)
    if loop is not None:
        arguments.instance("loop", loop, CurrentTrialLoop)
    listed = isinstance(untold, Sequence) and not isinstance(untold, str)
    if not (listed and all(isinstance(name, str) for name in untold)):
        raise ValueError(f"untold = {reprlib.repr(untold)} must be a list of names")
    noted = loop_of(trials)
    if noted is None and loop is not None:
        arguments.one_period(log=trials.attrs["Ts"], loop=loop.Ts)
        if len(loop.outputs) != trials.sizes["channel"]:
            raise ValueError(
                f"loop has the outputs {loop.outputs}, but the log {trials.output.values.tolist()}"
            )
    return Replay(
        trials, noted or loop, law_of(trials), rest_of(trials), step_of(trials), tuple(untold)
    )


def by_unit(units: Sequence[str]) -> dict[str, list[int]]:
    """Channels whose signals have the same unit, and so can stand in one sum or picture."""
    return {unit: [i for i, other in enumerate(units) if other == unit] for unit in units}


def with_unit(text: str, unit: str) -> str:
    """A label with its unit behind it, if there is one."""
    return f"{text} ({unit})" if unit else text


def rms_by_trial(e: xr.DataArray) -> pd.DataFrame:
    """RMS(e_k), :func:`rodlib.ilc.trials.rms`, by trial; a column for each unit of the outputs."""
    groups, columns = by_unit(e.output_unit.values.tolist()), {}
    for unit, channels in groups.items():
        names = "" if len(groups) == 1 else f" of {', '.join(e.output.values[channels])}"
        columns[with_unit(f"RMS{names}", unit)] = rms(e.isel(channel=channels)).values
    return pd.DataFrame(columns, pd.Index(e.trial.values, name="trial"))
