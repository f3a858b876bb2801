"""The law (23) within what the actuators follow: v_{k+1} is projected onto what they can do.

Section III has no limits. Here the ILC signal of the next trial is, of all v whose commands stay
within the limits, the one whose outputs are nearest to those that the law asks for. A projection
onto a convex set makes no two signals more distant, so that Lemma 1 still holds in the outputs.
The program has the stages of the loop, one for each sample; PIQP solves it.
"""

import warnings

import numpy as np
import piqp
from scipy import sparse

from rodlib.ilc import arguments
from rodlib.ilc.actuators import Actuators
from rodlib.ilc.filters import LearningOperator, ZeroPhaseButterworth, update
from rodlib.ilc.loop import ClosedLoop, Loop, check_loop
from rodlib.ilc.models import state_sequence

WEIGHT = 1e-4  # of ||v||^2 beside ||P v||^2: what the outputs hardly show stays as the law has it
ELASTIC = 1e6  # weight of the square of what is beyond, where nothing is within


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
    the loop, from the commands that were applied. The weight is 1e-4, or that of an L which has
    one: with that of :class:`rodlib.NormOptimal` and a Q near one this is constrained norm-optimal
    learning, whose predicted error cannot rise.

    Parameters
    ----------
    v, e : array_like, shape (time, m)
        ILC signal and tracking error of the trial just done, as for :func:`rodlib.update`.
    u : array_like, shape (time, m)
        Commands that the controller asked for in it: of a CurrentTrialLoop its controls, of a
        ClosedLoop w = reference + v.
    Q, L : ZeroPhaseButterworth, LearningOperator
    loop : CurrentTrialLoop or ClosedLoop
        Of a ClosedLoop without P the commands are cut off instead.
    limits : dict
        Lowest and highest command, by name (``loop.commands``), in their units; and third, if need
        be, the largest change per second.
    applied : array_like, shape (time, m), optional
        What the actuators made of u, and the observer was told. Default: u, cut off at the limits.
    rest, step :
        As for :func:`rodlib.update`.

    Returns
    -------
    ndarray, of the shape of v

    Raises
    ------
    RuntimeError
        If the solver fails.

    Warns
    -----
    UserWarning
        If v = 0 in the rest leaves nothing within the limits. The nearest is returned.
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


def commands_of(loop: Loop, actuators: Actuators, w, u=None, applied=None):
    """What was asked for, u or of a ClosedLoop w, and what was applied of it."""
    asked = w if isinstance(loop, ClosedLoop) else u
    return asked, actuators.follow(asked) if applied is None else applied


def projected(v, e, commands, Q, L, loop, actuators, rest, step):
    """As :func:`update_within`, of what was checked."""
    v, applied = realised(loop, v, *commands), commands[1]
    wanted = update(v, e, Q, L, rest, step)
    return _nearest(loop, actuators, v, applied, wanted, getattr(L, "weight", WEIGHT), rest)


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
        raise ValueError("loop.N is singular: its commands do not tell what w would do") from None


def _nearest(loop, actuators, v, applied, wanted, weight, rest):
    """Of all v whose commands can be followed, the nearest to `wanted`; v made `applied`."""
    if loop.P is None:
        v = v + actuators.follow(applied + wanted - v) - applied
        v[len(v) - rest :] = 0
        return v
    P, m = loop.P, len(loop.outputs)
    own = isinstance(loop, ClosedLoop)
    K, N = (np.zeros((m, P.nstates)), np.eye(m)) if own else (-loop.Ks, loop.N)  # from w to u
    change = wanted - v
    x = state_sequence(P.A, change @ P.B.T, np.zeros(P.nstates))
    if actuators.can(applied + x @ K.T + change @ N.T):
        return wanted

    # Of the states x and the change of v in each sample: C gives outputs, S commands, V itself.
    C, S, V = np.hstack([P.C, P.D]), np.hstack([K, N]), np.eye(m, P.nstates + m, P.nstates)
    one, earlier = sparse.eye_array(len(v)), sparse.eye_array(len(v), k=-1)
    square = C.T @ C + weight * V.T @ V
    linear = -np.hstack([x, change]) @ square
    moves = sparse.kron(one, np.eye(P.nstates, P.nstates + m))
    moves = moves - sparse.kron(earlier, np.hstack([P.A, P.B]))
    still = sparse.kron(one, V).tocsr()[(len(v) - rest) * m :]
    equal = np.append(np.zeros(moves.shape[0]), -v[len(v) - rest :])
    G, low, high = _bounds(actuators, applied, sparse.kron(one, S), sparse.kron(one - earlier, S))
    given = sparse.kron(one, square), linear.ravel(), sparse.vstack([moves, still]), equal
    z = _solve(*given, G, low, high).reshape(len(v), -1)
    z[len(v) - rest :, P.nstates :] = -v[len(v) - rest :]
    asked = applied + z @ S.T
    if not actuators.can(asked):
        beyond = np.abs(actuators.follow(asked) - asked).max()
        warnings.warn(
            f"no v that rests in the last {rest} samples keeps the commands within the limits: the "
            f"nearest has them beyond by up to {beyond:.3g}. Take a shorter rest",
            stacklevel=4,
        )
    return v + z[:, P.nstates :]


def _bounds(actuators, applied, commands, steps):
    """low <= G z <= high: how far commands, and their steps, may go from those applied."""
    low, high, step = actuators.lowest, actuators.highest, actuators.step[None, :]
    margin = np.minimum(actuators.rounding, step / 4)
    moved = np.diff(applied, axis=0)
    lows = np.vstack([low + margin - applied, margin - step - moved]).ravel()
    highs = np.vstack([high - margin - applied, step - margin - moved]).ravel()
    kept = np.isfinite(lows)  # as are those above
    G = sparse.vstack([commands, steps.tocsr()[applied.shape[1] :]], format="csr")
    return G[kept], lows[kept], highs[kept]


def _solve(H, c, F, b, G, low, high):
    """The z that minimises z'Hz/2 + c'z with Fz = b and low <= Gz <= high, or is near to that."""
    z = _by_piqp(H, c, F, b, G, low, high)
    if z is None:  # with what is beyond as more unknowns
        n, rows = len(c), G.shape[0]
        H = sparse.block_diag([H, ELASTIC * sparse.eye_array(rows)])
        F = sparse.hstack([F, sparse.csr_array((F.shape[0], rows))])
        G = sparse.hstack([G, sparse.eye_array(rows)])
        z = _by_piqp(H, np.append(c, np.zeros(rows)), F, b, G, low, high)
        if z is None:
            raise RuntimeError(
                "the solver PIQP has found no v within the limits: are they very narrow, or the "
                "loop's signals of very different sizes?"
            )
        z = z[:n]
    return z


def _by_piqp(H, c, F, b, G, low, high):
    solver = piqp.SparseSolver()
    solver.setup(
        *(sparse.csc_matrix(x) if sparse.issparse(x) else x for x in (H, c, F, b, G)), low, high
    )
    return solver.result.x.copy() if solver.solve() == piqp.PIQP_SOLVED else None
