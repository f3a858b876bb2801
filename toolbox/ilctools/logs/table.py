"""Tables that other programs wrote, read by the titles of their columns."""

import re
import warnings
from collections.abc import Mapping
from itertools import product
from statistics import mode

import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES
from ilctools.logs import clock
from ilctools.logs.format import check_signals, few
from ilctools.logs.reader import (
    MARKS,
    about,
    lines_of,
    numbers_of,
    rows_of,
    split,
    trials_of,
    value_of,
)
from ilctools.loop.notes import LogError
from ilctools.signals import SIGNALS as ROLE_OF
from ilctools.units import SECONDS, seconds

SIGNALS = {  # of a log, by argument
    "outputs": "y",
    "inputs": "u",
    "reference": "reference",
    "v": "v",
    "disturbances": "disturbance",
    "measured": "measured",
}
NAMES = ("outputs", "inputs", "disturbances", "measured")  # the arguments that name signals
Columns = Mapping[str, str | int]  # titles or numbers, by the names that their signals get
DELIMITERS = ("\t", ";", "|", ",", " ")
SAMPLE = 200  # rows that show how a table is laid out
DAY = 86400.0  # s
TIME = re.compile(r"\d{4}-\d\d-\d\d([T ][\d:.Z+-]*)?|\d+:[\d:.]+")
WITH_UNIT = re.compile(r"(.*\S)\s*[(\[]([^()\[\]]*)[)\]]")  # "Heater (%)", "Time [s]"
WITH_TIME = re.compile(rf"(?:.*[_\W])?({'|'.join(SECONDS)})", re.I)  # "tempo_ms"


def read_table(
    path,
    *,
    outputs: Columns,
    inputs: Columns | None = None,
    time: str | int | None = None,
    Ts: float | None = None,
    reference: Columns | None = None,
    v: Columns | None = None,
    disturbances: Columns | None = None,
    measured: Columns | None = None,
    trial: str | int | None = None,
    units: Mapping[str, str] | None = None,
    resample: bool = False,
) -> xr.Dataset:
    """Read a table that another program wrote, as a log.

    The text is delimited by tabs, semicolons, bars, commas or blanks; numbers have a point or a
    comma. Between commas a quoted "1,200" is refused, unless a number such as "0,5" or "1,25" shows
    that commas are decimal. Above the rows may stand a line of titles, with units in brackets or in
    the line below, and above it anything else. A column is named by its title, with or without the
    unit, or by its number from 0 on.

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
        by default s, or dates and times as in ISO 8601, of which 07:30 is hours and minutes and
        07:30.0, as spreadsheets show it, minutes and seconds. Without it, rows are `Ts` apart.
        State the unit of a clock that counts from 1970: often it is ms, us or ns.
    Ts : float, optional
        Sampling period, s. Default: the mean step of the clock, rounded as far as steps scatter;
        without `time` it is needed.
    reference : dict, optional
        Column of what each output is to follow. Default: not known.
    v : dict, optional
        Column of the ILC signal that was added to the reference. Default: zero.
    disturbances, measured : dict, optional
        Columns of other inputs of the plant, and of what else was measured.
    trial : str or int, optional
        Column of the number of the trial, from 0 or 1 on. Default: all rows are one trial.
    units : dict, optional
        Units by name, or of ``"time"``, in the place of those in the titles. They are labels: only
        that of time is converted.
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
    choices = locals()
    named = {argument: choices[argument] for argument in SIGNALS if choices[argument] is not None}
    columns = _columns(named)
    if trial is not None:
        columns["trial"] = "trial", trial
    if time is not None:
        columns["time"] = "time", time
    names = [name for argument in NAMES for name in named.get(argument, ())]
    units = arguments.by_name("units", units, [*names, "time"])
    resample = arguments.flag("resample", resample)
    if Ts is not None or time is None:
        Ts = arguments.sampling_period("Ts", Ts)
    is_frame = isinstance(path, pd.DataFrame)
    source = "path" if is_frame else arguments.path("path", path)
    notes = {} if is_frame else {"origin": f"read from {source.name}"}
    with about(source):
        asked = {str(column) for _, column in columns.values()}
        entries = (
            path.rename(columns=str) if is_frame else _entries(lines_of(source), asked, resample)
        )
        table, signals = _as_log(entries, columns, named, units, resample)
        _add_trial_and_time(table, Ts)
        Ts = Ts or clock.mean_step(table)
        trials = trials_of(table, signals, Ts, notes, resample)
    if "resampled" in trials.attrs:
        warnings.warn(f"{source}: {trials.attrs['resampled']}", stacklevel=2)
    return trials


def _columns(named):
    """The argument that asks for each column of a log, and the column that it asks for."""
    columns = {}
    for argument, signals in named.items():
        for name, column in arguments.instance(argument, signals, dict).items():
            arguments.instance(f"a name in {argument}", name, str)
            columns[f"{SIGNALS[argument]}_{name}"] = f"{argument}[{name!r}]", column
    return columns


def _as_log(entries, columns, named, units, gaps):
    """The numbers in the columns that were asked for, the time in s; and the signals' units."""
    places = {title: _place(entries.columns, *asked) for title, asked in columns.items()}
    titles = {title: entries.columns[place] for title, place in places.items()}
    entries = entries.iloc[:, [*places.values()]].set_axis([*places], axis=1)
    signals = {}
    for argument in filter(named.__contains__, NAMES):
        signal = SIGNALS[argument]
        signals[ROLES[ROLE_OF[signal]]] = {
            name: units.get(name, _name_and_unit(titles[f"{signal}_{name}"])[1])
            for name in named[argument]
        }
    check_signals(signals)
    if "time" in titles:
        unit = units.get("time") or _time_unit(titles["time"])
        entries["time"] = _in_seconds(entries["time"], unit)
    table = numbers_of(entries, gaps, titles)
    if "reference" in named and "v" not in named:
        table[[f"v_{name}" for name in named["outputs"]]] = 0.0
    return table, signals


