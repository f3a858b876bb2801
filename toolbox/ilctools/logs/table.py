"""Tables that other programs wrote, read by the titles of their columns."""

import csv
import re
import reprlib
import warnings
from collections.abc import Mapping
from statistics import mode

import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.logs import clock
from ilctools.logs.format import few
from ilctools.logs.reader import (
    MARKS,
    about,
    check_titles,
    lines_of,
    numbers,
    numbers_of,
    rows_of,
    trials_of,
)
from ilctools.loop.notes import LogError
from ilctools.units import SECONDS, seconds

SIGNALS = {  # of a log, by argument
    "outputs": "y",
    "inputs": "u",
    "reference": "reference",
    "v": "v",
    "disturbances": "disturbance",
    "measured": "measured",
}
ROLES = {  # in a log, of the names in these arguments
    "outputs": "outputs",
    "inputs": "controls",
    "disturbances": "disturbances",
    "measured": "measured",
}
DELIMITERS = ("\t", ";", "|", ",", " ")
SAMPLE = 200  # rows that show how a table is laid out
DAY = 86400.0  # s
DATE = re.compile(r"\d{4}-\d\d-\d\d")
TIME = re.compile(rf"{DATE.pattern}([T ][\d:.Z+-]*)?|\d+:[\d:.]+")
WITH_UNIT = re.compile(r"(.*\S)\s*[(\[]([^()\[\]]*)[)\]]")  # "Heater (%)", "Time [s]"
WITH_TIME = re.compile(rf"(?:.*[_\W])?({'|'.join(SECONDS)})", re.I)  # "tempo_ms"
LONGEST = 1e11  # s: a clock that is beyond, 3,000 years, is in a shorter unit


def read_table(
    path,
    *,
    outputs: Mapping[str, str | int],
    inputs: Mapping[str, str | int] | None = None,
    time: str | int | None = None,
    Ts: float | None = None,
    reference: Mapping[str, str | int] | None = None,
    v: Mapping[str, str | int] | None = None,
    disturbances: Mapping[str, str | int] | None = None,
    measured: Mapping[str, str | int] | None = None,
    trial: str | int | None = None,
    units: Mapping[str, str] | None = None,
    resample: bool = False,
) -> xr.Dataset:
    """Read a table that another program wrote, as a log.

    The text is delimited by tabs, semicolons, bars, commas or blanks; numbers have a point or a
    comma. Above the rows may stand a line of titles, with units in brackets or in the line below,
    and above it anything else. A column is named by its title, with or without the unit, or by its
    number from 0 on.

    Parameters
    ----------
    path : path-like or pandas.DataFrame
        The file, or what pandas has read of a file that is not text.
    outputs : dict
        The column of each controlled output, by the name that the output gets.
    inputs : dict, optional
        The column of the actuator that controls each output, in their order. Default: not known.
    time : str or int, optional
        Column of the clock: numbers in the unit of its title, as "t (ms)" or "t_ms", or of `units`,
        by default s, or dates and times as in ISO 8601. Without it, rows are `Ts` apart.
    Ts : float, optional
        Sampling period, s. Default: the mean step of the clock, rounded as far as steps scatter.
    reference : dict, optional
        Column of what each output is to follow. Default: not known.
    v : dict, optional
        Column of the ILC signal that was added to the reference. Default: zero.
    disturbances, measured : dict, optional
        Columns of other inputs of the plant, and of what else was measured.
    trial : str or int, optional
        Column of the number of the trial, from 0 or 1 on. Default: all rows are one trial.
    units : dict, optional
        Units by name, or of ``"time"``, where titles do not have them, or have the same. They are
        labels: only that of time is converted.
    resample : bool
        Interpolate what is not on time: outputs linearly, inputs are held. Rows without a finite
        number in each column count as lost; at most half of the samples are filled in.

    Returns
    -------
    xarray.Dataset
        As :func:`load_log` gives it, for :func:`save_log`, :func:`measured_response` and replays;
        ``reference``, ``v`` and ``e`` only if there is a reference.

    Raises
    ------
    LogError
        The first thing that is wrong with the table, with its row and column.

    Warns
    -----
    UserWarning
        If the table was resampled.

    See Also
    --------
    load_log : in the format of this package
    measured_response : P from it

    Notes
    -----
    Clocks jitter. Each step may differ from `Ts` by a tenth of it, and their mean by a hundredth:
    the samples then count as `Ts` apart, and the attribute ``clock`` says how it ran.

    Examples
    --------
    >>> import pandas as pd
    >>> from ilctools import read_table
    >>> columns = {"t (s)": [0.0, 0.5, 1.0], "heater (%)": [0, 50, 50], "T (K)": [0, 0, 1.2]}
    >>> table = pd.DataFrame(columns)  # or the path of a file
    >>> log = read_table(table, time="t", inputs={"Q": "heater"}, outputs={"T": "T"})
    >>> log.attrs["Ts"], log.y.shape
    (0.5, (1, 3, 1))
    """
    named = {
        "outputs": outputs,
        "inputs": inputs or {},
        "reference": reference or {},
        "v": v or {},
        "disturbances": disturbances or {},
        "measured": measured or {},
    }
    columns = _columns(named)
    if time is not None:
        columns["time"] = "time", time
    elif Ts is None:
        raise ValueError("Ts = None must be a sampling period in s: there is no time")
    if trial is not None:
        columns["trial"] = "trial", trial
    names = [name for argument in ROLES for name in named[argument]]
    if len({*names}) < len(names):
        raise ValueError(f"{[*ROLES]} must have different names, but are {names}")
    units = arguments.by_name("units", units, [*names, "time"])
    resample = arguments.flag("resample", resample)
    if Ts is not None:
        Ts = arguments.sampling_period("Ts", Ts)
    source, notes = "path", {}
    if not isinstance(path, pd.DataFrame):
        source = arguments.path("path", path)
        notes = {"origin": f"read from {source.name}"}
    with about(source):
        if source == "path":
            entries = path.rename(columns=str)
        else:
            wanted = {str(column) for _, column in columns.values()}
            entries = _entries(lines_of(source), wanted, resample)
        places = {title: _place(entries.columns, *asked) for title, asked in columns.items()}
        if len({*places.values()}) < len(places):
            raise LogError(f"each name needs a column of its own: {columns}")
        written = {title: entries.columns[place] for title, place in places.items()}
        entries = entries.iloc[:, [*places.values()]].set_axis([*places], axis=1)
        signals = {
            role: {
                name: _unit(written[f"{SIGNALS[argument]}_{name}"], units.get(name))
                for name in named[argument]
            }
            for argument, role in ROLES.items()
            if named[argument]
        }
        if time is not None:
            unit = _unit(written["time"], units.get("time"), clock=True) or "s"
            entries["time"] = _in_seconds(entries["time"], unit)
        table = numbers_of(entries, resample)
        _add_trial_and_time(table, Ts)
        if reference and not v:
            table[[f"v_{name}" for name in outputs]] = 0.0
        check_titles([*table], signals)
        Ts = Ts or clock.period_of(table)
        trials = trials_of(table, signals, Ts, notes, resample)
    if "resampled" in trials.attrs:
        warnings.warn(f"{source}: {trials.attrs['resampled']}", stacklevel=2)
    return trials


