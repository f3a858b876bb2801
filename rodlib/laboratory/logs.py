"""The trial-log format: load with checks, save, append.

A log is one plain-text table, described field by field in data/README.md: metadata in lines that
begin with ``#``, then comma-separated values, one row per trial and sample. pandas reads it with
``read_csv(path, comment="#")``, MATLAB with ``readtable(path, "CommentStyle", "#")``.
"""

import difflib
import json
import re
from collections.abc import Iterator
from io import BytesIO

import numpy as np
import xarray as xr

from rodlib import arguments
from rodlib.files import append_whole, write_pieces
from rodlib.laboratory import units as pints
from rodlib.laboratory.layout import (
    DIFFERENCES,
    FORMAT,
    FORMER,
    REQUIRED,
    ROLES,
    SIGNALS,
    Layout,
    former_layout_of,
    layout_of,
    limits_of,
)
from rodlib.laboratory.tables import (
    LogError,
    check_trials,
    few,
    read_head,
    read_rows,
    refuse,
    rows,
)
from rodlib.trials import dataset

BLOCK = 2**17  # rows written at a time


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
    header = _head(trials).splitlines(keepends=True)[-1]
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
    if version not in (FORMAT, FORMER):
        problems.append(f"metadata: format is {version!r}, but must be {FORMAT!r} (or {FORMER!r})")
    refuse(path, problems)  # all further ones would follow from these
    layout = former_layout_of(table, problems) if version == FORMER else layout_of(table, problems)
    if not layout.columns:
        refuse(path, problems)
    Ts = _sampling_period(table.metadata, layout, problems)
    _check_columns(table.header, layout.columns, problems)
    read_rows(file, table, {"trial", "time", *(c.title for c in layout.columns)}, problems)
    numbers = time = None
    if table.pieces and Ts and {"trial", "time"} <= set(table.header):
        tick = _seconds(layout.time, problems)
        if tick and all(np.isfinite(table.column(title)).all() for title in ("trial", "time")):
            numbers, time = check_trials(table, Ts / tick, problems)
            time = time * tick
    refuse(path, problems)
    asked = arguments.by_name("units", units, list(layout.units))
    _check_limits(table, layout.columns, problems)
    refuse(path, problems)
    return _assemble(table, layout, layout.units | asked, Ts, numbers, time)


def _sampling_period(metadata, layout, problems):
    """In s; its unit is that of the time as well, unless the metadata have said another."""
    try:
        number, unit = metadata.get("Ts", "").split()
        layout.time = layout.time or unit
        return arguments.sampling_period(
            "Ts", float(number) * pints.conversion("Ts", unit, "s", False)[0]
        )
    except ValueError:
        stated = metadata.get("Ts")
        problems.append(f"metadata: Ts is {stated!r}, but must be a period such as '1.0 s'")


def _seconds(unit, problems):
    try:
        return pints.conversion("time", unit, "s", False)[0]
    except ValueError as error:
        problems.append(f"metadata: {error}")


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
    notes = {key: value for key, value in table.metadata.items() if key not in layout.own}
    if "limits" in notes and "signals" in layout.own:
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


def save_log(trials: xr.Dataset, path) -> None:
    """Save trials as a log; the file is replaced as a whole or not at all.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`rodlib.run_trials`, :func:`rodlib.record` or :func:`load_log`. Attributes are
        written as metadata: a line of text as it is, all else as JSON. With ``limits``, a JSON
        object of the lowest and highest plausible value by column, implausible values are not
        saved.
    path : path-like

    Raises
    ------
    ValueError
        If a signal, a coordinate or an attribute is not what :func:`load_log` would give back.
    """
    path = arguments.path("path", path)
    head = _head(trials)
    write_pieces(path, (piece for part in ([head], _blocks(trials)) for piece in part))


def append_log(trials: xr.Dataset, path) -> None:
    """Append further trials to a log of the same signals; on the disk when this returns."""
    append_whole(path, b"".join(_blocks(trials)))


