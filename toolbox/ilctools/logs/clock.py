"""Trials in a table: numbered, in one piece, equally long, in time; and resampling.

A table has the columns trial and time (s) and is indexed by the rows of the file. Clocks jitter, so
each step is compared with Ts, and so is their mean.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ilctools.loop.notes import LogError

EXACT = 1e-3  # of Ts: jitter that is not worth a note
JITTER = 0.1  # of Ts: by which a step of the clock may differ
DRIFT = 0.01  # of Ts: by which the mean step may differ
ROUNDING = 2e-3  # of the mean step: by which rounding may change it
MISSING = 0.5  # of all samples: that may be filled in


def steps_of(table: pd.DataFrame) -> pd.Series:
    """The steps of the clock within trials, by the row that each ends in."""
    return table["time"].diff()[table["trial"].diff() == 0]


def period_of(table: pd.DataFrame) -> float:
    """The mean step of a clock, lost rows apart, rounded as far as its steps scatter."""
    steps = steps_of(table)
    steps = steps[steps > 0]
    if steps.empty:
        raise LogError("time: the clock stands still, or there is one row: state Ts")
    mean = steps.sum() / np.round(steps / steps.median()).sum()
    slack = min(np.ptp(steps), ROUNDING * mean)
    rounded = (float(f"{mean:.{digits}e}") for digits in range(12))
    return next((Ts for Ts in rounded if abs(Ts - mean) <= slack), mean)


def check_trials(table: pd.DataFrame, Ts: float) -> None:
    """A LogError, with its row, for trials that are not whole, alike and in time."""
    trial = table["trial"]
    wrong = trial[~trial.between(1, 2**31) | (trial % 1 != 0)]
    if len(wrong):
        raise LogError(
            f"trial: {wrong.iloc[0]:g} in row {wrong.index[0]} must be a whole number, 1 or more"
        )
    starts = table[trial.diff() != 0]
    again = starts[starts["trial"].duplicated()]
    if len(again):
        raise LogError(
            f"trial: {again['trial'].iloc[0]:g} goes on in row {again.index[0]}: the rows of a "
            "trial must stand together"
        )
    late = starts[starts["time"].abs() > JITTER * Ts]
    if len(late):
        raise LogError(
            f"time: {late['time'].iloc[0]:.9g} in row {late.index[0]}, where a trial begins, must "
            "be 0"
        )
    steps = steps_of(table)
    back = steps[steps <= 0]
    if len(back):
        raise LogError(
            f"time: row {back.index[0]} is not later than the row before: sort the rows, remove "
            "copies, or give each trial a number"
        )
    wrong = steps[(steps - Ts).abs() > JITTER * Ts]
    if len(wrong) == len(steps) > 0:
        raise LogError(
            f"time: all steps differ from Ts = {Ts:.6g} s, and their median is "
            f"{steps.median():.6g} s: which is right, and is the clock in s?"
        )
    if len(wrong):
        raise LogError(
            f"time: row {wrong.index[0]} is {wrong.iloc[0]:.6g} s after the row before, where Ts "
            f"= {Ts:.6g} s ({len(wrong)} such steps): rows are lost or late; resample=True "
            "interpolates"
        )
    lengths = trial.value_counts(sort=False)
    if lengths.nunique() > 1:
        raise LogError(
            f"trials must be equally long, but trial {lengths.idxmin():g} has {lengths.min()} "
            f"samples and trial {lengths.idxmax():g} has {lengths.max()}"
        )
    # jitter at the ends of trials
    slack = DRIFT + JITTER * len(starts) / max(len(steps), 1)
    if abs(steps.mean() - Ts) > slack * Ts:
        raise LogError(
            f"time: the mean step is {steps.mean():.6g} s, but Ts = {Ts:.6g} s: state that as Ts, "
            "or resample=True interpolates"
        )


def jitter(table: pd.DataFrame, Ts: float) -> dict[str, str]:
    """A note on a clock that is not as exact as a computed one."""
    steps = steps_of(table)
    if steps.empty or (steps - Ts).abs().max() <= EXACT * Ts:
        return {}
    return {
        "clock": f"steps from {steps.min():.4g} to {steps.max():.4g} s, median "
        f"{steps.median():.4g}, where Ts = {Ts:.6g}; no sample is lost"
    }


def resampled(
    table: pd.DataFrame, Ts: float, between: Sequence[str]
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Rows Ts apart from the first one of each trial, and a note on what was done.

    The columns `between` are interpolated linearly. Others are held, as a command is: the value
    in the middle of a sample counts. A table that cannot be resampled stays as it is.
    """
    steps = steps_of(table)
    exact = steps.empty or (steps - Ts).abs().max() <= EXACT * Ts
    if exact or steps.min() <= 0:
        return table, {}
    trials = [trial for _, trial in table.groupby("trial", sort=False)]
    counts = [int(np.ptp(trial["time"]) / Ts + JITTER) + 1 for trial in trials]
    count = min(counts)  # one trial may be a sample longer than another
    if max(counts) > count + 1 or MISSING * sum(counts) > len(table):
        return table, {}
    pieces = []
    for trial in trials:
        time = trial["time"].to_numpy()
        grid = time[0] + Ts * np.arange(count)
        piece = trial.iloc[np.searchsorted(time, grid + Ts / 2, "right") - 1].copy()
        for title in between:
            piece[title] = np.interp(grid, time, trial[title])
        piece["time"] = grid
        pieces.append(piece)
    note = (
        f"{len(table)} rows were resampled to {count * len(trials)} samples; the longest step is "
        f"{steps.max():.4g} s where Ts = {Ts:.6g} s"
    )
    return pd.concat(pieces), {"resampled": note}