def _place(titles, argument, column):
    """The number of a column that an argument asks for by its title or number."""
    if isinstance(column, int) and 0 <= column < len(titles):
        return column
    for written in ([*titles], [_name_and_unit(title)[0] for title in titles]):
        if written.count(column) == 1:
            return written.index(column)
    raise LogError(
        f"{argument} = {column!r} must be the title of one column, or a number from 0 to "
        f"{len(titles) - 1}; the titles are {few([*titles])}"
    )


def _name_and_unit(title):
    match = WITH_UNIT.fullmatch(title)
    return match.groups() if match else (title, "")


def _time_unit(title):
    """The unit of a clock by its title: in brackets, or at its end."""
    name, unit = _name_and_unit(title)
    suffix = WITH_TIME.fullmatch(name)
    return unit or (suffix[1].lower() if suffix else "s")


def _in_seconds(column, unit):
    """A clock in s: numbers, or dates or times of a day from the first; what is neither stays."""
    text = column.astype(str).str.strip()
    dated, turn = text.str.fullmatch(TIME), DAY
    if dated.any():
        if text.str.fullmatch(r"\d+:\d+\.\d+").any():  # minutes, as spreadsheets show fractions
            text, turn = text.str.replace(r"^(\d+:[\d.]+)$", r"0:\1", regex=True), DAY / 24
        moments = pd.to_datetime(text.where(dated), format="mixed", errors="coerce", utc=True)
        times = (moments - moments.min()).dt.total_seconds()
        times += turn * (times.diff() < -turn / 2).cumsum()  # past midnight, or the hour
    else:
        times = seconds(unit) * column.map(value_of)
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
    """The entries of a text by the titles of their columns, with decimal points.

    (1) What separates entries, and which are numbers, follows from a sample of the rows. (2) Of
    the lines above the first row of numbers, the titles are that with most of those asked for.
    """
    delimiter, point, numeric = _layout(lines)
    titles, above = _titles(lines, delimiter, point, numeric, asked)
    entries = rows_of(lines[above:], above, len(numeric), delimiter, gaps)
    if delimiter == point:  # quoted commas, which may separate thousands
        quoted = entries.stack()
        quoted = quoted[quoted.str.fullmatch(r"\s*[+-]?\d+,\d+\s*")]
        if quoted.str.fullmatch(r"\s*[+-]?[1-9]\d?\d?,\d{3}\s*").all() and len(quoted):
            raise LogError(
                f"row {quoted.index[0][0]}: is the comma of {quoted.iloc[0]!r} a decimal one? Save "
                "numbers without separators of thousands, or columns with semicolons between them"
            )
    entries = entries.set_axis(titles, axis=1)
    return entries.map(_with_point) if point == "," else entries


