"""Limits of the commands: what actuators make of them, and the law (23) projected onto them.

Section III has no limits. A projection onto a convex set brings no two signals further apart, in
its own norm, so that a rate in that norm holds within the limits, too. Of trials without ends it is
the largest sigma_max(W^(1/2) Q (I - L P) W^(-1/2)), W = P^H P + weight I: by that factor the root
of ||P d||^2 + weight ||d||^2 shrinks at least, d the distance of v from its limit.
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

# Of the width of the limits: by so much a solver's rounding may pass them. The projection stays
# inside by it, so that its commands are not counted as cut off.
SOLVER_ROUNDING = 1e-6
CUT_OFF = ": they were cut off; v is learned within"  # what follows for the law
UNLIMITED = (-np.inf, np.inf)


class LimitsOf(Enum):
    """Who states the limits of a law that states none itself; there is one answer."""

    RIG = "rig"  # the rig that it runs on; without a rig there are no limits

    def __repr__(self):
        return "the rig's"


def stated_limits(limits, names: Sequence[str] | None):
    """Limits of a law, checked: a dict, where {} stands for none at all; None: those of the rig."""
    if limits is None or limits is LimitsOf.RIG:
        return LimitsOf.RIG
    return named_limits("limits", limits, names)


def named_limits(name: str, limits, names: Sequence[str] | None) -> dict[str, tuple[float, float]]:
    """Check limits (low, high) by name; `names` None: any name will do."""
    checked = {}
    for key, values in arguments.by_name(name, limits, limits if names is None else names).items():
        low, high = arguments.array(f"{name}[{key!r}]", values, (2,)).tolist()
        if not low < high:
            raise ValueError(f"{name}[{key!r}] = {values!r} must be a lower and a higher number")
        checked[key] = low, high
    return checked


@dataclass(frozen=True)
class Actuators:
    """What actuators make of the commands of a loop; arrays of shape (m,), infinite: no limit."""

    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, limits: dict[str, tuple[float, float]], loop: Loop) -> "Actuators":
        """Those of a loop, from limits by the names of its commands, which were checked."""
        return cls(*np.transpose([limits.get(name, UNLIMITED) for name in loop.commands]))

    @property
    def width(self) -> np.ndarray:
        """From the lowest to the highest command, what rounding is relative to; one if infinite."""
        width = self.highest - self.lowest
        return np.where(np.isfinite(width), width, 1.0)

    def can(self, commands) -> bool:
        """Whether commands (..., m) are applied as they are, but for rounding."""
        return np.allclose(self.follow(commands), commands, 0, SOLVER_ROUNDING * self.width)

    def follow(self, commands) -> np.ndarray:
        """What is applied of commands, shape (..., m)."""
        return np.clip(commands, self.lowest, self.highest)

    def room(self, commands) -> tuple[np.ndarray, np.ndarray]:
        """By how much commands may change, low and high, but for what a solver rounds."""
        margin = SOLVER_ROUNDING * self.width
        return self.lowest + margin - commands, self.highest - margin - commands


def commands_beyond(u, controls: Sequence[str], limits: dict[str, tuple[float, float]]) -> str:
    """What share of the commands u, shape (..., control), actuators do not follow; "" for none."""
    words = []
    for i, name in enumerate(controls):
        low, high = limits.get(name, UNLIMITED)
        share = np.mean((u[..., i] < low) | (u[..., i] > high))
        if share:
            words.append(f"{name} in {share:.1%}")
    words = ", ".join(words)
    return words and f"commands were beyond the limits of {words} of all samples"


def check_solver(loop: Loop) -> None:
    """Refuse to learn within limits, before any trial, where there is no solver for it."""
    if loop.P_v is not None and nearest.piqp is None:
        raise ImportError(
            "limits of a law need the package piqp: install it, by pip install piqp, or leave the "
            "limits out, Law(..., limits={})"
        )


def command_model(loop: Loop) -> control.StateSpace:
    """From v to the commands, u = K x + N v; of a loop without P they are its inputs w."""
    P = loop.P_v
    if P is None:
        m = len(loop.learned)
        N = loop.w(np.zeros((m, len(loop.outputs))), np.eye(m)).T
        return control.ss([], np.zeros((0, m)), np.zeros((len(N), 0)), N, loop.Ts)
    K, N = loop.feedback()
    return control.ss(P.A, P.B, K, N, P.dt)


def commands_after(loop: Loop, applied, change, reference_change) -> np.ndarray:
    """The commands of a trial, (time, commands), after one in which `applied` were applied.

    Between them v changes by `change`, (time, m), and the reference by (time, p).
    """
    if loop.one_for_one:
        change = change + reference_change
    else:
        applied = applied + loop.w(reference_change, 0 * change)
    return applied + from_rest(command_model(loop), change)


def projected(
    loop: Loop, actuators: Actuators, v, target, commands, norm: Norm, rest: int
) -> np.ndarray:
    """Of all v whose commands can be applied, the nearest to `target`, see :mod:`.nearest`.

    `commands` are those of `target`, (time, commands). Without P they are cut off.
    """
    active, applicable = len(v) - rest, np.zeros_like(v)
    if loop.P_v is None:
        followed = actuators.follow(commands)
        applicable[:active] = loop.realised(target, commands, followed)[:active]
        return applicable
    u = commands[:active]
    if actuators.can(u):
        return target
    beyond = np.abs(actuators.follow(u) - u).max()
    rows = Rows(*loop.feedback(), *actuators.room(u))
    change = nearest.nearest(loop.P_v, norm, len(v), active, [rows], beyond)
    applicable[:active] = target[:active] + change
    return applicable
