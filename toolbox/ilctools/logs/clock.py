"""The clock of a table: check that trials are complete, equally long and sampled on time.

A table has the columns trial and time (s) and is indexed by the rows of the file. Clocks jitter.
Therefore each step may differ from Ts by a tolerance. The mean step may differ from Ts by a smaller
tolerance.
"""

import re

import pandas as pd

from ilctools.errors import LogError

NOTED_JITTER = 1e-3  # fraction of Ts; smaller jitter is not noted in the log
JITTER = 0.1  # fraction of Ts by which a step of the clock may differ from Ts
DRIFT = 0.01  # fraction of Ts by which the mean step may differ from Ts
ROUNDED_STEP = 2e-3  # fraction of the mean step by which rounding may change the mean step
# In s. Clocks count from 1970, from 1904, or from the start of a program: 1e11 s is the year 5138.
LATEST_START = 1e11


def steps_of(table: pd.DataFrame) -> pd.Series:
    """Return the steps of the clock within trials, indexed by the row in which a step ends."""
    return table["time"].diff()[table["trial"].diff() == 0]


def mean_step(table: pd.DataFrame) -> float:
    """Return the mean step, rounded as far as the scatter of the steps permits.

    If there are no steps, the result is NaN.
    """
    steps = steps_of(table)
    mean = float(steps.mean())
    slack = min(steps.max() - steps.min(), ROUNDED_STEP * mean)
    rounded = (float(f"{mean:.{digits}e}") for digits in range(12))
    return next((Ts for Ts in rounded if abs(Ts - mean) <= slack), mean)


def seconds(unit: str) -> float:
    """Return the length of a unit of time, in s; raise a ValueError for any other unit."""
    unit = re.sub("secs?$", "s", unit.replace("\u03bc", "\u00b5"))  # pandas knows one mu
    return pd.Timedelta(1, unit).total_seconds()


def check_start(start: float, second: float) -> None:
    """Refuse a clock that begins later than any clock does, because its unit must be wrong.

    Both arguments are in s: `start` is the first time of the clock, and `second` is the length of
    the unit in which the clock was read.
    """
    if abs(start) > LATEST_START:
        raise LogError(
            f"time: the clock begins at {start / second:.13g}, or {start:.3g} s, which is too "
            f"late for a clock in s: state its unit, as units={{'time': 'ms'}} if it counts ms "
            "since 1970, or subtract its first entry"
        )


def check_trials(table: pd.DataFrame, Ts: float) -> dict[str, str]:
    """Check trials and their clock; return a note on jitter, or raise a LogError."""
    trial, steps = table["trial"], steps_of(table)
    starts = trial.diff() != 0
    _refuse(
        trial[starts & trial.duplicated() | ~trial.between(1, 2**31) | (trial % 1 != 0)],
        "trial: {value:g} in row {row} must be a whole number, 1 or more, and the rows of a "
        "trial must follow each other",
    )
    _refuse(
        table["time"][starts & (table["time"].abs() > JITTER * Ts)],
        "time: {value:.9g} in row {row} must be 0, because a trial begins in this row",
    )
    _refuse(
        steps[(steps - Ts).abs() > JITTER * Ts],
        f"time: row {{row}} is {{value:.6g}} s after the row before, but Ts = {Ts:.6g} s "
        f"({{count}} of {len(steps)} steps differ): is Ts right, and is the clock in s? For "
        "another unit, pass read_table(..., units={{'time': 'min'}}). Sort the rows, remove "
        "copies, give each trial its own number, and interpolate samples that are lost or late",
    )
    lengths = trial.value_counts(sort=False)
    if lengths.nunique() > 1:
        raise LogError(
            f"trials must be equally long, but trial {lengths.idxmin():g} has {lengths.min()} "
            f"samples and trial {lengths.idxmax():g} has {lengths.max()}"
        )
    # jitter at the ends of trials
    slack = DRIFT + JITTER * starts.sum() / max(len(steps), 1)
    if abs(steps.mean() - Ts) > slack * Ts:
        raise LogError(
            f"time: the mean step is {steps.mean():.6g} s, but Ts = {Ts:.6g} s: state the mean "
            "step as Ts"
        )
    if steps.empty or (steps - Ts).abs().max() <= NOTED_JITTER * Ts:
        return {}
    return {
        "clock": f"the steps are from {steps.min():.4g} to {steps.max():.4g} s, with median "
        f"{steps.median():.4g} s, where Ts = {Ts:.6g} s; no sample is lost"
    }


def _refuse(wrong, message):
    """Refuse wrong values; the error names the first wrong value and its row."""
    if len(wrong):
        row, value = wrong.index[0], wrong.iloc[0]
        raise LogError(message.format(row=row, value=value, count=len(wrong)))
