"""Units as words: understood, compared and converted by pint.

A unit with a zero of its own, such as degC, is that of a reading; K is that of a difference of
temperatures, here as in the paper. A log does not say which zero its kelvins count from, so the
two are never converted into each other; delta_degC and K are.
"""

import re
from functools import cache

from rodlib.ilc import arguments

# What is a unit to look at. pint also takes sums, numbers that come to 1, and signs to pass over.
NAME = r"(?:[^\W\d_]\w*+|Δ?°\w*+|[%‰])"
POWER = r"(?:(?:\*\*|\^)-?[0-9](?:\.[0-9]+)?|⁻?[¹²³⁴-⁹])?"
FACTOR = rf"\(*{NAME}{POWER}(?:\){POWER})*"
PLAIN = re.compile(rf"(?:(?:1 ?/ ?)?{FACTOR}(?: ?[*/·⋅ ] ?{FACTOR})*)?")


@cache
def _registry():
    import pint  # here, because its definitions take long to read

    return pint.UnitRegistry()


def unit(name: str, text):
    """The unit of `name` that `text` stands for; a ValueError if pint knows none."""
    arguments.instance(f"unit of {name}", text, str)
    try:
        if not PLAIN.fullmatch(text):
            raise ValueError(text)
        return _registry().Unit(text)
    except Exception:  # pint raises whatever its parser comes across
        raise ValueError(
            f"unit {text!r} of {name} is not understood: write it as pint does, such as 'K', "
            "'degC', 'mm/s', 'l/min', or '' for none"
        ) from None


def conversion(name: str, source: str, target: str, difference: bool) -> tuple[float, float]:
    """How numbers in `source` become numbers in `target`.

    Parameters
    ----------
    name : str
        Of the signal, for the message.
    source, target : str
    difference : bool
        Of a difference between two readings, which knows no zero.

    Returns
    -------
    factor, offset : float

    Raises
    ------
    ValueError
        If a unit is not understood, or they do not measure the same thing from the same zero.
    """
    a, b = unit(name, source), unit(name, target)
    if a == b:
        return 1.0, 0.0
    if a.dimensionality != b.dimensionality:
        raise ValueError(f"unit {source!r} of {name} cannot be converted to {target!r}")
    if _zero(a) != 0 or _zero(b) != 0:
        if _zero(a) == 0 or _zero(b) == 0:
            raise ValueError(
                f"unit {source!r} of {name} cannot be converted to {target!r}: one counts from a "
                "zero of its own, the other is that of a difference"
            )
        zero = _convert(0.0, a, b)
        return _convert(1.0, a, b) - zero, 0.0 if difference else zero
    return _convert(1.0, a, b), 0.0


def _convert(number, source, target):
    return float(_registry().Quantity(number, source).to(target).magnitude)


def _zero(unit):
    return _registry().Quantity(0.0, unit).to_root_units().magnitude