def _columns(named):
    """For each title of a log, the argument that asks for its column, and the column."""
    columns = {}
    for argument, signals in named.items():
        arguments.instance(argument, signals, dict)
        for name, column in signals.items():
            arguments.instance(f"a name in {argument}", name, str)
            word = f"{argument}[{name!r}]"
            columns[f"{SIGNALS[argument]}_{name}"] = word, column
    outputs, inputs = named["outputs"], named["inputs"]
    if not outputs or (inputs and len(inputs) != len(outputs)):
        raise ValueError(
            f"outputs = {reprlib.repr(outputs)} and inputs = {reprlib.repr(inputs)} must be as "
            "many, one or more: other inputs are disturbances, which are estimated along; other "
            "outputs are measured, or the outputs of a second call"
        )
    return columns


def _place(titles, word, column):
    """The number of a column that an argument asks for by its title or number."""
    if isinstance(column, int) and 0 <= column < len(titles):
        return column
    for written in ([*titles], [_name_and_unit(title)[0] for title in titles]):
        if written.count(column) == 1:
            return written.index(column)
    raise LogError(
        f"{word} = {column!r} must be the title of one column, or a number from 0 to "
        f"{len(titles) - 1}; the titles are {few([*titles])}"
    )


def _name_and_unit(title):
    match = WITH_UNIT.fullmatch(title)
    return match.groups() if match else (title, "")


def _unit(title, stated, clock=False):
    """The unit of a column: stated, or that of its title, which it must not contradict."""
    name, unit = _name_and_unit(title)
    suffix = WITH_TIME.fullmatch(name) if clock and not unit else None
    unit = suffix[1].lower() if suffix else unit
    if not (stated and unit):
        return stated or unit
    if (seconds(stated) != seconds(unit)) if clock else (stated != unit):
        raise LogError(
            f"the title {title!r} says {unit!r}, but units say {stated!r}: nothing is converted. "
            "Leave it out of units, or rename the column"
        )
    return stated


