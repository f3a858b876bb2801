"""What a replay shows, in words and as tables."""

import json

import numpy as np
import pandas as pd
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.files import write_pieces
from rodlib.ilc.logs.tables import few, quoted, rows
from rodlib.ilc.replay import Replay
from rodlib.ilc.trials.run import rms
from rodlib.ilc.units import by_unit

HEARD = 0.01  # of the error in the loudest octave: less is not worth a line
AGREES = 1e-5  # of the largest v of an output: logs may hold few digits of it


def about_the_law(replay: Replay) -> str:
    """Whether the recorded v is that of the law, in a sentence."""
    if replay.law is None:
        return "the log does not say which law made it"
    trials, departure = replay.trials, replay.departure
    largest = np.abs(trials.v.values).max(axis=(0, 1))
    wrong = departure > AGREES * largest
    if wrong.to_numpy().any():
        number, name = wrong.stack().idxmax()
        unit = trials.output_unit.values[replay.outputs.index(name)]
        amount = f"{departure.loc[number, name]:.1e} {unit}".strip()
        return f"v departs from the law from trial {number} on, by {amount} in {name}"
    unknown = departure.index[departure.isna().all(axis=1)].tolist()
    if unknown:
        which = ", ".join(few([str(number) for number in unknown]))
        return f"the recorded v is that of the law, as far as the trials before {which} tell"
    return "the recorded v is that of the law in every trial"


def left_out(replay: Replay) -> list[str]:
    """What was left out, and why."""
    reasons = []
    if replay.law is None:
        reasons.append(
            "law check, next trial and simulation: the log does not say which law made it; its "
            "metadata need Q and L, and the loop beside actuators"
        )
    if replay.loop is None:
        reasons.append(
            "simulation and prediction: the log does not say which loop made it; its metadata need "
            "loop"
        )
        return reasons
    if replay.loop.P is None:
        reasons.append("simulation and prediction: the loop has no P")
    if not replay.from_the_first:
        reasons.append(
            f"simulation: not all trials from 1 on are there, but {replay.numbers}"
        )
    if replay.diverges:
        reasons.append("prediction: without feedback the model is unstable")
    unknown = [name for name in replay.sources if name not in replay.loop.disturbances]
    if unknown:
        reasons.append(f"disturbances {unknown}: the model does not know them")
    if told := [name for name in replay.sources if name in replay.untold]:
        reasons.append(f"disturbances {told}: the simulation is not told of them")
    return reasons


def summary(replay: Replay) -> str:
    """All that a replay shows, as lines to print."""
    trials = replay.trials
    table = rms_by_trial(trials.e)
    if replay.simulated is not None:
        simulated = rms_by_trial(replay.simulated.e).add_suffix(", simulation")
        table = pd.concat([table.add_suffix(", log"), simulated], axis=1)
    lines = [
        f"{len(replay.numbers)} trials of {trials.sizes['time']} samples, Ts = "
        f"{trials.attrs['Ts']:g} s",
        f"law: {about_the_law(replay)}",
        f"RMS of the error:\n{table.to_string(float_format='{:.3g}'.format)}",
    ]
    if replay.fit is not None:
        mean = (100 * replay.fit.mean()).round(1)
        fits = ", ".join(f"{name} {value:g} %" for name, value in mean.items())
        lines.append(f"fit of the model's prediction, mean of all trials: {fits}")
    if (rates := replay.reached(replay.numbers[0] + 1)) is not None:
        rates = rates[rates.before > HEARD * rates.before.max()].drop(columns="before")
        lines.append(
            "share of the error left by the first of the trials to the next, by octaves in rad/s:\n"
            f"{rates.to_string(float_format='{:.2g}'.format)}"
        )
    lines += [
        f"{key}: {trials.attrs[key]}"
        for key in ("clock", "resampled")
        if key in trials.attrs
    ]
    lines += [f"WARNING: {finding}" for finding in replay.findings]
    return "\n".join([*lines, *(f"left out: {reason}" for reason in left_out(replay))])


def save_following(replay: Replay, path) -> None:
    """Write the next trial's v as a table, the time in s and a column for each output."""
    path = arguments.path("path", path)
    if replay.law is None:
        raise ValueError(
            "the log does not say which law made it: there is no next trial"
        )
    titles = [f"v_{name}" for name in replay.outputs]
    units = dict(zip(titles, replay.trials.output_unit.values.tolist(), strict=True))
    head = (
        f"# ILC signal v of trial {replay.numbers[-1] + 1}, to be added to the reference\n"
        f"# units: {json.dumps({'time': 's'} | units, ensure_ascii=False)}\n"
        f"{','.join(['time', *map(quoted, titles)])}\n"
    )
    write_pieces(
        path, [head.encode(), rows([replay.trials.time.values, *replay.following.T])]
    )


def with_unit(text: str, unit: str) -> str:
    """A label with its unit behind it, if there is one."""
    return f"{text} ({unit})" if unit else text


def rms_by_trial(e: xr.DataArray) -> pd.DataFrame:
    """RMS(e_k), :func:`rodlib.ilc.rms`, by trial; a column for each unit of the outputs."""
    groups, columns = by_unit(e.output_unit.values.tolist()), {}
    for unit, channels in groups.items():
        names = (
            "" if len(groups) == 1 else f" of {', '.join(e.output.values[channels])}"
        )
        columns[with_unit(f"RMS{names}", unit)] = rms(e.isel(channel=channels)).values
    return pd.DataFrame(columns, pd.Index(e.trial.values, name="trial"))
