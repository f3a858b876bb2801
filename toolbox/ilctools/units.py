"""Units of signals: labels that are shown and compared as text, and never converted."""

from collections.abc import Mapping, Sequence

from ilctools import arguments


def labels(value: Mapping[str, str] | None, signals: Sequence[str]) -> dict[str, str]:
    """Return the unit of each signal, from a dict that holds the units of some signals.

    If the unit of a signal is unknown, the unit is "".
    """
    units = dict.fromkeys(signals, "") | arguments.by_name("units", value, signals)
    for signal, label in units.items():
        arguments.instance(f"units[{signal!r}]", label, str)
    return units


def by_unit(units: Sequence[str]) -> dict[str, list[int]]:
    """Group channels by unit: channels of one unit can share a sum or a figure."""
    return {unit: [i for i, other in enumerate(units) if other == unit] for unit in units}


def with_unit(text: str, unit: str) -> str:
    """Append the unit to a label, if there is a unit."""
    return f"{text} ({unit})" if unit else text
