"""Limits of the commands: what actuators make of them, and the law (23) projected onto them.

Section III has no limits. A projection onto a convex set brings no two signals further apart, in
its own norm, so that a rate in that norm holds within the limits, too. Of trials without ends it is
the largest sigma_max(W^(1/2) Q (I - L P) W^(-1/2)), W = P^H P + weight I: by that factor the root
of ||P d||^2 + weight ||d||^2 shrinks at least, d the distance of v from its limit. The program has
the stages of the loop, one for each sample; PIQP solves it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import sparse

from ilctools import arguments
from ilctools.loop.closed import Loop
from ilctools.models import balanced, dynamics_on_trial, on_trial, state_sequence

try:
    import piqp
except ImportError:  # which not every platform has
    piqp = None

# Of the width of the limits: by so much a solver's rounding may pass them. The projection stays
# inside by it, so that its commands are not counted as cut off.
SOLVER_ROUNDING = 1e-6
# of PIQP's systems: with its own 1e-10 rounding may keep it from an end
LEAST_REGULARISATION = 1e-8
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
    if loop.P_v is not None and piqp is None:
        raise ImportError(
            "limits of a law need the package piqp: install it, by pip install piqp, or leave the "
            "limits out, Law(..., limits={})"
        )


def projected(
    loop: Loop, actuators: Actuators, v, applied, target, weight: float, rest: int
) -> np.ndarray:
    """Of all v whose commands can be applied, the nearest to `target`, see :func:`_nearest`.

    `applied` are the commands of a trial with the signal `v`. Without P commands are cut off.
    """
    active, change = len(v) - rest, target - v
    applicable = np.zeros_like(v)
    P = loop.P_v
    if P is None:
        no_reference = np.zeros((len(v), len(loop.outputs)))
        u = applied + loop.w(no_reference, change)
        applicable[:active] = loop.realised(target, u, actuators.follow(u))[:active]
        return applicable
    K, N = loop.feedback()
    x = state_sequence(P.A, change @ P.B.T, np.zeros(P.nstates))
    u = (applied + x @ K.T + change @ N.T)[:active]  # the commands of the target
    if actuators.can(u):
        return target
    applicable[:active] = target[:active] + _nearest(loop, actuators, u, weight, len(v))
    return applicable


def _nearest(loop, actuators, u, weight, samples):
    """The least change z, (active, m), of a target whose commands would be u, (active, commands).

    minimise    sum_p ||y(p)||^2 + weight ||z(p)||^2,  y = C x + D z,  in all samples
    subject to  x(p+1) = A x(p) + B z(p),  x(0) = 0,   z(p) = 0 in the rest, p >= active
                lowest <= u + K x + N z <= highest
    """
    cost, dynamics, commands = _program(loop, weight, samples, len(u))
    margin = SOLVER_ROUNDING * actuators.width  # for the solver's rounding
    # The solver's tolerances are absolute: in units of what is beyond the limits, z costing one.
    size = np.abs(actuators.follow(u) - u).max()
    low = (actuators.lowest + margin - u).ravel() / size
    high = (actuators.highest - margin - u).ravel() / size
    moved = np.diff(commands.indptr) > 0  # by v; others are cut off if they must be
    limited = moved & (np.isfinite(low) | np.isfinite(high))

    solver = piqp.SparseSolver()
    solver.settings.reg_lower_limit = LEAST_REGULARISATION
    solver.setup(
        cost.tocsc(), np.zeros(cost.shape[0]), dynamics, np.zeros(dynamics.shape[0]),
        commands[limited].tocsc(), low[limited], high[limited],
    )  # fmt: skip
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise RuntimeError(
            f"the solver PIQP has found no v within the limits, {status}: are they very narrow, or "
            "the loop's signals of very different sizes?"
        )
    change = solver.result.x[-len(u) * loop.P_v.ninputs :]
    return size * change.reshape(len(u), -1)


def _program(loop, weight, samples, active):
    """Of all x, then of all z before the rest: the cost / weight, the dynamics, the commands."""
    P, (K, N) = loop.P_v, loop.feedback()
    n, p, m = P.nstates, P.noutputs, P.ninputs
    A, B, CK = balanced(P, K)  # else feasible programs may fail
    moving = slice(samples * n + active * m)  # z is zero in the rest
    y = on_trial(samples, CK[:p], P.D)[:, moving]
    dynamics = dynamics_on_trial(samples, A, B)[:, moving]
    commands = on_trial(samples, CK[p:], N)[: active * len(N), moving].tocsr()
    of_z = np.repeat([0.0, 1.0], [samples * n, active * m])
    return y.T @ y / weight + sparse.diags_array(of_z), dynamics, commands
