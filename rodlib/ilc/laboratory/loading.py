"""Loading a trial log, with checks.

A log is one plain-text table, described field by field in data/README.md: metadata in lines that
begin with ``#``, then comma-separated values, one row per trial and sample. pandas reads it with
``read_csv(path, comment="#")``, MATLAB with ``readtable(path, "CommentStyle", "#")``.
"""

import difflib
import json
import re
from io import BytesIO

import numpy as np
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.laboratory import units as pints
from rodlib.ilc.laboratory.layout import DIFFERENCES, FORMAT, OWN, SIGNALS, layout_of
from rodlib.ilc.laboratory.saving import head_of
from rodlib.ilc.laboratory.tables import (
    NUMBER,
    LogError,
    check_trials,
    few,
    read_head,
    read_rows,
    refuse,
)
from rodlib.ilc.trials import dataset


def load_log(path, units: dict[str, str] | None = None) -> xr.Dataset:
    """Load a trial log and check it.

    Parameters
    ----------
    path : path-like
    units : dict, optional
        Other units than those of the file, by the name of the plant's signal. v and delta are
        differences: they change by the factor between the units, all else by their zeros, too.

    Returns
    -------
    xarray.Dataset
        As :func:`rodlib.run_trials` gives it, with the numbers of the trials as in the file;
        ``delta`` and ``disturbance`` only if the log has them. The metadata are attributes.

    Raises
    ------
    LogError
        With all problems, each with its trial and row: unreadable file, metadata, column names,
        units, entries that are not numbers, gaps, sampling, trial numbers and lengths,
        implausible values.
    ValueError
        If `units` is not a dict of units that the signals can be converted to.
    """
    path = arguments.path("path", path)
    try:
        with open(path, "rb") as file:
            return _load(file, path, units)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}") from None


def load_ended(path) -> tuple[xr.Dataset, int]:
    """Load a log that :func:`append_log` can go on with.

    A last trial that is shorter than the first is what a killed process has left: it is ignored.

    Returns
    -------
    trials : xarray.Dataset
    size : int
        Of the file up to the end of the last whole trial, bytes.

    Raises
    ------
    LogError
        If the log cannot be used, or its columns are not where :func:`save_log` puts them.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}") from None
    size = content.rfind(b"\n") + 1
    first = content.find(b"\n", re.match(rb"(#.*\n)*", content).end()) + 1
    number = content[first : content.find(b",", first) + 1]
    second = re.compile(rb"(?:%b.*\n)*" % re.escape(number)).match(content, first).end()
    last = content.rfind(b"\n", 0, max(0, size - 1)) + 1
    number = content[last : content.find(b",", last) + 1]
    last = content.find(b"\n" + number, first - 1) + 1
    if last > first and content.count(b"\n", last, size) < content.count(b"\n", first, second):
        size = last
    trials = _load(BytesIO(content[:size]), path, None)
    header = head_of(trials).splitlines(keepends=True)[-1]
    if not content[:first].endswith(b"\n" + header):
        raise LogError(f"{path}: to go on with it, its columns must be {header.decode().strip()}")
    return trials, size


def _load(file, path, units):
    problems = []
    try:
        table = read_head(file, problems)
    except UnicodeError as error:
        raise LogError(f"{path}: cannot be read as text: {error}") from None
    version = table.metadata.get("format")
    if version != FORMAT:
        problems.append(f"metadata: format is {version!r}, but must be {FORMAT!r}")
    refuse(path, problems)  # all further ones would follow from these
    layout = layout_of(table, problems)
    if not layout.columns:
        refuse(path, problems)
    Ts, tick = _sampling_period(table.metadata, problems)
    _check_columns(table.header, layout.columns, problems)
    read_rows(file, table, {"trial", "time", *(c.title for c in layout.columns)}, problems)
    numbers = time = None
    readable = bool(table.pieces and Ts) and {"trial", "time"} <= {*table.header}
    if readable and all(np.isfinite(table.column(title)).all() for title in ("trial", "time")):
        numbers, time = check_trials(table, Ts / tick, problems)
        time = time * tick
    refuse(path, problems)
    asked = arguments.by_name("units", units, list(layout.units))
    _check_limits(table, layout.columns, problems)
    refuse(path, problems)
    return _assemble(table, layout, layout.units | asked, Ts, numbers, time)


def _sampling_period(metadata, problems):
    """In s, and the unit of it and of the time in s."""
    try:
        number, unit = metadata.get("Ts", "").split()
        if not NUMBER.fullmatch(number):  # as in the rows: float takes more
            raise ValueError(number)
        tick, _ = pints.conversion("Ts", unit, "s", False)
        return arguments.sampling_period("Ts", float(number) * tick), tick
    except ValueError:
        stated = metadata.get("Ts")
        problems.append(f"metadata: Ts is {stated!r}, but must be a period such as '1.0 s'")
        return None, None


def _check_columns(header, columns, problems):
    titles = ["trial", "time", *(column.title for column in columns)]
    known = set(titles)
    missing = [title for title in titles if title not in header]
    for title in header:
        if title not in known:
            close = difflib.get_close_matches(title, titles[:100], n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            problems.append(f"unknown column {title!r}{hint}")
    if missing:
        problems.append(f"missing columns {few(missing)}")


def _check_limits(table, columns, problems):
    for column in columns:
        low, high = column.limits
        if (low, high) == (-np.inf, np.inf):
            continue
        values = table.column(column.title)
        beyond = np.flatnonzero((values < low) | (values > high))
        if beyond.size:
            row = beyond[0]
            problems.append(
                f"{column.title}: implausible value {values[row]:g} in trial "
                f"{table.column('trial')[row]:g}, row {table.line_of(row)}: not from {low:g} to "
                f"{high:g} {column.unit}; wrong unit? ({beyond.size} such values)"
            )


def _assemble(table, layout, units, Ts, numbers, time):
    samples = len(time)
    total = sum(len(piece) for piece in table.pieces)
    signals = {
        signal: np.empty((total, len(layout.names[role])))
        for signal, role in SIGNALS.items()
        if any(column.signal == signal for column in layout.columns)
    }
    places = []
    for column in layout.columns:
        difference = column.signal in DIFFERENCES
        way = pints.conversion(column.name, column.unit, units[column.name], difference)
        index = layout.names[SIGNALS[column.signal]].index(column.name)
        place = signals[column.signal][:, index]
        places.append((place, table.header.index(column.title), way))
    start = 0
    while table.pieces:  # each is let go when it has been copied: a log may be large
        piece = table.pieces.pop(0)
        for place, index, (factor, offset) in places:
            values = piece[:, index]
            if (factor, offset) != (1, 0):
                values = values * factor + offset
            place[start : start + len(piece)] = values
        start += len(piece)
    signals = {name: s.reshape(len(numbers), samples, -1) for name, s in signals.items()}
    trials = dataset(Ts, *layout.names.values(), units, **signals)
    notes = {key: value for key, value in table.metadata.items() if key not in OWN}
    if "limits" in notes:
        notes["limits"] = json.dumps(_limits_in(units, layout.columns))
    return trials.assign_attrs(notes).assign_coords(
        trial=numbers.astype(int), time=("time", time, {"units": "s"})
    )


def _limits_in(units, columns):
    """The limits that are stated, in the units that are read."""
    limits = {}
    for column in columns:
        if np.isfinite(column.limits).any():
            factor, offset = pints.conversion(
                column.name, column.unit, units[column.name], column.signal in DIFFERENCES
            )
            limits[column.title] = [bound * factor + offset for bound in column.limits]
    return limits