def _layout(lines):
    """The delimiter, the decimal mark, and which columns have numbers in half of the rows or more.

    Of all delimiters and marks, those with which most rows have the same number of entries, times
    most entries are numbers.
    """
    content = [line for line in lines if line.lstrip()[:1] not in MARKS]  # nor empty
    sample = content[len(content) // 2 :][:SAMPLE]  # below the titles
    best, layout = (0.0, False), None
    for delimiter, point in product(DELIMITERS, ".,"):
        rows = [_split(line, delimiter) for line in sample]
        width = mode(map(len, rows)) if rows else 0
        alike = [row for row in rows if len(row) == width]
        numeric = np.array([_are_numbers(row, point) for row in alike])
        filled = sum(entry != "" for row in alike for entry in row)
        share = numeric.sum() / max(filled, 1)
        quality = len(alike) / max(len(rows), 1) * share, width > 1
        if quality > best:
            best, layout = quality, (delimiter, point, numeric.mean(axis=0) >= 0.5)
    if layout is None or not layout[-1].any():
        raise LogError("there are no rows of numbers")
    return layout


def _titles(lines, delimiter, point, numeric, asked):
    """The titles, with the units from the line below them, and how many lines are above the rows.

    Without titles, the columns are numbered.
    """
    width, candidates = len(numeric), {}
    for above, line in enumerate(lines):
        row = _split(line.lstrip().lstrip(MARKS), delimiter)
        if len(row) == width - 1:  # rows end with a delimiter, or have names
            row = ["", *row] if numeric[-1] else [*row, ""]
        if len(row) != width or not any(row):
            continue
        are_numbers = np.array(_are_numbers(row, point))
        if are_numbers[numeric].all():
            break
        matches = len(asked & {*row, *(_name_and_unit(title)[0] for title in row)})
        if matches or not are_numbers.any():
            candidates[above] = matches, row
    if not candidates:
        return [f"column {place}" for place in range(width)], above
    line = max(candidates, key=lambda line: (candidates[line][0], line))
    titles = candidates[line][1]
    if line + 1 not in candidates:
        return titles, line + 1
    units = candidates[line + 1][1]
    return [f"{title} ({unit})" for title, unit in zip(titles, units, strict=True)], line + 2


def _with_point(entry):
    """An entry with a decimal comma as one with a point; times have points, and words stay."""
    swapped = entry.translate(str.maketrans(",.", ".,"))
    number = any(_are_numbers([entry, swapped], ".")) and not TIME.fullmatch(entry)
    return swapped if number else entry


def _split(line, delimiter):
    """The entries of a line."""
    return [entry.strip() for entry in next(split([line], delimiter), [])]


def _are_numbers(entries, point):
    """Which entries are a number or a time."""
    if point == ",":
        entries = map(_with_point, entries)
    return [not np.isnan(value_of(entry)) or bool(TIME.fullmatch(entry)) for entry in entries]
