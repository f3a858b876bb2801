"""Units are labels, shown and compared as text; only those of time are converted."""

from collections.abc import Mapping, Sequence

from ilctools import arguments

SECONDS = {
    "ns": 1e-9,
    "us": 1e-6,
    "µs": 1e-6,
    "usec": 1e-6,
    "ms": 1e-3,
    "msec": 1e-3,
    "s": 1.0,
    "sec": 1.0,
    "seconds": 1.0,
    "min": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hours": 3600.0,
    "days": 86400.0,
}


def labels(value: Mapping[str, str] | None, signals: Sequence[str]) -> dict[str, str]:
    """The unit of each of the signals, from a dict of some of them; "" if it is not known."""
    units = dict.fromkeys(signals, "") | arguments.by_name("units", value, signals)
    for signal, label in units.items():
        arguments.instance(f"units[{signal!r}]", label, str)
    return units


def by_unit(units: Sequence[str]) -> dict[str, list[int]]:
    """Channels whose signals have the same unit, and so can stand in one sum or picture."""
    return {unit: [i for i, other in enumerate(units) if other == unit] for unit in units}


def with_unit(text: str, unit: str) -> str:
    """A label with its unit behind it, if there is one."""
    return f"{text} ({unit})" if unit else text


def seconds(label: str) -> float:
    """How long a unit of time is; a ValueError for any other."""
    return SECONDS[arguments.choice("unit of time", label, [*SECONDS])]
