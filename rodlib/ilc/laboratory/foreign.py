"""Tables that others wrote: delimited text of any kind, read by the names of its columns."""

import difflib
import re
import reprlib
import warnings
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.laboratory import log, sampling, tables
from rodlib.ilc.laboratory.log import LogError, refuse
from rodlib.ilc.laboratory.tables import few
from rodlib.ilc.units import check, seconds, understood

DELIMITERS = ("\t", ";", "|", ",", " ")
MARKS = "#%/!"  # with which comments begin
LOOKED_AT = 200  # rows, to see how a table is laid out
SIGNALS = {  # by argument, as titles of a log begin
    "reference": "reference", "v": "v", "inputs": "u", "outputs": "y",
    "disturbances": "disturbance", "measured": "measured",
}  # fmt: skip
TIME = re.compile(r"\d{4}-\d\d-\d\d.*|\d+:\d\d(:\d\d.*)?")
UNIT = re.compile(r"(.*\S)\s*[(\[]([^()\[\]]*)[)\]]")  # "Heater 1 (%)", "Time [s]"


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

    The text is delimited by commas, semicolons, tabs, bars or blanks; numbers have a point or a
    comma; above the rows may stand one line of titles, with units in brackets, below whatever else.
    A column is told by its title, with or without the unit, or by its number from 0 on.

    Parameters
    ----------
    path : path-like or pandas.DataFrame
        Of the file; or what pandas has read of a file that is no text.
    outputs : dict
        The column of each output that is to be controlled, by the name that it gets.
    inputs : dict, optional
        Of the actuator that controls each output, in their order. Default: not known.
    time : str or int, optional
        Column of the clock: numbers in the unit of its title or of `units`, by default s, or dates
        and times as in ISO 8601. Without it, rows are `Ts` apart.
    Ts : float, optional
        Sampling period, s. Default: the median step of the clock, rounded as far as steps scatter.
    reference : dict, optional
        Column of what each output should follow. Default: not known.
    v : dict, optional
        Of the ILC signal that was added to the reference. Default: none was, zero.
    disturbances, measured : dict, optional
        Of other inputs of the plant, and of what else was measured.
    trial : str or int, optional
        Column of the number of the trial. Default: all rows are one trial.
    units : dict, optional
        By name, or of ``"time"``: units that the titles do not tell.
    resample : bool
        Interpolate what is not on time: outputs linearly, inputs are held. Rows with gaps count as
        lost. More than half of the samples are not made up.

    Returns
    -------
    xarray.Dataset
        As :func:`load_log` gives it, for :func:`save_log`, :func:`measured_response` and replays;
        ``reference``, ``v`` and ``e`` only if there is a reference, and what the clock shows as the
        attribute ``clock``.

    Raises
    ------
    LogError
        With all that is wrong, by row of the file and column.

    Warns
    -----
    UserWarning
        If the table was resampled, or a unit is none that pint knows: it is left out.

    Notes
    -----
    Clocks jitter. Each step may differ from `Ts` by a tenth of it, and the mean of all by a
    hundredth: the samples then count as `Ts` apart, which puts a signal that changes by 1 in a
    sampling period off by a tenth at most. A clock that stands still or runs back is refused.
    """
    given = {"outputs": outputs, "inputs": inputs, "reference": reference, "v": v}
    given |= {"disturbances": disturbances, "measured": measured}
    wanted = _wanted(given, time, trial)
    if Ts is not None:
        Ts = arguments.sampling_period("Ts", Ts)
    elif time is None:
        raise ValueError("Ts = None must be a sampling period in seconds where no time is given")
    labels = arguments.by_name("units", units, [*_names(given), "time"])
    check("units", labels)
    resample = arguments.flag("resample", resample)
    if isinstance(path, pd.DataFrame):
        source, content = "path", path.to_csv(index=False).encode()
    else:
        source = arguments.path("path", path)
        content = log.content_of(source)
    return _read(source, content, wanted, given, Ts, labels, resample)


def _names(given):
    """The signals, by the role in which they stand in the metadata of a log."""
    roles = {"outputs": "outputs", "inputs": "controls", "disturbances": "disturbances"}
    roles["measured"] = "measured"
    return {name: role for word, role in roles.items() for name in given[word] or ()}


def _wanted(given, time, trial):
    """For each title of the log the argument that says which column it is, and that column."""
    wanted = {"trial": ("trial", trial), "time": ("time", time)}
    count = 0
    for word, signal in SIGNALS.items():
        columns = {} if word != "outputs" and given[word] is None else given[word]
        for name, column in arguments.instance(word, columns, dict).items():
            if not (isinstance(name, str) and name.isprintable() and name):
                raise ValueError(
                    f"{word} names {reprlib.repr(name)}, but must name signals by text"
                )
            wanted[f"{signal}_{name}"] = f"{word}[{name!r}]", column
            count += word not in ("reference", "v")
    outputs, inputs = given["outputs"], given["inputs"]
    if not outputs or (inputs is not None and len(inputs) != len(outputs)):
        raise ValueError(
            f"outputs = {reprlib.repr(outputs)} and inputs = {reprlib.repr(inputs)} must be as "
            "many, one or more: name as outputs what the inputs control, one each; what else was "
            "measured in measured, other inputs in disturbances"
        )
    if count > len(_names(given)):
        raise ValueError("outputs, inputs, disturbances and measured must have different names")
    for word in ("reference", "v"):
        if given[word] is not None and {*given[word]} != {*outputs}:
            raise ValueError(f"{word} is of {[*given[word]]}, but must be of {[*outputs]}")
    if given["v"] is not None and given["reference"] is None:
        raise ValueError("v is given, but no reference, to which it was added")
    wanted = {title: asked for title, asked in wanted.items() if asked[1] is not None}
    for word, column in wanted.values():
        if not isinstance(column, str | int) or isinstance(column, bool):
            raise ValueError(f"{word} = {reprlib.repr(column)} must be a title or a number")
    return wanted


def _read(source, content, wanted, given, Ts, labels, resample):
    lines = _text(source, content).split("\n")
    layout = _layout(lines)
    if layout is None:
        raise LogError(f"{source}: no rows of numbers are found")
    places, problems = {}, []
    for title, (word, column) in wanted.items():
        try:
            place = layout.place(column)
            if place in places.values():
                raise ValueError("was given before: no column is two signals")
            places[title] = place
        except ValueError as error:
            problems.append(f"{word} = {column!r} {error}")
    refuse(source, problems)
    table = tables.Table(gaps=resample, decimal=layout.decimal, width=layout.width)
    table.delimiter = layout.delimiter
    table.header = [layout.name(place) for place in places.values()]
    table.places = [*places.values()]
    body = _prepared(lines, table, layout)
    dated = "time" in places and layout.dated[places["time"]]
    if dated:
        body = _with_seconds(body, table, [*places].index("time"))
    tables.read_rows(table, "\n".join(body).encode(), layout.first + 1)
    refuse(source, table.problems_of(table.header))

    whole = np.isfinite(table.columns).all(axis=0)
    if not whole.any():
        raise LogError(f"{source}: the table has no rows")
    columns = dict(zip(places, table.columns[:, whole], strict=True))
    table.lines = [line for line, good in zip(table.lines, whole, strict=True) if good]
    number = columns.setdefault("trial", np.ones(whole.sum()))
    columns["trial"] = number + (number.min() == 0)
    if "time" in columns:
        unit = "s" if dated else labels.get("time") or layout.unit(places["time"]) or "s"
        columns["time"] = columns["time"] * seconds(unit)
    else:
        starts = sampling.starts_of(columns["trial"])
        rows = np.arange(len(number))
        columns["time"] = Ts * (rows - starts[np.searchsorted(starts, rows, "right") - 1])
    if given["reference"] and not given["v"]:
        columns |= {f"v_{name}": np.zeros(len(number)) for name in given["outputs"]}
    table.header, table.columns = [*columns], np.array([*columns.values()])
    if Ts is None and (Ts := sampling.period_of(table)) is None:
        raise LogError(f"{source}: time: the clock stands still, or there is one row: state Ts")
    signals = {}
    for name, role in _names(given).items():
        place = next(p for title, p in places.items() if title.split("_", 1)[1:] == [name])
        label = labels.get(name, layout.unit(place))
        signals.setdefault(role, {})[name] = _known(source, name, label)
    notes = {} if source == "path" else {"origin": f"read from {source.name}"}
    return log.trials_of(source, table, signals, Ts, notes, resample, anywhere=True)


def _known(source, name, label):
    """A unit as a log may have it."""
    try:
        understood(name, label)
    except ValueError as error:
        warnings.warn(f"{source}: {error}; it is left out", stacklevel=4)
        return ""
    return label


def _text(source, content):
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in content:
        raise LogError(f"{source}: is no text: let pandas read it, and pass what it gives as path")
    else:
        encoding = "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeError:
        text = content.decode("latin-1")  # as spreadsheets write degC
    return text.replace("\r\n", "\n").replace("\r", "\n")


@dataclass(frozen=True)
class _Layout:
    """How a table is laid out."""

    delimiter: str
    decimal: str
    width: int  # columns
    first: int  # lines above the rows
    titles: list[str] | None
    dated: list[bool]  # which columns are dates or times, not numbers

    def place(self, column) -> int:
        """Where a column stands that is told by its title or number."""
        if isinstance(column, int):
            if 0 <= column < self.width:
                return column
            raise ValueError(f"must be from 0 to {self.width - 1}, as the rows have {self.width}")
        if self.titles is None:
            raise ValueError(f"is no column: no line of {self.width} titles is there; number them")
        for titles in (self.titles, [_parts(title)[0] for title in self.titles]):
            if titles.count(column) == 1:
                return titles.index(column)
            if column in titles:
                raise ValueError("is the title of several columns: give its number")
        close = difflib.get_close_matches(column, self.titles, n=1)
        hint = f"did you mean {close[0]!r}? It has" if close else "it has"
        raise ValueError(f"is no column: {hint} {few(self.titles)}")

    def name(self, place) -> str:
        """What a column is called in a message."""
        return self.titles[place] if self.titles else f"column {place}"

    def unit(self, place) -> str:
        """The unit in the title of a column."""
        return _parts(self.titles[place])[1] if self.titles else ""


def _parts(title):
    """The name and the unit in a title."""
    match = UNIT.fullmatch(title)
    return match.groups() if match else (title, "")


def _split(text, delimiter):
    if delimiter == " ":
        return text.split()
    return [entry.strip() for entry in tables.entries(text, delimiter)]


def _counts(entry, decimal):
    """Whether an entry is a number or a time."""
    return bool(np.isfinite(tables.number(entry, decimal)) or TIME.fullmatch(entry))


def _layout(lines) -> _Layout | None:
    """The layout in which most of what the first rows hold are numbers; None if nothing is one."""
    rows = [k for k, text in enumerate(lines) if text.strip() and text.lstrip()[0] not in MARKS]
    best, found = (0.0, False), None
    for delimiter in DELIMITERS:
        split = [_split(lines[k], delimiter) for k in rows[:LOOKED_AT]]
        width = Counter(map(len, split)).most_common(1)[0][0] if split else 0
        alike = [row for row in split if len(row) == width]
        for decimal in (".", ",")[: 1 + (delimiter != ",")]:
            numbers = np.array([[_counts(entry, decimal) for entry in row] for row in alike])
            filled = np.array([[entry != "" for entry in row] for row in alike])
            share = numbers.sum() / max(filled.sum(), 1) * len(alike) / max(len(split), 1)
            if (share, width > 1) > best:
                best, found = (share, width > 1), (delimiter, decimal, width, numbers.mean(0) > 0.5)
    if found is None:
        return None
    delimiter, decimal, width, numeric = found

    def row(k):
        entries = _split(lines[k].lstrip().lstrip(MARKS), delimiter)
        return [*entries, ""] if len(entries) == width - 1 and not numeric[-1] else entries

    def holds(k):
        pairs = zip(row(k), numeric, strict=False)
        return all(_counts(entry, decimal) for entry, n in pairs if n and entry)

    first = next(k for k in rows if len(row(k)) == width and holds(k))
    above = [k for k in range(first) if lines[k].strip() and len(row(k)) == width]
    plain = [k for k in above if not any(_counts(entry, decimal) for entry in row(k))]
    title = plain[-1] if plain else above[-1] if above else None
    dated = [TIME.fullmatch(entry) is not None for entry in row(first)]
    begin, titles = (first, None) if title is None else (title + 1, row(title))
    return _Layout(delimiter, decimal, width, begin, titles, dated)


def _prepared(lines, table, layout):
    """The rows without comments; blanks between columns as tabs."""
    body = ["" if text.lstrip()[:1] in MARKS else text for text in lines[layout.first :]]
    if layout.delimiter == " ":
        table.delimiter, body = "\t", ["\t".join(text.split()) for text in body]
    return body


def _with_seconds(body, table, clock):
    """The rows with a further column, if the clock shows dates or times: seconds from the first."""
    place = table.places[clock]
    rows = [tables.entries(text, table.delimiter) for text in body]
    texts = [row[place].strip() if len(row) == table.width else "" for row in rows]
    series = pd.Series(texts, dtype=object)
    times = pd.to_datetime(series, format="ISO8601", errors="coerce", utc=True)
    if times.isna().all():
        times = pd.to_timedelta(series, errors="coerce")
    passed = (times - times.min()).dt.total_seconds()
    table.places[clock], table.width = table.width, table.width + 1
    return [
        text and f"{text}{table.delimiter}{f'{t!r}'.replace('.', table.decimal) if t == t else old}"
        for text, t, old in zip(body, passed.tolist(), texts, strict=True)
    ]
