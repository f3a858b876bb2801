"""Limits, a lower and a higher number each, and what lies beyond them."""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc import arguments


def named_limits(name: str, limits, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """The limits of some of the signals `names`; None says nothing."""
    found = {}
    for key, pair in arguments.by_name(name, limits, names).items():
        low, high = arguments.array(f"{name}[{key!r}]", pair, (2,)).tolist()
        if not low < high:
            raise ValueError(f"{name}[{key!r}] = {pair!r} must be a lower and a higher number")
        found[key] = low, high
    return found


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
