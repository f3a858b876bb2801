"""The trial-log format: load with checks, save.

A log is one plain-text table, described field by field in data/README.md: metadata in lines that
begin with ``#``, then comma-separated values, one row per trial and sample. pandas reads it with
``read_csv(path, comment="#")``, MATLAB with ``readtable(path, "CommentStyle", "#")``.
"""

import difflib
import io
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from rodlib import arguments
from rodlib.files import write_whole
from rodlib.filters import LearningFilter, ZeroPhaseButterworth, zero_phase_butterworth
from rodlib.trials import dataset

FORMAT = "rodlib trial log 1"
SIGNALS = ("reference", "v", "u", "y")  # every log has them, one column per channel
TO_SI = {
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "temperature": {"K": 1.0, "mK": 1e-3},
    "heat flow": {"W": 1.0, "mW": 1e-3, "kW": 1e3},
}
PLAUSIBLE = {"temperature": 500.0, "heat flow": 1e4}  # beyond this, units or sensors are wrong


class LogError(ValueError):
    """A log that cannot be used; the message lists all that is wrong with it."""


def load_log(path) -> xr.Dataset:
    """Load a trial log and check it.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    xarray.Dataset
        As :func:`rodlib.run_trials` gives it, in SI units; ``delta`` and ``disturbance`` only if
        the log has them. The metadata are attributes.

    Raises
    ------
    LogError
        With all problems at once, each with its trial and row: unreadable file, metadata, column
        names, units, entries that are not numbers, gaps, sampling, trial numbers and lengths,
        implausible values.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read as text: {error}") from None
    lines = text.splitlines()
    metadata = dict(
        re.match(r"#\s*([^:]+?)\s*:\s*(.*)", line).groups()
        for line in lines
        if re.match(r"#[^:]+:", line)
    )
    problems = []
    if metadata.get("format") != FORMAT:
        problems.append(f"metadata: format is {metadata.get('format')!r}, but must be {FORMAT!r}")
    Ts = _sampling_period(metadata, problems)
    first_row = sum(line.startswith("#") for line in lines) + 2  # line of the first data row
    try:
        table = pd.read_csv(io.StringIO(text), comment="#", dtype=str, skipinitialspace=True)
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise LogError(_report(path, [*problems, f"no table: {error}"])) from None
    if table.empty:
        raise LogError(_report(path, [*problems, "the table has no rows"]))
    channels, known = _check_columns(table.columns, problems)
    factors = _factors(known, metadata, problems)
    values = _numbers(table, first_row, problems)
    counters = values.reindex(columns=["trial", "time"]).to_numpy()
    if np.isfinite(counters).all() and "time" in factors and np.isfinite(Ts):
        _check_trials(values, first_row, Ts / factors["time"], problems)
    if problems:
        raise LogError(_report(path, problems))

    for column, factor in factors.items():
        if factor != 1:
            values[column] *= factor
    for column, size in values.drop(columns=["trial", "time"]).abs().max().items():
        limit = PLAUSIBLE[_quantity(column)]
        if size > limit:
            row = values[column].abs().idxmax()
            problems.append(
                f"{column}: implausible value {values[column][row]:g} in trial "
                f"{values.trial[row]:g}, row {row + first_row}: beyond {limit:g} (SI); wrong unit?"
            )
    if problems:
        raise LogError(_report(path, problems))
    return _assemble(values, channels, Ts, metadata)


def save_log(dataset: xr.Dataset, path) -> None:
    """Save trials as a log; the file is replaced as a whole or not at all.

    Parameters
    ----------
    dataset : xarray.Dataset
        From :func:`rodlib.run_trials`, :func:`rodlib.rig.record` or :func:`load_log`. Attributes
        are written as metadata.
    path : path-like

    Raises
    ------
    ValueError
        If a signal is missing, or has a value that is not finite.
    """
    missing = [name for name in SIGNALS if name not in dataset]
    if missing:
        raise ValueError(f"dataset lacks {missing}: a log needs {list(SIGNALS)}")
    columns = {}
    trials, samples = dataset.sizes["trial"], dataset.sizes["time"]
    columns["trial"] = np.repeat(np.arange(1, trials + 1), samples)
    columns["time"] = np.tile(dataset.time.values, trials)
    for name in [*SIGNALS, *(["delta"] if "delta" in dataset else [])]:
        for channel in range(dataset.sizes["channel"]):
            columns[f"{name}{channel + 1}"] = dataset[name].values[:, :, channel].ravel()
    for index, name in enumerate(dataset.source.values if "disturbance" in dataset else ()):
        columns[str(name)] = dataset.disturbance.values[:, :, index].ravel()
    table = pd.DataFrame(columns)
    bad = table.columns[~np.isfinite(table).all()]
    if len(bad):
        raise ValueError(f"dataset has values that are not finite in {list(bad)}")

    units = "; ".join(f"{c} {next(iter(TO_SI[_quantity(c)]))}" for c in table if c != "trial")
    metadata = {"format": FORMAT, "Ts": f"{dataset.attrs['Ts']!r} s", "units": units}
    metadata |= {k: v for k, v in dataset.attrs.items() if k not in metadata}
    head = "".join(f"# {key}: {' '.join(str(value).split())}\n" for key, value in metadata.items())
    write_whole(Path(path), head + table.to_csv(index=False, lineterminator="\n"))


def with_law(
    trials: xr.Dataset, Q: ZeroPhaseButterworth, L: LearningFilter | None, rest: int = 0
) -> xr.Dataset:
    """Note in the metadata which ILC law (23) made the trials, for the replay.

    `rest` is the number of samples at the end of a trial in which v was held at zero.
    """
    notes = {"Q": json.dumps({"order": Q.order, "cutoff": Q.cutoff, "ends": Q.ends})}
    coefficients = None if L is None else L.coefficients.tolist()
    notes["L"] = json.dumps(coefficients and {"coefficients": coefficients, "ends": L.ends})
    if rest:
        notes["rest"] = json.dumps(rest)
    return trials.assign_attrs(notes)


def law_of(trials: xr.Dataset) -> tuple[ZeroPhaseButterworth, LearningFilter | None] | None:
    """The filters Q and L noted in the metadata of a log; None if it does not say.

    Raises
    ------
    LogError
        If the notes are there but cannot be understood.
    """
    if "Q" not in trials.attrs or "L" not in trials.attrs:
        return None
    Ts = trials.attrs["Ts"]
    try:
        Q, L = json.loads(trials.attrs["Q"]), json.loads(trials.attrs["L"])
        Q = zero_phase_butterworth(Q["order"], Q["cutoff"], Ts, ends=Q["ends"])
        return Q, L and LearningFilter(L["coefficients"], Ts, L["ends"])
    except (json.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        raise LogError(f"metadata: Q or L cannot be understood: {error!r}") from None


def rest_of(trials: xr.Dataset) -> int:
    """Samples at the end of a trial in which v was held at zero, as noted in the metadata.

    Raises
    ------
    LogError
        If the note is no whole number below the length of a trial.
    """
    try:
        note = json.loads(trials.attrs.get("rest", "0"))
        return arguments.whole("rest", note, 0, trials.sizes["time"] - 1)
    except (TypeError, ValueError) as error:
        raise LogError(f"metadata: rest cannot be understood: {error}") from None


def _report(path, problems):
    return f"{path}: {len(problems)} problem(s)\n" + "\n".join(f"- {text}" for text in problems)


def _sampling_period(metadata, problems):
    match = re.fullmatch(r"([0-9.eE+-]+)\s*(s|ms)", metadata.get("Ts", ""))
    try:
        Ts = float(match[1]) * TO_SI["time"][match[2]]
        if Ts > 0:
            return Ts
    except (TypeError, ValueError):
        pass
    problems.append(f"metadata: Ts is {metadata.get('Ts')!r}, but must be a period such as '1.0 s'")
    return np.nan


def _check_columns(columns, problems):
    """Number of channels and known columns; complains about those unknown or missing."""
    channels = max([int(m[1]) for c in columns if (m := re.fullmatch(r"y(\d+)", c))], default=1)
    required = ["trial", "time", *(f"{s}{i + 1}" for s in SIGNALS for i in range(channels))]
    optional = [f"delta{i + 1}" for i in range(channels)]
    known = [c for c in columns if c in required + optional or re.fullmatch(r"theta_a|Q\d+", c)]
    for column in columns.difference(known, sort=False):
        close = difflib.get_close_matches(column, [*required, *optional, "theta_a"], n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        problems.append(f"unknown column {column!r}{hint}")
    missing = [column for column in required if column not in columns]
    if any(c in columns for c in optional):
        missing += [column for column in optional if column not in columns]
    if missing:
        problems.append(f"missing columns {missing}")
    return channels, known


def _quantity(column):
    if column == "time":
        return "time"
    return "heat flow" if re.match(r"u|delta|Q", column) else "temperature"


def _factors(columns, metadata, problems):
    """Factor to SI units for each column except the trial's number."""
    pairs = [part.split() for part in metadata.get("units", "").split(";") if part.strip()]
    units = {pair[0]: pair[1] for pair in pairs if len(pair) == 2}
    factors = {}
    for column in columns:
        if column == "trial":
            continue
        known = TO_SI[_quantity(column)]
        if column not in units:
            problems.append(f"metadata: units does not name the unit of {column!r}")
        elif units[column] not in known:
            problems.append(
                f"metadata: unit {units[column]!r} of {column!r} must be one of {list(known)}"
            )
        else:
            factors[column] = known[units[column]]
    return factors