def _in_seconds(column, unit):
    """A clock in s: numbers, or dates or times of a day from the first; what is neither stays."""
    text = column.astype(str).str.strip()
    if text.str.match(DATE).any():
        moments = pd.to_datetime(text, format="ISO8601", errors="coerce", utc=True)
        times = (moments - moments.min()).dt.total_seconds()
    elif text.str.fullmatch(TIME).any():
        times = pd.to_timedelta(text, errors="coerce").dt.total_seconds()
        times += DAY * (times.diff() < -DAY / 2).cumsum()  # past midnight
    else:
        times = seconds(unit) * numbers(column)
        if times.abs().max() > LONGEST:
            raise LogError(
                f"time reaches {times.abs().max():.3g} s, thousands of years: state its unit, as "
                "in units={'time': 'ms'} or 'us' or 'ns'"
            )
    return times.astype(object).where(times.notna(), column)


def _add_trial_and_time(table, Ts):
    """Trials from 1 on, each with a time of its own."""
    if "trial" not in table:
        table["trial"] = 1.0
    elif table["trial"].min() == 0:
        table["trial"] += 1
    trials = table.groupby("trial")
    if "time" in table:
        table["time"] -= trials["time"].transform("first")
    else:
        table["time"] = Ts * trials.cumcount()


def _entries(lines, asked, gaps):
    """The entries of a text by the titles of their columns, with decimal points."""
    content = [line for line in lines if line.strip() and line.lstrip()[0] not in MARKS]
    sample = content[len(content) // 2 :][:SAMPLE] or [""]  # below the titles
    layouts = [(mark, point) for mark in DELIMITERS for point in ".," if mark != point]
    delimiter, point = max(layouts, key=lambda layout: _quality(sample, *layout))
    rows = _rows(sample, delimiter)
    numeric = np.mean([_are_numbers(row, point) for row in rows], axis=0) >= 0.5
    if not numeric.any():
        raise LogError("there are no rows of numbers")

    width = len(numeric)
    candidates = {}  # for titles, by line
    for first, line in enumerate(lines):
        row = _split(line.lstrip().lstrip(MARKS), delimiter)
        if len(row) == width - 1:  # rows end with a delimiter, or have names
            row = ["", *row] if numeric[-1] else [*row, ""]
        if len(row) != width or not any(row):
            continue
        are_numbers = _are_numbers(row, point)
        if are_numbers[numeric].all():
            break
        matches = len(asked & {*row, *(_name_and_unit(title)[0] for title in row)})
        if matches or not are_numbers.any():
            candidates[first] = matches, row
    titles = [f"column {place}" for place in range(width)]
    if candidates:
        line = max(candidates, key=lambda line: (candidates[line][0], line))
        titles, first = candidates[line][1], line + 1
        if first in candidates:
            units = candidates[first][1]
            titles = [f"{a} ({b})" for a, b in zip(titles, units, strict=True)]
            first += 1
    body = lines[first:]
    if delimiter == " ":
        body = [" ".join(line.split()) for line in body]
    entries = rows_of(body, first, width, delimiter, gaps).set_axis(titles, axis=1)
    return entries.map(_with_point) if point == "," else entries


def _with_point(entry):
    """An entry with a decimal comma as one with a point; times have points."""
    is_time = TIME.fullmatch(entry)
    return entry if is_time else entry.translate(str.maketrans(",.", ".,"))


def _split(line, delimiter):
    """The entries of a line; a row of blanks is one delimiter."""
    line = " ".join(line.split()) if delimiter == " " else line
    row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [entry.strip() for entry in row]


def _rows(lines, delimiter):
    """The entries of the lines that have the usual number of them."""
    rows = [_split(line, delimiter) for line in lines]
    width = mode(map(len, rows))
    return [row for row in rows if len(row) == width]


def _are_numbers(entries, point):
    """Which entries are a number or a time."""
    entries = pd.Series(entries, dtype=object)
    values = numbers(entries.map(_with_point) if point == "," else entries)
    return (values.notna() | entries.str.fullmatch(TIME)).to_numpy(bool)


def _quality(lines, delimiter, point):
    """The share of lines that are alike, times that of numbers in them; then several columns."""
    rows = _rows(lines, delimiter)
    entries = [entry for row in rows for entry in row if entry]
    share = np.mean(_are_numbers(entries, point)) if entries else 0.0
    return len(rows) / len(lines) * share, len(rows[0]) > 1
