"""Whether rows are trials: numbered, in one piece, equally long, in time; and resampling.

A trial is a sequence of samples, and what a clock shows is how far they were apart. So each step of
the clock is judged by itself, and their mean: what adds up over a trial is no fault of a sample.
"""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc.logs.tables import Table, few

SLACK = 1e-3  # sampling periods that a time may be off without a word
SHARE = 0.1  # by which a step of a clock may differ from the sampling period
ROUND = 2e-3  # of a sampling period that nobody stated, within the scatter of the steps
DRIFT = 0.01  # by which the mean of its steps may
MOST = 0.5  # of all samples that may be filled in


def off(time, Ts) -> np.ndarray:
    """Which times of a trial are not 0, Ts, 2 Ts, ... up to a thousandth of a period."""
    with np.errstate(over="ignore"):
        late = np.abs(time - Ts * np.arange(len(time)))
        return ~(late <= SLACK * Ts + 1e-12 * np.abs(time))


def starts_of(numbers) -> np.ndarray:
    """The rows where a trial begins, from the number of the trial in each row."""
    return np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])


def period_of(table: Table) -> float | None:
    """The mean step of a clock, rounded as far as its steps scatter; None if it stands still."""
    steps = _steps(table)[0]
    steps = steps[steps > 0]
    if not steps.size:
        return None
    mean = steps.sum() / max(
        np.round(steps / np.median(steps)).sum(), 1
    )  # over rows that are lost
    rounded = (float(f"{mean:.{digits}e}") for digits in range(12))
    low, high = (
        max(steps.min(), (1 - ROUND) * mean),
        min(steps.max(), (1 + ROUND) * mean),
    )
    return next((Ts for Ts in rounded if low <= Ts <= high), mean)


def _steps(table):
    """The steps of the clock within trials, and the rows that they end in."""
    rows = np.flatnonzero(np.diff(table.column("trial")) == 0) + 1
    with np.errstate(over="ignore"):
        return table.column("time")[rows] - table.column("time")[rows - 1], rows


def check_trials(
    table: Table, Ts: float, anywhere: bool = False
) -> tuple[np.ndarray, list[str]]:
    """Numbers of the trials, and problems; Ts in the table's unit, `anywhere` their first times."""
    problems, time = [], table.column("time")
    starts = starts_of(table.column("trial"))
    numbers, lengths = table.column("trial")[starts], np.diff([*starts, len(time)])
    odd = np.flatnonzero(
        (numbers < 1) | (numbers != np.round(numbers)) | (numbers > 2**31)
    )
    if odd.size:
        row = table.lines[starts[odd[0]]]
        problems.append(
            f"trial: {numbers[odd[0]]:g} in row {row} is no whole number, 1 or more"
        )
    known, first = np.unique(numbers, return_index=True)
    if len(known) < len(numbers):
        again = np.setdiff1d(np.arange(len(numbers)), first)[0]
        problems.append(
            f"trial: {numbers[again]:g} goes on in row {table.lines[starts[again]]}, after trial "
            f"{numbers[again - 1]:g}: the rows of a trial must stand together"
        )
        return numbers, problems
    if len(set(lengths)) > 1:
        groups = []
        for length in np.unique(lengths):
            which = ", ".join(few([f"{k:g}" for k in numbers[lengths == length]]))
            groups.append(f"{length} samples in trial {which}")
        problems.append(f"trials have different lengths: {'; '.join(few(groups))}")
    late = [] if anywhere else np.flatnonzero(np.abs(time[starts]) > SHARE * Ts)
    problems += [
        f"time: trial {numbers[k]:g}, in row {table.lines[starts[k]]}, begins at "
        f"{time[starts[k]]:.9g}, not at 0"
        for k in late
    ]
    return numbers, problems + _problems_of_clock(table, Ts)


def _problems_of_clock(table, Ts):
    steps, rows = _steps(table)
    wrong = np.flatnonzero(~(np.abs(steps - Ts) <= SHARE * Ts + 1e-12 * np.abs(steps)))
    back = wrong[steps[wrong] <= 0]
    if wrong.size:
        p = back[0] if back.size else wrong[0]
        count = f" ({wrong.size} such steps)" if wrong.size > 1 else ""
        where = f"time: row {table.lines[rows[p]]} of trial {table.column('trial')[rows[p]]:g}"
        if back.size:
            at = table.column("time")[rows[p]]
            return [
                f"{where} is at {at:.9g}, not later than the row before: rows in another order or "
                "twice, a clock set back, or another trial, which needs a number of its own"
            ]
        lost = (
            f"{steps[p] / Ts - 1:.0f} lost"
            if steps[p] > 1.5 * Ts
            else "irregular sampling"
        )
        return [
            f"{where} is {steps[p]:.6g} after the row before, where Ts = {Ts:.6g}: {lost}{count}; "
            "resample=True interpolates"
        ]
    ends = SHARE * (
        table.columns.shape[1] - steps.size
    )  # of so many trials, which clocks miss
    if steps.size and abs(steps.mean() - Ts) > (DRIFT + ends / steps.size) * Ts:
        return [
            f"time: the mean step is {steps.mean():.6g}, but Ts = {Ts:.6g}: state that as Ts, or "
            "resample=True interpolates"
        ]
    return []


def about_clock(table: Table, Ts: float) -> str | None:
    """What a clock that is good enough shows, if it is not as exact as a computed one."""
    steps, _ = _steps(table)
    if not steps.size or np.abs(steps - Ts).max() <= SLACK * Ts:
        return None
    low, middle, high = steps.min(), np.median(steps), steps.max()
    return (
        f"steps from {low:.4g} to {high:.4g} s, median {middle:.4g}, where Ts = {Ts:.6g}; no "
        "sample is lost"
    )


def resample(table: Table, Ts: float, between: Sequence[str]) -> str | None:
    """Put the rows of each trial on the times Ts apart from its first one; in words, what was done.

    Those of the columns `between` are interpolated linearly; others are held, as a command is, and
    the one that holds in the middle of a sample counts. What cannot be resampled stays as it is.
    """
    starts, time = starts_of(table.column("trial")), table.column("time")
    steps = _steps(table)[0]
    if np.any(steps <= 0) or np.abs(steps - Ts).max(initial=0) <= SLACK * Ts:
        return None
    trials = [
        slice(a, b) for a, b in zip(starts, [*starts[1:], len(time)], strict=True)
    ]
    counts = [int(min(np.ptp(time[own]) / Ts + SHARE, 1e9)) + 1 for own in trials]
    count = min(counts)  # of the trials, where one is a sample longer
    if max(counts) > count + 1 or sum(counts) * MOST > len(time):
        return None
    columns, lines, filled = [], [], 0
    for own in trials:
        begin = time[own.start]
        grid = begin + Ts * np.arange(count)
        last = np.searchsorted(time[own], grid + Ts / 2, "right") - 1 + own.start
        new = table.columns[:, last]
        for title in between:
            new[table.header.index(title)] = np.interp(
                grid, time[own], table.column(title)[own]
            )
        new[table.header.index("time")] = grid
        filled += count - len(
            set(np.round((time[own] - begin) / Ts)) & set(range(count))
        )
        columns.append(new)
        lines += [table.lines[row] for row in last]
    table.columns, table.lines = np.concatenate(columns, axis=1), lines
    return (
        f"{len(time)} rows were resampled to {len(lines)} samples; near {filled} of them is no "
        f"row, and the longest step is {steps.max():.4g} where Ts = {Ts:.6g}"
    )
