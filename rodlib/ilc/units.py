"""Units are labels, shown and compared as they are; pint says which labels are units."""

from collections.abc import Sequence

from rodlib.ilc import arguments

PLAIN = (
    "",
    "K",
    "degC",
    "W",
    "m",
    "mm",
    "N",
    "V",
    "A",
)  # which pint need not be asked about


def understood(name: str, label):
    """The unit of `name` as pint has it; a ValueError if pint knows none."""
    arguments.instance(f"unit of {name}", label, str)
    import pint  # here, because its definitions take long to read

    try:
        return pint.get_application_registry().Unit(label)
    except Exception:  # pint raises whatever its parser comes across
        raise ValueError(
            f"unit {label!r} of {name} is not understood: write it as pint does, such as 'K', "
            "'degC', 'mm/s', 'l/min', or '' for none"
        ) from None


def is_known(label: str) -> bool:
    """Whether pint knows a unit."""
    try:
        return understood("", label) is not None
    except ValueError:
        return False


def check(name: str, labels: dict[str, str]) -> None:
    """Check the units of signals, a dict by their names; `name` is that of the dict."""
    for signal, label in labels.items():
        arguments.instance(f"{name}[{signal!r}]", label, str)
        if label not in PLAIN:
            try:
                understood(signal, label)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None


def by_unit(units: Sequence[str]) -> dict[str, list[int]]:
    """Channels whose signals have the same unit, and so can stand in one sum or picture."""
    return {
        unit: [i for i, other in enumerate(units) if other == unit] for unit in units
    }


def with_unit(text: str, unit: str) -> str:
    """A label with its unit behind it, if there is one."""
    return f"{text} ({unit})" if unit else text


def seconds(label: str) -> float:
    """How long a unit of time is; a ValueError if it is none."""
    unit = understood("time", label)
    if not unit.is_compatible_with("s"):
        raise ValueError(f"unit {label!r} is none of time")
    return float((1.0 * unit).to("s").magnitude)
