"""Units are labels, shown and compared as text, and never converted."""

from collections.abc import Mapping, Sequence

from ilctools import arguments


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