def _head(trials):
    """The metadata and the header; checks all that is to be written."""
    arguments.instance("trials", trials, xr.Dataset)
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    metadata = {"format": FORMAT, "Ts": f"{Ts!r} s"}
    metadata["signals"] = json.dumps(_signals(trials), ensure_ascii=False)
    metadata |= _notes(trials.attrs)
    numbers = [arguments.whole("trials.trial", k, 1, 2**31) for k in trials.trial.values]
    if not numbers or not trials.sizes["time"]:
        raise ValueError("trials have no samples")
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"trials.trial = {few(numbers)} must be numbers, none of them twice")
    time = np.asarray(trials.time.values, dtype=float)
    if np.any(~(np.abs(time - Ts * np.arange(len(time))) <= 1e-3 * Ts)):
        raise ValueError(f"trials.time must be 0, Ts, 2 Ts, ... with Ts = {Ts} s")
    columns = {
        f"{signal}_{name}": column
        for signal, values in _values(trials).items()
        for name, column in zip(trials[SIGNALS[signal]].values, values.T, strict=True)
    }
    limits = limits_of(metadata.get("limits", "{}"), columns)
    for title, values in columns.items():
        low, high = limits[title]
        if not np.isfinite(values).all():
            raise ValueError(f"trials have values that are not finite in {title!r}")
        if values.min() < low or values.max() > high:
            raise ValueError(f"trials have values of {title!r} that are not from {low} to {high}")
    lines = [f"# {key}: {value}\n" for key, value in metadata.items()]
    header = ",".join(["trial", "time", *(_quoted(title) for title in columns)])
    return "".join([*lines, header, "\n"]).encode()


def _quoted(title):
    """As csv has it; # as well, which others take for the start of a comment."""
    return '"' + title.replace('"', '""') + '"' if re.search('[,"#]', title) else title


def _signals(trials):
    """Names and units of the signals, by role, as the metadata say it."""
    missing = [name for name in REQUIRED if name not in trials]
    if missing:
        raise ValueError(f"trials lack {missing}: a log needs {REQUIRED}")
    roles = {SIGNALS[name]: ROLES[SIGNALS[name]] for name in SIGNALS if name in trials}
    needed = ["trial", "time", *(role + end for role in roles for end in ("", "_unit"))]
    missing = [name for name in needed if name not in trials.coords]
    if missing:
        raise ValueError(f"trials lack the coordinates {missing}: see rodlib.trials.dataset")
    signals, units = {}, {}
    for role, key in roles.items():
        names, own = trials[role].values.tolist(), trials[f"{role}_unit"].values.tolist()
        signals[key] = dict(zip(names, own, strict=True))
        for name, unit in signals[key].items():
            if not (isinstance(name, str) and name.isprintable() and name):
                raise ValueError(f"{role} {name!r} must have a name of printable characters")
            pints.unit(name, unit)
            if units.setdefault(name, unit) != unit:
                raise ValueError(f"{name!r} has two units, {units[name]!r} and {unit!r}")
        if len(signals[key]) < len(names):
            raise ValueError(f"{role} = {few(names)} must be different names")
    return signals


def _notes(attributes):
    """The attributes as metadata: a line of text as it is, all else as JSON."""
    notes = {}
    for key, value in attributes.items():
        if key == "Ts":
            continue
        plain = isinstance(key, str) and re.fullmatch(r"[^\s:#]([^:]*[^\s:])?", key)
        if not (plain and key.isprintable()) or key in Layout.own:
            raise ValueError(f"attribute {key!r} cannot be a line of the log: rename it")
        line = isinstance(value, str) and value.isprintable() and value == value.strip()
        notes[key] = value if line else json.dumps(value, default=str)
    return notes


def _values(trials):
    """The signals of a log in its order, shape (row, channel) each."""
    return {
        signal: np.asarray(
            trials[signal].transpose("trial", "time", ...).values, dtype=float
        ).reshape(trials.sizes["trial"] * trials.sizes["time"], -1)
        for signal in SIGNALS
        if signal in trials
    }


def _blocks(trials) -> Iterator[bytes]:
    """The rows as text, some at a time."""
    samples, values = trials.sizes["time"], _values(trials)
    numbers, time = trials.trial.values, np.asarray(trials.time.values, dtype=float)
    for start in range(0, len(numbers) * samples, BLOCK):
        row = np.arange(start, min(start + BLOCK, len(numbers) * samples))
        counters = (numbers[row // samples], time[row % samples])
        yield rows(counters, [signal[row[0] : row[-1] + 1] for signal in values.values()])
