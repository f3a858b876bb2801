"""Whether the rows of a log are trials: numbered, in one piece, equally long, sampled on time."""

import numpy as np

from rodlib.ilc.laboratory.tables import Table, few

SLACK = 1e-3  # sampling periods that a time may be off


def off(time, Ts) -> np.ndarray:
    """Which times of a trial are not 0, Ts, 2 Ts, ... up to a thousandth of a period."""
    with np.errstate(over="ignore"):
        late = np.abs(time - Ts * np.arange(len(time)))
        return ~(late <= SLACK * Ts + 1e-12 * np.abs(time))


def starts_of(numbers) -> np.ndarray:
    """The rows where a trial begins, from the number of the trial in each row."""
    return np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])


def check_trials(table: Table, Ts: float) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Numbers of the trials, times of the first one, and problems; Ts in the table's unit."""
    problems, time = [], table.column("time")
    starts = starts_of(table.column("trial"))
    numbers, lengths = table.column("trial")[starts], np.diff([*starts, len(time)])
    odd = np.flatnonzero((numbers < 1) | (numbers != np.round(numbers)) | (numbers > 2**31))
    if odd.size:
        row = table.lines[starts[odd[0]]]
        problems.append(f"trial: {numbers[odd[0]]:g} in row {row} is no whole number, 1 or more")
    known, first = np.unique(numbers, return_index=True)
    if len(known) < len(numbers):
        again = np.setdiff1d(np.arange(len(numbers)), first)[0]
        problems.append(
            f"trial: {numbers[again]:g} goes on in row {table.lines[starts[again]]}, after trial "
            f"{numbers[again - 1]:g}: the rows of a trial must stand together"
        )
        return numbers, time, problems
    if len(set(lengths)) > 1:
        groups = []
        for length in np.unique(lengths):
            which = ", ".join(few([f"{k:g}" for k in numbers[lengths == length]]))
            groups.append(f"{length} samples in trial {which}")
        problems.append(f"trials have different lengths: {'; '.join(few(groups))}")
    for number, start, length in zip(numbers, starts, lengths, strict=True):
        own = time[start : start + length]
        if (wrong := np.flatnonzero(off(own, Ts))).size:
            p = wrong[0]
            problems.append(
                f"time: sample {p} of trial {number:g}, in row {table.lines[start + p]}, is at "
                f"{own[p]:.9g}, but due at {p * Ts:.9g}: a gap, or irregular sampling"
            )
    return numbers, time[: lengths[0]], problems
