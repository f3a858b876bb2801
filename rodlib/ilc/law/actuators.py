"""What the actuators of a loop follow: between a lowest and a highest command, and how fast."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rodlib.ilc import arguments

ROUNDING = 1e-6  # of the width of the limits: no more than a solver rounds


def named_limits(
    name: str, limits, names: Sequence[str], rated: bool = False
) -> dict[str, tuple[float, ...]]:
    """The limits of some of the signals `names`, with a rate, perhaps; None says nothing."""
    found = {}
    for key, given in arguments.by_name(name, limits, names).items():
        called = f"{name}[{key!r}]"
        with_rate = rated and np.shape(given) == (3,)
        low, high, *rate = arguments.array(
            called, given, (3 if with_rate else 2,)
        ).tolist()
        if not low < high:
            raise ValueError(
                f"{called} = {given!r} must be a lower and a higher number"
            )
        found[key] = (
            low,
            high,
            *(arguments.positive(f"{called}[2]", one) for one in rate),
        )
    return found


@dataclass(frozen=True)
class Actuators:
    """What the actuators follow of the commands of a loop, shape (m,) each, infinite if not said.

    Before a trial they are taken to stand wherever its first sample wants them.
    """

    lowest: np.ndarray
    highest: np.ndarray
    step: np.ndarray  # the largest change from one sample to the next

    @classmethod
    def of(cls, name: str, limits, loop) -> "Actuators":
        """Those of a loop, from (lowest, highest) or (lowest, highest, change per s) by name."""
        limits = named_limits(name, limits, loop.commands, rated=True)
        free = (-np.inf, np.inf, np.inf)
        own = [limits.get(name, ()) for name in loop.commands]
        low, high, rate = np.array([(*said, *free[len(said) :]) for said in own]).T
        return cls(low, high, rate * loop.Ts)

    @property
    def rounding(self) -> np.ndarray:
        """What counts as nothing beside the limits."""
        width = self.highest - self.lowest
        return ROUNDING * np.where(np.isfinite(width), width, 1.0)

    def can(self, commands) -> bool:
        """Whether commands, shape (time, m), are followed as they are."""
        return bool(np.all(np.abs(self.follow(commands) - commands) <= self.rounding))

    def next(self, command, before=None) -> np.ndarray:
        """What becomes of one command, after what was applied before it."""
        low, high = self.lowest, self.highest
        if before is not None:
            low, high = (
                np.maximum(low, before - self.step),
                np.minimum(high, before + self.step),
            )
        return np.minimum(np.maximum(command, low), high)

    def follow(self, commands) -> np.ndarray:
        """What becomes of the commands of a trial, shape (..., time, m)."""
        if np.all(np.isinf(self.step)):
            return self.next(commands)
        applied, before = np.empty_like(commands), None
        for p in range(commands.shape[-2]):
            applied[..., p, :] = before = self.next(commands[..., p, :], before)
        return applied
