"""Limits of the commands: what actuators make of them, and the law (23) projected onto them.

Section III has no limits. A projection onto a convex set brings any two signals closer together, so
that Lemma 1 still holds in the outputs. The program has the stages of the loop, one for each
sample; PIQP solves it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ilctools import arguments
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.models import state_sequence

try:
    import piqp
except ImportError:  # which not every platform has
    piqp = None

ROUNDING = 1e-6  # of the width of the limits: no more than a solver rounds
REGULAR = 1e-8  # of PIQP's systems: with its own 1e-10 rounding may keep it from an end
CUT_OFF = ": they were cut off; v is learned within"  # what follows for the law
WEIGHT = 1e-2  # of ||v||^2 beside ||P v||^2, for what the outputs hardly show


def named_limits(
    name: str, limits, names: Sequence[str] | None, slew: bool = False
) -> dict[str, tuple[float, ...]]:
    """Check limits (low, high[, slew rate per s]) by name; `names` None: any name will do."""
    if names is None:
        names = [*arguments.instance(name, {} if limits is None else limits, dict)]
    checked = {}
    for key, values in arguments.by_name(name, limits, names).items():
        called = f"{name}[{key!r}]"
        size = 3 if slew and np.shape(values) == (3,) else 2
        low, high, *rates = arguments.array(called, values, (size,)).tolist()
        if not low < high:
            raise ValueError(f"{called} = {values!r} must be a lower and a higher number")
        for rate in rates:
            arguments.positive(f"{called}[2]", rate)
        checked[key] = (low, high, *rates)
    return checked


@dataclass(frozen=True)
class Actuators:
    """What actuators make of the commands of a loop; arrays of shape (m,), infinite: no limit.

    Before a trial they are taken to stand wherever its first sample wants them.
    """

    lowest: np.ndarray
    highest: np.ndarray
    step: np.ndarray  # the largest change from one sample to the next

    @classmethod
    def of(cls, limits: dict[str, tuple[float, ...]], loop: Loop) -> "Actuators":
        """Those of a loop, from limits by the names of its commands, which were checked."""
        rows = np.tile([-np.inf, np.inf, np.inf], (len(loop.commands), 1))
        for row, name in zip(rows, loop.commands, strict=True):
            values = limits.get(name, ())
            row[: len(values)] = values
        low, high, slew = rows.T
        return cls(low, high, slew * loop.Ts)

    @cached_property
    def slow(self) -> bool:
        """Whether one of them cannot be anywhere in the next sample."""
        return not np.all(np.isinf(self.step))

    @property
    def rounding(self) -> np.ndarray:
        """How far beyond the limits a command may be, by rounding."""
        width = self.highest - self.lowest
        return ROUNDING * np.where(np.isfinite(width), width, 1.0)

    def can(self, commands, share: float = ROUNDING, before=None) -> bool:
        """Whether commands (..., time, m) are applied as they are, to a share of the width."""
        change = np.abs(self.follow(commands, before) - commands)
        return bool(np.all(change <= share / ROUNDING * self.rounding))

    def next(self, command, before=None) -> np.ndarray:
        """What is applied of one command, after what was applied before it."""
        low, high = self.lowest, self.highest
        if before is not None and self.slow:
            low = np.maximum(low, before - self.step)
            high = np.minimum(high, before + self.step)
        return np.minimum(np.maximum(command, low), high)

    def follow(self, commands, before=None) -> np.ndarray:
        """What is applied of commands in succession, shape (..., time, m)."""
        if not self.slow:
            return self.next(commands)
        applied = np.empty_like(commands)
        for p in range(commands.shape[-2]):
            applied[..., p, :] = before = self.next(commands[..., p, :], before)
        return applied


def commands_beyond(u, controls: Sequence[str], limits: dict[str, tuple[float, ...]]) -> str:
    """What share of the commands u, shape (..., control), actuators do not follow; "" for none."""
    words = []
    for i, name in enumerate(controls):
        low, high, *_ = limits.get(name, (-np.inf, np.inf))
        share = np.mean((u[..., i] < low) | (u[..., i] > high))
        if share:
            words.append(f"{name} in {share:.1%}")
    words = ", ".join(words)
    return words and f"commands were beyond the limits of {words} of all samples"


def check_solver(loop: Loop) -> None:
    """Refuse to learn within limits, before any trial, where there is no solver for it."""
    if loop.P is not None and piqp is None:
        raise ImportError(
            "limits of a law need the package piqp: install it, by pip install piqp, or leave the "
            "limits out, Law(..., limits={})"
        )


def realised(loop: Loop, v, u, applied) -> np.ndarray:
    """The v with which the loop would have asked for what was applied, instead of u.

    Where the observer (16) is informed of what was applied, a trial cut off by actuators is exactly
    a trial with this v without limits, whatever the plant, since u = N w - K_s x-hat - delta, (18).
    """
    cut = applied - u
    if isinstance(loop, ClosedLoop):
        return v + cut
    try:
        return v + cut @ np.linalg.inv(loop.N).T
    except np.linalg.LinAlgError:
        raise ValueError("loop.N is singular: w does not follow from its commands") from None


def nearest(
    loop: Loop, actuators: Actuators, v, applied, target, weight: float, rest: int
) -> np.ndarray:
    """Of all v whose commands can be applied, the nearest to `target`.

    It minimises ||P (v - target)||^2 + weight ||v - target||^2; `applied` are the commands of a
    trial with the signal `v`.
    """
    active = len(v) - rest
    if loop.P is None:
        applicable = v + actuators.follow(applied + target - v) - applied
        applicable[active:] = 0
        return applicable
    P, m, n = loop.P, len(loop.outputs), loop.P.nstates
    if isinstance(loop, ClosedLoop):  # u = K x + N w
        K, N = np.zeros((m, n)), np.eye(m)
    else:
        K, N = -loop.Ks, loop.N
    change = target - v
    x = state_sequence(P.A, change @ P.B.T, np.zeros(n))
    if actuators.can((applied + x @ K.T + change @ N.T)[:active]):
        return target

    # In each sample the unknowns are the states x and the change of the commands; V times these
    # is the change of v.
    X, S = np.eye(n, n + m), np.eye(m, n + m, n)
    V = np.linalg.solve(N, S - K @ X)
    C, following = P.C @ X + P.D @ V, P.A @ X + P.B @ V
    now, before = sparse.eye_array(len(v)), sparse.eye_array(len(v), k=-1)
    square = C.T @ C + weight * V.T @ V
    linear = -np.hstack([x, x @ K.T + change @ N.T]) @ square
    dynamics = sparse.kron(now, X) - sparse.kron(before, following)
    at_rest = sparse.kron(now, V).tocsr()[active * m :]
    equalities = sparse.vstack([dynamics, at_rest])
    right = np.append(np.zeros(dynamics.shape[0]), -v[active:])

    # How far commands, and their steps, may go from those applied, before the rest.
    applied, step = applied[:active], actuators.step[None, :]
    margin = np.minimum(actuators.rounding, step / 4)
    high = np.full((len(v), n + m), np.inf)
    low = -high
    low[:active, n:] = actuators.lowest + margin - applied
    high[:active, n:] = actuators.highest - margin - applied
    moved = np.diff(applied, axis=0)
    step_low = (margin - step - moved).ravel()
    step_high = (step - margin - moved).ravel()
    limited = np.isfinite(step_high)
    steps = sparse.kron(now - before, S).tocsr()[m : active * m][limited]

    solver = piqp.SparseSolver()
    solver.settings.reg_lower_limit = REGULAR
    solver.setup(
        sparse.csc_matrix(sparse.kron(now, square)), linear.ravel(),
        sparse.csc_matrix(equalities), right,
        sparse.csc_matrix(steps), step_low[limited], step_high[limited],
        low.ravel(), high.ravel(),
    )  # fmt: skip
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise RuntimeError(
            f"the solver PIQP has found no v within the limits, {status}: are they very narrow, or "
            "the loop's signals of very different sizes?"
        )
    applicable = v + solver.result.x.reshape(len(v), -1) @ V.T
    applicable[active:] = 0
    return applicable
