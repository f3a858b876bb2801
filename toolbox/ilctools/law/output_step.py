"""Find the next trial's signal that keeps limits of outputs, if the error of P is bounded.

Trial k was driven by w_k = r + v_k, and y_k was measured. The next trial is driven by w_k + d. The
next outputs are y_k + P d + Delta d, plus a part that does not repeat from trial to trial. Delta is
any stable, linear and causal error within the radius of P. The part that does not repeat is at most
n in each trial. With rho(t) of :mod:`.error_bound`,

    |y_{k+1} - y_k - P d| <= rho(t) + 2 n.                                                      (4)

Earlier trials can tighten this bound. For any numbers c_j

    d = sum c_j (w_j - w_k) + d',    y_{k+1} - y_k = sum c_j (y_j - y_k) + P d' + Delta d',     (5)

where the error of P acts on d' only. The outputs of the other part of d were measured, with an
error of at most 2 n sum |c_j|. At each sample the tighter of the bounds (4) and (5) is used. If an
earlier trial contradicts (4), another disturbance acted in that trial, and (5) leaves the trial
out. The *need* of d is the largest change of y towards a limit by (4) and (5), without the term
2 n. The need grows in proportion to d. The *room* is the distance to the limit, less 2 n. The
largest share alpha of d that keeps all limits in the next trial is

    alpha = min(1, least of room / need),    room = high - 2 n - y_k,    or y_k - low - 2 n,    (6)

where a negative room counts as zero. These equations are the proof; docs/proofs.md has the proof in
full.

Two kinds of changes are shortened in this way: the law's own change, and the changes that a program
finds. The program looks for the signal that is closest to the law's signal within tightened limits.
The limits are tightened by theta times the radius of (4) or (5), with theta from THETAS. Among
these changes and d = 0, the change of least cost is taken. The cost is

    ||P (d - d*)||^2 + weight ||d - d*||^2,                                                     (7)

where d* is the law's change.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ilctools.law.nearest import NotFound
from ilctools.law.output_program import Program
from ilctools.law.output_spread import Done

THETAS = (0.3, 1.0)  # shares of (4) or (5) by which the limits of programs are tightened
BACK_THETAS = (1.2, 2.0)  # shares theta that are tried after a trial beyond a limit


def regained(program: Program) -> np.ndarray | None:
    """Find a change with which all limits hold for sure, after a trial that exceeded a limit.

    Returns None if no change is found. Earlier trials are not used, because the plant or a
    disturbance may have changed since then.
    """
    plants, room = program.plants, program.room
    spreads = [plant.spread(program.wanted) for plant in plants]
    for theta in BACK_THETAS:
        try:
            d = program.change(spreads, theta)
        except NotFound:
            continue
        sure = [plant.spread(d) for plant in plants]
        if all(np.all(s.most <= room.up) and np.all(-s.least <= room.down) for s in sure):
            return d
    return None


class Step(NamedTuple):
    """The change of w that keeps all limits, and what limits the law's own change."""

    change: np.ndarray  # (time, m)
    alpha: float  # share of the law's own change that (6) allows
    output: int  # the output with the least alpha, at whose sample `room` and `error` hold
    room: float
    error: float  # radius of the spread


def longest_step(program: Program, now: Done, past: Sequence[Done], noise: np.ndarray) -> Step:
    """Find the change of least cost (7) among changes that are shortened by (6).

    These are the law's own change and the changes that programs find.
    """
    plants, room, wanted = program.plants, program.room, program.wanted
    past = [done for done in past if any(plant.admits(done, now, noise) for plant in plants)]

    def spreads_of(d):
        return [plant.spread(d, now, past, noise) for plant in plants]

    spreads = spreads_of(wanted)
    shares = np.array([room.share(spread) for spread in spreads])
    plant, *at = np.unravel_index(shares.argmin(), shares.shape)
    spread, at = spreads[plant], tuple(at)
    towards = room.up if spread.middle[at] >= 0 else room.down
    candidates = [0 * wanted, shares.min() * wanted]
    for theta in THETAS if shares.min() < 1 else ():
        try:
            d = program.change(spreads, theta)
        except NotFound:
            continue
        candidates.append(min(room.share(spread).min() for spread in spreads_of(d)) * d)
    return Step(
        min(candidates, key=program.cost),
        float(shares.min()),
        at[1],
        float(np.maximum(towards[at], 0)),
        float(spread.radius[at]),
    )
