"""Checks of arguments at entry points, which raise one clear error before any work begins.

A function returns a valid argument in the type that later code expects. If the argument is not
valid, the function raises a ValueError that names the argument, its value, and what the argument
must be.
"""

import os
import re
import reprlib
from collections.abc import Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import get_args

import control
import numpy as np

CIRCLE = 1 - 1e-9  # a pole of larger modulus counts as a pole on the unit circle
PRINTABLE = r"[^\x00-\x1f\x7f-\x9f]+"  # no control characters, which a terminal would obey
TINIEST = 1e-130  # smallest numbers whose squares, and their sums, stay within doubles (1e-308)
LATE = 1e-3  # tolerance for rounded times and frequencies, relative to Ts or Nyquist
ROLES = {  # coordinates that name signals, and the name of all these signals in a log
    "output": "outputs",
    "control": "controls",
    "source": "disturbances",
    "sensor": "measured",
    "input": "inputs",
}


def number(
    name: str, value, what: str, low=-np.inf, high=np.inf, *, least=-np.inf, most=np.inf
) -> float:
    """Check that a number is finite and lies in a range.

    The range is ``low < value < high`` and ``least <= value <= most``. The words in `what` describe
    this range in the error message.
    """
    plain = isinstance(value, Real) and not isinstance(value, bool)
    if not (plain and low < value < high and least <= value <= most):
        raise ValueError(f"{name} = {reprlib.repr(value)} must be {what}")
    return float(value)


def not_negative(name: str, value, what: str = "a number, 0 or more") -> float:
    """Check that a value is a finite number, zero or above."""
    return number(name, value, what, least=0)


def positive(name: str, value, what: str = "a positive number") -> float:
    """Check that a value is a finite number above zero."""
    return number(name, value, what, low=0)


def sampling_period(name: str, value) -> float:
    """Check that a value is a sampling period in seconds, a positive number."""
    return positive(name, value, "a positive sampling period in seconds")


def whole(name: str, value, low: int, high: int | None = None) -> int:
    """Check that a value is a whole number from `low` to `high`.

    If `high` is None, there is no upper limit.
    """
    plain = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not plain or value < low or (high is not None and value > high):
        limits = f"{low} or more" if high is None else f"from {low} to {high}"
        raise ValueError(f"{name} = {reprlib.repr(value)} must be a whole number, {limits}")
    return int(value)


