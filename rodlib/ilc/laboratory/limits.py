"""Commands that actuators do not follow, and limits beyond which an experiment stops."""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.actuators import named_limits

FAR = 5.0  # times the largest reference that outputs may be beyond all references
WIDE = 100.0  # times what an actuator follows, that commands may span: no loop that works does


def commands_beyond(u, controls: Sequence[str], limits: dict[str, tuple[float, ...]]) -> str:
    """What share of the commands u, shape (..., control), actuators do not follow; "" for none."""
    shares = {}
    for i, name in enumerate(controls):
        if name in limits:
            low, high, *_ = limits[name]
            shares[name] = ((u[..., i] < low) | (u[..., i] > high)).mean()
    words = ", ".join(f"{name} in {share:.1%}" for name, share in shares.items() if share)
    return words and f"commands were beyond the limits of {words} of all samples"


def stop_limits(stop, reference, outputs, units, commands, followed) -> dict:
    """Limits of outputs and commands beyond which an experiment stops, by name.

    `stop` overrides those that follow from the reference (..., time, output), all outputs of a unit
    together, and from what the actuators follow; None stands for no limit.
    """
    size = np.abs(reference).reshape(-1, len(outputs)).max(axis=0)
    limits = {}
    for i, name in enumerate(outputs):
        largest = max(size[j] for j, unit in enumerate(units) if unit == units[i])
        if largest:
            low, high = reference[..., i].min(), reference[..., i].max()
            limits[name] = float(low - FAR * largest), float(high + FAR * largest)
    for name, (low, high, *_) in followed.items():
        middle, half = (low + high) / 2, (high - low) / 2
        if name in commands:
            limits[name] = middle - WIDE * half, middle + WIDE * half
    names = [*outputs, *commands]
    asked = arguments.by_name("stop", stop, names)
    own = named_limits("stop", {n: pair for n, pair in asked.items() if pair is not None}, names)
    return {n: pair for n, pair in (limits | own).items() if asked.get(n, pair) is not None}
