"""The law (23) within what the actuators follow: v_{k+1} is projected onto what they can do.

Section III has no limits. A projection onto a convex set makes no two signals more distant, so that
Lemma 1 still holds in the outputs. The program has the stages of the loop, one for each sample;
PIQP solves it.
"""

import numpy as np
import piqp
from scipy import sparse

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningOperator, ZeroPhaseButterworth, update
from rodlib.ilc.law.actuators import Actuators
from rodlib.ilc.loop.closed import ClosedLoop, Loop, check_loop
from rodlib.ilc.models import state_sequence

WEIGHT = 1e-2  # of ||v||^2 beside ||P v||^2: what outputs hardly show stays as the law has it


def update_within(
    v,
    e,
    u,
    Q: ZeroPhaseButterworth,
    L: LearningOperator,
    loop: Loop,
    limits,
    *,
    applied=None,
    rest: int = 0,
    step: float = 1.0,
) -> np.ndarray:
    """Compute the next trial's ILC signal by the law (23), within what the actuators follow.

    Of all v whose commands stay within the limits, the one that is nearest to the v* of
    :func:`rodlib.update`: that minimises ||P (v - v*)||^2 + weight ||v - v*||^2, by the model of
    the loop, from the commands that were applied. The weight is 0.01, or that of an L which has
    one: with that of :class:`rodlib.NormOptimal` and a Q near one this is constrained norm-optimal
    learning, whose predicted error cannot rise.

    Parameters
    ----------
    v, e, Q, L, rest, step :
        As for :func:`rodlib.update`. What the loop asks for in the rest, where v is zero, is left
        out of account.
    u : array_like, shape (time, m)
        Commands that the controller asked for in it: of a CurrentTrialLoop its controls, of a
        ClosedLoop w = reference + v.
    loop : CurrentTrialLoop or ClosedLoop
        Of a ClosedLoop without P the commands are cut off instead.
    limits : dict
        Lowest and highest command, by name (``loop.commands``), in their units; and third, if need
        be, the largest change per second.
    applied : array_like, shape (time, m), optional
        What the actuators made of u, and the observer was told. Default: u, cut off at the limits.

    Returns
    -------
    ndarray, of the shape of v

    Raises
    ------
    RuntimeError
        If the solver fails.
    """
    actuators = Actuators.of("limits", limits, check_loop(loop))
    single = v
    v = arguments.in_columns("v", v, ("time", len(loop.outputs)), loop.outputs)
    e = arguments.in_columns("e", e, v.shape, loop.outputs)
    u = arguments.in_columns("u", u, v.shape, loop.commands)
    applied = actuators.follow(u) if applied is None else applied
    applied = arguments.in_columns("applied", applied, v.shape, loop.commands)
    following = projected(v, e, (u, applied), Q, L, loop, actuators, rest, step)
    return following.reshape(np.shape(single))


def commands_of(loop: Loop, actuators: Actuators | None, w, u=None, applied=None):
    """What was asked for, u or of a ClosedLoop w, and what was applied of it, if it has limits."""
    if actuators is None:
        return None
    asked = w if isinstance(loop, ClosedLoop) else u
    return asked, actuators.follow(asked) if applied is None else applied


def projected(v, e, commands, Q, L, loop, actuators, rest, step):
    """As :func:`update_within`, of what was checked; the law alone where there are no limits."""
    if actuators is None:
        return update(v, e, Q, L, rest, step)
    v, applied = realised(loop, v, *commands), commands[1]
    wanted = update(v, e, Q, L, rest, step)
    return _nearest(
        loop, actuators, v, applied, wanted, getattr(L, "weight", WEIGHT), rest
    )


def realised(loop: Loop, v, u, applied) -> np.ndarray:
    """The v with which the loop would have asked for what was applied, instead of u.

    Where the observer (16) is told what was applied, a trial cut off by actuators is exactly one
    with this v that is not, whatever the plant, since u = N w - K_s x-hat - delta, (18).
    """
    cut = applied - u
    if isinstance(loop, ClosedLoop):
        return v + cut
    try:
        return v + cut @ np.linalg.inv(loop.N).T
    except np.linalg.LinAlgError:
        raise ValueError(
            "loop.N is singular: its commands do not tell what w would do"
        ) from None


def _nearest(loop, actuators, v, applied, wanted, weight, rest):
    """Of all v whose commands can be followed, the nearest to `wanted`; v made `applied`."""
    if loop.P is None:
        v = v + actuators.follow(applied + wanted - v) - applied
        return np.append(v[: len(v) - rest], np.zeros((rest, v.shape[1])), axis=0)
    P, m = loop.P, len(loop.outputs)
    own = isinstance(loop, ClosedLoop)
    K, N = (
        (np.zeros((m, P.nstates)), np.eye(m)) if own else (-loop.Ks, loop.N)
    )  # from w to u
    active = len(v) - rest
    change = wanted - v
    x = state_sequence(P.A, change @ P.B.T, np.zeros(P.nstates))
    if actuators.can((applied + x @ K.T + change @ N.T)[:active]):
        return wanted

    # Of the states x and the change of the commands in each sample: V is the change of v itself.
    n = P.nstates
    X, S = np.eye(n, n + m), np.eye(m, n + m, n)
    V = np.linalg.solve(N, S - K @ X)
    C, following = P.C @ X + P.D @ V, P.A @ X + P.B @ V
    one, earlier = sparse.eye_array(len(v)), sparse.eye_array(len(v), k=-1)
    square = C.T @ C + weight * V.T @ V
    linear = -np.hstack([x, x @ K.T + change @ N.T]) @ square
    moves = sparse.kron(one, X) - sparse.kron(earlier, following)
    still = sparse.kron(one, V).tocsr()[active * m :]
    F, equal = (
        sparse.vstack([moves, still]),
        np.append(np.zeros(moves.shape[0]), -v[active:]),
    )

    # How far commands, and their steps, may go from those applied, before the rest.
    applied, step = applied[:active], actuators.step[None, :]
    margin, moved = np.minimum(actuators.rounding, step / 4), np.diff(applied, axis=0)
    low, high = np.full((2, len(v), n + m), [[[-np.inf]], [[np.inf]]])
    low[:active, n:] = actuators.lowest + margin - applied
    high[:active, n:] = actuators.highest - margin - applied
    kept = np.isfinite(np.tile(step, (active - 1, 1))).ravel()
    G = sparse.kron(one - earlier, S).tocsr()[m : active * m][kept]
    steps = ((sign * (step - margin) - moved).ravel()[kept] for sign in (-1, 1))

    solver = piqp.SparseSolver()
    H, F, G = (sparse.csc_matrix(matrix) for matrix in (sparse.kron(one, square), F, G))
    solver.setup(H, linear.ravel(), F, equal, G, *steps, low.ravel(), high.ravel())
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise RuntimeError(
            f"the solver PIQP has found no v within the limits, {status}: are they very narrow, or "
            "the loop's signals of very different sizes?"
        )
    z = solver.result.x.reshape(len(v), -1) @ V.T
    return np.append((v + z)[:active], np.zeros((rest, m)), axis=0)