def flag(name: str, value) -> bool:
    """Check that a value is True or False.

    Other values that Python treats as true or false, such as 1, are refused.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} = {reprlib.repr(value)} must be True or False")
    return bool(value)


def choice(name: str, value, options: Sequence[str]) -> str:
    """Check that a value is one of the words in `options`."""
    if not (isinstance(value, str) and value in options):
        words = " or ".join(repr(option) for option in options)
        raise ValueError(f"{name} = {reprlib.repr(value)} must be {words}")
    return value


def instance(name: str, value, kind):
    """Check that a value is an instance of a class, or of one class of a union."""
    if not isinstance(value, kind):
        words = " or ".join(each.__name__ for each in get_args(kind) or [kind])
        of_design = f": pass {name}.law() or {name}.filter" if hasattr(value, "certificate") else ""
        raise ValueError(f"{name} = {reprlib.repr(value)} must be a {words}{of_design}")
    return value


def different(name: str, value) -> list[str]:
    """Check that a value is a list of names in which no name occurs twice."""
    listed = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    if not (listed and all(isinstance(n, str) for n in value)) or len({*value}) < len(value):
        raise ValueError(f"{name} = {reprlib.repr(value)} must be a list of different names")
    return list(value)


def by_name(name: str, value, names: Sequence[str]) -> dict:
    """Check that each key of a dict is the name of a signal in `names`.

    If the value is None, an empty dict is returned.
    """
    if not isinstance(value, dict | None):
        raise ValueError(
            f"{name} = {reprlib.repr(value)} must be a dict whose keys are names of signals"
        )
    given = value or {}
    unknown = [key for key in given if key not in names]
    if unknown:
        raise ValueError(
            f"{name} has the keys {reprlib.repr(unknown)}, but its keys must be some of {names}"
        )
    return given


def names_of(signals) -> list[str] | None:
    """Return the names of a table's columns, or of a DataArray's channels.

    If the columns or channels have no names, None is returned.
    """
    if hasattr(signals, "columns"):
        labels = [*signals.columns]
    else:
        roles = *ROLES, *tuple(getattr(signals, "dims", ()))[-1:]
        role = next((r for r in roles if r in getattr(signals, "coords", ())), None)
        labels = [] if role is None else np.atleast_1d(signals[role]).tolist()
    return labels if labels and all(isinstance(label, str) for label in labels) else None


def in_columns(name, signal, shape, names):
    """Return a signal as an array with one column for each name in `names`.

    If the signal itself names its channels, its columns are put in the order of `names`. A signal
    with a single channel may have the shape (time,).
    """
    own, signal = names_of(signal), array(name, signal, (...,))
    if own is not None:
        signal = signal[..., _order(name, own, names)]
    if signal.ndim == len(names) == 1:
        signal = signal[:, None]
    return array(name, signal, shape)


def by_channel(name, value, names):
    """Put labelled numbers, one for each channel, in the order of `names`.

    Numbers without labels are returned as they are.
    """
    own = names_of(value.to_xarray() if hasattr(value, "to_frame") else value)  # of pandas
    return value if own is None else np.asarray(value)[..., _order(name, own, names)]


def _order(name, own, names):
    """Return the index of each name in the list `own`.

    The list `own` holds the names of an array's channels.
    """
    if sorted(own) != sorted(names):
        raise ValueError(
            f"{name} holds the signals {reprlib.repr(own)}, but must hold {[*names]}: rename "
            "them, or pass an array whose columns are in that order"
        )
    return [own.index(label) for label in names]


def labelled_as(value, signal, names):
    """Return a signal with the shape, the order of channels and the labels of `value`.

    The argument `signal` has one column for each name in `names`.
    """
    own = names_of(value)
    if own is None:
        return signal.reshape(np.shape(value))
    labelled = value.astype(float)
    labelled[:] = signal[..., _order("v", names, own)].reshape(value.shape)
    return labelled


def check_times(name: str, times, Ts: float) -> None:
    """Refuse a signal whose times are not Ts apart."""
    steps = np.diff(times)
    if not np.allclose(steps, Ts, rtol=0, atol=LATE * Ts):
        raise ValueError(
            f"{name} has times with steps from {steps.min():.6g} to {steps.max():.6g} s, but "
            f"Ts is {Ts:.6g} s: correct Ts, or resample {name}"
        )


def each_trial(name, signal, trials, samples, names, Ts):
    """Return a signal with the trial as its first axis.

    If one signal is passed for all trials, the signal is repeated for each trial.
    """
    times = getattr(signal, "index", getattr(signal, "time", None))  # of pandas, of xarray
    if times is not None and np.asarray(times).dtype.kind == "f":  # whole numbers count samples
        check_times(name, times, Ts)
    signal = in_columns(name, signal, (...,), names)
    shape = (samples, len(names))
    if signal.ndim > 2:
        shape = (trials, *shape)
    signal = array(name, signal, shape)
    return np.broadcast_to(signal, (trials, *signal.shape[-2:]))


def path(name: str, value) -> Path:
    """Check the path of a file; replace ~ by the home folder of the user."""
    if not isinstance(value, str | PathLike) or not re.fullmatch(PRINTABLE, str(value)):
        raise ValueError(
            f"{name} = {reprlib.repr(value)} must be the path of a file, of printable characters"
        )
    return Path(os.path.expanduser(value))


def state_space(name: str, value) -> control.StateSpace:
    """Check that a value is a state-space model whose matrices are finite."""
    instance(name, value, control.StateSpace)
    for matrix in "ABCD":
        array(f"{name}.{matrix}", getattr(value, matrix), (...,))
    return value


def stable(name: str, poles) -> float:
    """Return the largest modulus of the poles of a discrete-time system.

    If this modulus is 1 or more, the system is refused.
    """
    radius = np.abs(poles).max(initial=0)
    if radius > CIRCLE:
        raise ValueError(
            f"{name} is unstable, because it has a pole of modulus {radius:.6g}, which is 1 or "
            "more: pass a loop that stabilises it, such as the loop of current_trial_loop"
        )
    return radius


def array(name: str, value, shape: Sequence[int | str], dtype: type = float) -> np.ndarray:
    """Convert a value to an array of finite numbers, and check its shape.

    The wanted shape is a tuple such as ``("time", 2)`` or ``(..., "m", "m")``. In the shape, a name
    stands for any size above zero. If a name occurs twice, both sizes must be equal. An Ellipsis at
    the front stands for any number of axes. `dtype` is float or complex. If True occurs among
    numbers, it counts as 1.
    """
    try:
        plain = np.asanyarray(value)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be an array of numbers, but is not: does it have rows of different "
            "lengths, or is it a Dataset?"
        ) from None
    if plain.dtype.kind not in "iufc":
        raise ValueError(f"{name} holds values of type {plain.dtype}, but must hold numbers")
    if plain.dtype.kind == "c" and dtype is float:
        raise ValueError(f"{name} is complex, but must be real")
    dimensions = getattr(value, "dims", ())
    if len(dimensions) > 1 and dimensions[-1] == "time":
        raise ValueError(
            f"{name} has the dimensions {dimensions}: transpose it, so that the channels come last"
        )
    _check_shape(name, plain.shape, tuple(shape))
    result = np.asarray(np.ma.filled(plain.astype(dtype), np.nan))  # what is masked is missing
    finite = np.isfinite(result)
    if not finite.all():
        bad = np.argwhere(~finite)
        first = tuple(bad[0].tolist())
        raise ValueError(
            f"{name} has {len(bad)} values that are not finite; the first of them is at {first}"
        )
    return result


def _check_shape(name, sizes, shape):
    """Refuse an array whose shape `sizes` does not fit the wanted `shape`."""
    wanted = [size for size in shape if size is not Ellipsis]
    has = sizes[len(sizes) - len(wanted) :] if wanted != [*shape] else sizes
    named = dict(zip(wanted, has, strict=False))  # if two sizes have one name, the last size counts
    expected = [max(1, named.get(size, 1)) if isinstance(size, str) else size for size in wanted]
    if [*has] == expected:
        return
    words = ", ".join("..." if size is Ellipsis else str(size) for size in shape)
    words += "," if len(shape) == 1 else ""
    raise ValueError(f"{name} has shape {sizes}, but must have shape ({words})")


def representable(name: str, values, remedy: str) -> None:
    """Refuse numbers whose squares or products leave the range of floating-point numbers."""
    size = np.abs(values).max(initial=0)
    if not (size == 0 or TINIEST <= size <= 1 / TINIEST):
        raise ValueError(
            f"{name} has values of at most {size:.3g}, whose squares floating-point numbers "
            f"cannot represent: pass {name} {remedy}"
        )


def row(name: str, value, dtype: type = float) -> np.ndarray:
    """Check one or more numbers, and return them as an array of shape (n,).

    If `value` is a single number, n is 1.
    """
    return array(name, np.atleast_1d(array(name, value, (...,), dtype)), ("n",), dtype)


def increasing_frequencies(name: str, value, Ts: float) -> np.ndarray:
    """Check that two or more frequencies (rad/s) increase.

    All frequencies must lie between zero and the Nyquist frequency.
    """
    omega = up_to_nyquist(name, array(name, value, ("frequency",)), Ts)
    if len(omega) < 2 or np.any(np.diff(omega) <= 0):
        raise ValueError(
            f"{name}, of shape {omega.shape}, must be a row of increasing frequencies: sort "
            "them, and sort P accordingly"
        )
    return omega


def up_to_nyquist(name: str, omega: np.ndarray, Ts: float) -> np.ndarray:
    """Check that angular frequencies, rad/s, lie between zero and the Nyquist frequency."""
    nyquist = np.pi / Ts
    if omega.min() < 0 or omega.max() > nyquist * (1 + LATE):
        raise ValueError(
            f"{name} spans [{omega.min():.6g}, {omega.max():.6g}] rad/s, but must lie in [0, "
            f"{nyquist:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s: check the "
            f"units of {name} and Ts"
        )
    return np.minimum(omega, nyquist)
