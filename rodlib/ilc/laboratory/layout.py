"""What the metadata of a log say about its columns, in both formats."""

import json
import re
import reprlib
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.laboratory import units as pints
from rodlib.ilc.laboratory.tables import few

FORMAT, FORMER = "rodlib trial log 2", "rodlib trial log 1"
SIGNALS = {  # and what the channels of each are; every log has all but the last two
    "reference": "output", "v": "output", "u": "control", "y": "output",
    "delta": "control", "disturbance": "source",
}  # fmt: skip
REQUIRED = [name for name in SIGNALS if name not in ("delta", "disturbance")]
DIFFERENCES = ("v", "delta")  # of two readings, so that the zero of a unit has no part in them
ROLES = {"output": "outputs", "control": "controls", "source": "disturbances"}  # in the metadata


@dataclass(frozen=True)
class Column:
    """A column of the table: what its numbers are."""

    title: str
    signal: str
    name: str  # of the plant's signal
    unit: str  # in the file
    limits: tuple[float, float] = (-np.inf, np.inf)  # what is plausible, in the unit of the file


@dataclass
class Layout:
    """What the metadata and the header say about the table."""

    names: dict[str, list[str]] = field(default_factory=lambda: {role: [] for role in ROLES})
    columns: list[Column] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)  # to be read in, by name
    time: str | None = None  # unit of the column
    own: tuple[str, ...] = ("format", "Ts", "signals")  # metadata that are no attributes


def layout_of(table, problems):
    """Of format 2: the metadata name the signals, and the columns are called after them."""
    layout = Layout()
    try:
        signals = _object("signals", table.metadata.get("signals", ""))
        for role, key in ROLES.items():
            own = arguments.instance(key, signals.pop(key, {}), dict)
            for name, unit in own.items():
                if layout.units.setdefault(name, unit) != unit:
                    raise ValueError(f"{name!r} has two units")
            layout.names[role] = list(own)
        m = len(layout.names["output"])
        if signals or not m or m != len(layout.names["control"]):
            raise ValueError(
                f"it must have {', '.join(ROLES.values())} and one control for each output"
            )
        optional = any(title.startswith("delta_") for title in table.header)
        titles = {
            f"{signal}_{name}": (signal, name)
            for signal, role in SIGNALS.items()
            for name in layout.names[role]
            if signal != "delta" or optional
        }
        limits = limits_of(table.metadata.get("limits", "{}"), titles)
    except (TypeError, ValueError) as error:
        problems.append(f"metadata: signals or limits cannot be understood: {error}")
        return layout
    for name, unit in layout.units.items():
        try:
            pints.unit(name, unit)
        except ValueError as error:
            problems.append(f"metadata: {error}")
    for title, (signal, name) in titles.items():
        low, high = limits[title]
        layout.columns.append(Column(title, signal, name, layout.units[name], (low, high)))
    return layout


def former_layout_of(table, problems):
    """Of format 1: the rod's, in K and W, with a unit for each column."""
    pairs = [part.split() for part in table.metadata.get("units", "").split(";")]
    stated = {pair[0]: pair[1] for pair in pairs if len(pair) == 2}
    for title in stated:
        if [pair[0] for pair in pairs if pair].count(title) > 1:
            problems.append(f"metadata: units names the unit of {title!r} twice")
    layout = Layout(time=stated.get("time"), own=("format", "Ts", "units"))
    channels = next(i for i in count(1) if f"y{i + 1}" not in table.header)
    sources = [title for title in table.header if re.fullmatch(r"theta_a|Q[0-9]{1,9}", title)]
    layout.names = {
        "output": [f"y{i + 1}" for i in range(channels)],
        "control": [f"u{i + 1}" for i in range(channels)],
        "source": sources,
    }
    if "time" in table.header and "time" not in stated:
        problems.append("metadata: units does not name the unit of 'time'")
    optional = any(title.startswith("delta") for title in table.header)
    for signal, role in SIGNALS.items():
        for index, name in enumerate(layout.names[role]):
            title = name if role == "source" else f"{signal}{index + 1}"
            if signal == "delta" and not optional:
                continue
            flow = role == "control" or name.startswith("Q")
            unit, size = ("W", 1e4) if flow else ("K", 500.0)
            layout.units[name] = unit
            factor = 1.0
            if title in table.header and title not in stated:
                problems.append(f"metadata: units does not name the unit of {title!r}")
            elif title in stated:
                try:
                    factor, _ = pints.conversion(title, stated[title], unit, False)
                except ValueError as error:
                    problems.append(f"metadata: {error}")
            limits = (-size / factor, size / factor)
            layout.columns.append(Column(title, signal, name, stated.get(title, unit), limits))
    return layout


def limits_of(text, titles):
    """The limits of plausibility of all columns, those that are stated and none."""
    stated = _object("limits", text)
    unknown = [title for title in stated if title not in titles]
    if unknown:
        raise ValueError(f"limits are stated for {few(unknown)}, which are no columns")
    limits = dict.fromkeys(titles, (-np.inf, np.inf))
    for title, limit in stated.items():
        name = f"limits of {title!r} = {reprlib.repr(limit)}"
        low, high = arguments.array(name, limit, (2,)).tolist()
        if not low < high:
            raise ValueError(f"{name} must be two numbers, [low, high]")
        limits[title] = (low, high)
    return limits


def _object(name, text):
    """A JSON object of the metadata."""
    try:
        return arguments.instance(name, read_json(text), dict)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name} must be a JSON object: {error}") from None


def read_json(text: str):
    """What JSON says; a ValueError if it says anything twice, or what JSON has no word for."""
    return json.loads(text, object_pairs_hook=_once, parse_constant=_refuse_constant)


def _once(pairs):
    if len(pairs) > len(dict(pairs)):
        raise ValueError("a name stands there twice")
    return dict(pairs)


def _refuse_constant(word):
    raise ValueError(f"{word} is no number")