def _numbers(table, first_row, problems):
    readable = table.apply(pd.to_numeric, errors="coerce").notna()
    values = table.where(readable).astype(float)  # to_numeric itself loses digits before pandas 3
    for column in table:
        bad = np.flatnonzero(~np.isfinite(values[column]))
        if bad.size:
            row = bad[0]
            entry = table[column].iloc[row]
            what = "is missing" if pd.isna(entry) else f"is {entry!r}, not a finite number"
            trial = table["trial"].iloc[row] if "trial" in table else "?"
            where = f"in trial {trial}, row {row + first_row}"
            more = f" ({bad.size} such entries)" if bad.size > 1 else ""
            problems.append(f"{column}: entry {what}, {where}{more}")
    return values


def _check_trials(values, first_row, Ts, problems):
    """Trials numbered from one, all equally long, sampled every Ts from zero on."""
    numbers = values.trial.to_numpy()
    changes = np.flatnonzero(np.diff(numbers)) + 1
    starts = np.concatenate([[0], changes])
    seen = numbers[starts]
    wrong = np.flatnonzero(seen != np.arange(1, len(seen) + 1))
    if wrong.size:
        row = starts[wrong[0]]
        problems.append(
            f"trial: number {seen[wrong[0]]:g} in row {row + first_row}, where {wrong[0] + 1} was "
            "expected: trials must be numbered 1, 2, ... in order"
        )
    lengths = np.diff([*starts, len(numbers)])
    usual = int(np.median(lengths))
    for number, length in zip(seen, lengths, strict=True):
        if length != usual:
            problems.append(f"trial {number:g} has {length} samples, but others have {usual}")
    for number, start, length in zip(seen, starts, lengths, strict=True):
        time = values.time.to_numpy()[start : start + length]
        if abs(time[0]) > 1e-3 * Ts:
            problems.append(
                f"time: trial {number:g} begins at {time[0]:g}, row {start + first_row}, not at 0"
            )
        off = np.flatnonzero(np.abs(np.diff(time) - Ts) > 1e-3 * Ts)
        if off.size:
            step, row = time[off[0] + 1] - time[off[0]], start + off[0] + 1 + first_row
            kind = "a gap" if step > 1.5 * Ts else "irregular sampling"
            problems.append(
                f"time: {kind} in trial {number:g}, row {row}: a step of {step:g} where "
                f"Ts = {Ts:g} ({off.size} such steps in this trial)"
            )


def _assemble(values, channels, Ts, metadata):
    trials = int(values.trial.iloc[-1])

    def stack(columns):
        return values[columns].to_numpy(copy=True).reshape(trials, -1, len(columns))

    names = [*SIGNALS, *(["delta"] if "delta1" in values else [])]
    signals = {name: stack([f"{name}{i + 1}" for i in range(channels)]) for name in names}
    sources = [c for c in values if re.fullmatch(r"theta_a|Q\d+", c)]
    if sources:
        signals["disturbance"] = stack(sources)
    notes = {k: v for k, v in metadata.items() if k not in ("Ts", "units", "format")}
    outputs, controls = ([f"{name}{i + 1}" for i in range(channels)] for name in "yu")
    units = dict.fromkeys(outputs, "K") | dict.fromkeys(controls, "W")
    units |= {name: "W" if name.startswith("Q") else "K" for name in sources}
    return dataset(Ts, outputs, controls, sources, units, **signals).assign_attrs(notes)
