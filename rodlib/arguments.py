"""Arguments are checked at the door, and here is how: one clear error, before any work.

Each function returns the argument in the type that the code behind the door expects, or raises a
ValueError that names the argument, its value and what it must be.
"""

from collections.abc import Sequence
from numbers import Real

import numpy as np


def number(name: str, value, what: str, low=-np.inf, high=np.inf) -> float:
    """A finite real number strictly between `low` and `high`; `what` says so in the message."""
    plain = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    if not (plain and np.isfinite(value) and low < value < high):
        raise ValueError(f"{name} = {value!r} must be {what}")
    return float(value)


def positive(name: str, value, what: str = "a positive number") -> float:
    """A finite number above zero."""
    return number(name, value, what, low=0)


def sampling_period(name: str, value) -> float:
    """A sampling period in seconds."""
    return positive(name, value, "a positive sampling period in seconds")


def whole(name: str, value, low: int, high: int | None = None) -> int:
    """A whole number, at least `low` and at most `high`."""
    plain = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not plain or value < low or (high is not None and value > high):
        limits = f"{low} or more" if high is None else f"from {low} to {high}"
        raise ValueError(f"{name} = {value!r} must be a whole number, {limits}")
    return int(value)


def flag(name: str, value) -> bool:
    """True or False, and not something that merely counts as one of them."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} = {value!r} must be True or False")
    return bool(value)


def choice(name: str, value, options: Sequence[str]) -> str:
    """One of a few words."""
    if not (isinstance(value, str) and value in options):
        words = " or ".join(repr(option) for option in options)
        raise ValueError(f"{name} = {value!r} must be {words}")
    return value


def array(name: str, value, shape: Sequence[int | str], dtype: type = float) -> np.ndarray:
    """An array of finite numbers.

    Parameters
    ----------
    name : str
        Of the argument, for the message.
    value : array_like
    shape : sequence of int or str
        Sizes that are given, and names for those that are not, such as ``("time", 2)``; a name
        stands for any size above zero. An Ellipsis in front stands for any number of axes.
    dtype : type
        float, or complex.

    Returns
    -------
    ndarray
        A new array of that type.

    Raises
    ------
    ValueError
        If the value has another shape, holds anything but numbers, masked entries, an imaginary
        part where real numbers belong, or values that are not finite.
    """
    try:
        plain = np.asanyarray(value)
    except ValueError:
        raise ValueError(f"{name} has rows of different lengths: it must be an array") from None
    if plain.dtype.kind not in "iufc":
        raise ValueError(f"{name} holds values of type {plain.dtype}, but must hold numbers")
    if plain.dtype.kind == "c" and dtype is float:
        raise ValueError(f"{name} is complex, but must be real")
    if np.ma.is_masked(plain):
        count = np.ma.count_masked(plain)
        raise ValueError(f"{name} has {count} masked values: fill the gaps, or leave them out")
    wanted = tuple(shape)
    sizes = plain.shape
    if wanted and wanted[0] is Ellipsis:
        wanted, sizes = wanted[1:], sizes[max(0, plain.ndim - len(shape) + 1) :]
    fits = len(sizes) == len(wanted) and all(
        have > 0 if isinstance(want, str) else have == want
        for want, have in zip(wanted, sizes, strict=True)
    )
    if not fits:
        words = ", ".join("..." if size is Ellipsis else str(size) for size in shape)
        words += "," if len(shape) == 1 else ""
        raise ValueError(f"{name} has shape {plain.shape}, but must have shape ({words})")
    result = np.array(plain, dtype=dtype)
    bad = np.argwhere(~np.isfinite(result))
    if bad.size:
        where = tuple(int(i) for i in bad[0])
        raise ValueError(f"{name} has {len(bad)} values that are not finite, the first at {where}")
    return result
