"""How far the actuators of a rig follow, and how often more was asked of them."""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc import arguments


def checked(name: str, limits, actuators: Sequence[str]) -> dict[str, list[float]]:
    """Lowest and highest command that each actuator follows, by name; None says nothing.

    Raises a ValueError that begins with `name` if one is not a lower and a higher finite number, or
    is said of what is none of the `actuators`.
    """
    found = {}
    for key, pair in arguments.by_name(name, limits, actuators).items():
        low, high = arguments.array(f"{name}[{key!r}]", pair, (2,)).tolist()
        if not low < high:
            raise ValueError(f"{name}[{key!r}] = {pair!r} must be a lower and a higher number")
        found[key] = [low, high]
    return found


def beyond(u, controls: Sequence[str], limits: dict[str, list[float]]) -> str:
    """Share of the commands u, shape (..., control), that are beyond each limit; "" for none."""
    shares = {}
    for i, name in enumerate(controls):
        low, high = limits.get(name, (-np.inf, np.inf))
        shares[name] = np.mean((u[..., i] < low) | (u[..., i] > high))
    return ", ".join(f"{name} in {share:.1%}" for name, share in shares.items() if share)
