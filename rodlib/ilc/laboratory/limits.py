"""Limits, a lower and a higher number each, and what lies beyond them."""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc import arguments


def checked(name: str, limits) -> tuple[float, float]:
    """A lower and a higher finite number."""
    low, high = arguments.array(name, limits, (2,)).tolist()
    if not low < high:
        raise ValueError(f"{name} = {limits!r} must be a lower and a higher number")
    return low, high


def named_limits(name: str, limits, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """The limits of some of the signals `names`; None says nothing."""
    given = arguments.by_name(name, limits, names)
    return {key: checked(f"{name}[{key!r}]", pair) for key, pair in given.items()}


def beyond(values, limits: tuple[float, float]) -> np.ndarray:
    """Which of the values are lower or higher."""
    low, high = limits
    return (values < low) | (values > high)


def commands_beyond(u, controls: Sequence[str], limits: dict[str, tuple[float, float]]) -> str:
    """What share of the commands u, shape (..., control), actuators do not follow; "" for none."""
    shares = {
        name: beyond(u[..., i], limits[name]).mean()
        for i, name in enumerate(controls)
        if name in limits
    }
    words = ", ".join(f"{name} in {share:.1%}" for name, share in shares.items() if share)
    return words and f"commands were beyond the limits of {words} of all samples"
