"""Limits of commands: what actuators apply, and the projection of v onto the limits.

Section III of the paper has no limits of commands. A projection onto a convex set never increases
the distance of two signals, measured in the norm of the projection. A convergence rate in this norm
therefore also holds if v is projected onto the limits. If the ends of trials are neglected, this
rate is the largest value of sigma_max(W^(1/2) Q (I - L P) W^(-1/2)), where W = P^H P + weight I.
Let d be the difference between v and the v to which learning converges. Each trial multiplies the
root of ||P d||^2 + weight ||d||^2 by this rate or less.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import control
import numpy as np

from ilctools import arguments
from ilctools.law import nearest
from ilctools.law.nearest import Norm, Rows
from ilctools.loop.closed import Loop
from ilctools.models import from_rest

# A solver's rounding may pass the limits by this fraction of their width. The projection keeps this
# distance from the limits, and its commands are then not counted as saturated.
SOLVER_ROUNDING = 1e-6
CUT_OFF = "; the actuators saturated there, and the law learns v within the limits"  # for the law
UNLIMITED = (-np.inf, np.inf)


class LimitsOf(Enum):
    """The source of limits for a law that states no limits; the only value is the rig."""

    RIG = "rig"  # the rig that the law runs on; without a rig there are no limits

    def __repr__(self):
        return "the rig's"


def named_limits(name: str, limits, names: Sequence[str] | None) -> dict[str, tuple[float, float]]:
    """Check limits (low, high) by name.

    If `names` is None, any name is allowed.
    """
    checked = {}
    for key, values in arguments.by_name(name, limits, limits if names is None else names).items():
        low, high = arguments.array(f"{name}[{key!r}]", values, (2,)).tolist()
        if not low < high:
            raise ValueError(
                f"{name}[{key!r}] = {values!r} must be two numbers, the lower limit first"
            )
        checked[key] = low, high
    return checked


@dataclass(frozen=True)
class Actuators:
    """The limits of the actuators of a loop, and the commands that they apply.

    The arrays have the shape (m,). An infinite entry stands for no limit.
    """

    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, limits: dict[str, tuple[float, float]], loop: Loop) -> "Actuators":
        """Make the actuators of a loop from checked limits, by the names of its commands."""
        return cls(*np.transpose([limits.get(name, UNLIMITED) for name in loop.commands]))

    @property
    def width(self) -> np.ndarray:
        """Difference of the highest and the lowest command, or one if a limit is infinite.

        A solver's rounding is measured relative to this difference.
        """
        width = self.highest - self.lowest
        return np.where(np.isfinite(width), width, 1.0)

    def can(self, commands) -> bool:
        """Whether commands (..., m) are applied unchanged, up to rounding."""
        return np.allclose(self.follow(commands), commands, 0, SOLVER_ROUNDING * self.width)

    def follow(self, commands) -> np.ndarray:
        """Saturate commands, shape (..., m)."""
        return np.clip(commands, self.lowest, self.highest)

    def room(self, commands) -> tuple[np.ndarray, np.ndarray]:
        """Return how far commands may fall and rise, less a margin for the rounding of a solver."""
        margin = SOLVER_ROUNDING * self.width
        return self.lowest + margin - commands, self.highest - margin - commands


def commands_beyond(u, controls: Sequence[str], limits: dict[str, tuple[float, float]]) -> str:
    """Say in which share of the samples the commands u exceed limits.

    If no command exceeds a limit, return an empty text.
    """
    words = []
    for i, name in enumerate(controls):
        low, high = limits.get(name, UNLIMITED)
        share = np.mean((u[..., i] < low) | (u[..., i] > high))
        if share:
            words.append(f"{name} in {share:.1%}")
    words = ", ".join(words)
    return words and f"commands were beyond the limits of {words} of all samples"


def check_solver(loop: Loop) -> None:
    """If the solver is not installed, refuse to learn within limits before any trial is run."""
    if loop.P_v is not None and nearest.piqp is None:
        raise ImportError(
            "limits of a law need the package piqp: install it, by pip install piqp, or leave "
            "the limits out, by Law(..., limits={})"
        )


def command_model(loop: Loop) -> control.StateSpace:
    """Return the model from v to the commands, u = K x + N v.

    If P is unknown, the command u is the input w.
    """
    P = loop.P_v
    if P is None:
        m = len(loop.learned)
        N = loop.w(np.zeros((m, len(loop.outputs))), np.eye(m)).T
        return control.ss([], np.zeros((0, m)), np.zeros((len(N), 0)), N, loop.Ts)
    K, N = loop.feedback()
    return control.ss(P.A, P.B, K, N, P.dt)


def commands_after(loop: Loop, applied, change, reference_change) -> np.ndarray:
    """Predict the commands of the next trial, (time, commands), from the commands `applied`.

    From the last trial to the next, v changes by `change`, shape (time, m). The reference changes
    by `reference_change`, shape (time, p).
    """
    if loop.one_for_one:
        change = change + reference_change
    else:
        applied = applied + loop.w(reference_change, 0 * change)
    return applied + from_rest(command_model(loop), change)


def projected(
    loop: Loop, actuators: Actuators, target, commands, norm: Norm, rest: int
) -> np.ndarray:
    """Find the v nearest to `target` among all v whose commands are within the limits.

    The array `commands` holds the commands that `target` asks for, (time, commands). The module
    :mod:`.nearest` solves the program. If the loop has no P, the commands are clipped instead. In
    the rest, `target` is zero and stays zero.
    """
    samples, applicable = len(target), target.copy()
    active = samples - rest
    u = commands[:active]
    followed = actuators.follow(u)
    if loop.P_v is None:
        applicable[:active] = loop.realised(target[:active], u, followed)
    elif not actuators.can(u):
        rows, beyond = Rows(*loop.feedback(), *actuators.room(u)), np.abs(followed - u).max()
        applicable[:active] += nearest.nearest(loop.P_v, norm, samples, active, rows, beyond)
    return applicable
