"""What the metadata of a log say about its columns."""

import json
import reprlib
from dataclasses import dataclass, field

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.laboratory import units as pints
from rodlib.ilc.laboratory.tables import few

FORMAT = "rodlib trial log 2"
SIGNALS = {  # and what the channels of each are; every log has all but the last two
    "reference": "output", "v": "output", "u": "control", "y": "output",
    "delta": "control", "disturbance": "source",
}  # fmt: skip
REQUIRED = [name for name in SIGNALS if name not in ("delta", "disturbance")]
DIFFERENCES = ("v", "delta")  # of two readings, so that the zero of a unit has no part in them
OWN = ("format", "Ts", "signals")  # metadata that are no attributes
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


def layout_of(table, problems):
    """The metadata name the signals, and the columns are called after them."""
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
