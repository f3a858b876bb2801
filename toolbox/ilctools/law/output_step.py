"""The next trial's signal that keeps limits of outputs, though P is known within a radius only.

A trial k was driven by w_k = r + v_k, and y_k was measured. The next one is driven by w_k + d. It
has y_k + P d + Delta d, where Delta is any stable, linear, causal error within the radius of P, and
what does not repeat, n at most in each of both trials. So with rho(t) of :mod:`.error_bound`

    |y_{k+1} - y_k - P d| <= rho(t) + 2 n.                                                      (4)

Trials before say more: for any numbers c_j

    d = sum c_j (w_j - w_k) + d',    y_{k+1} - y_k = sum c_j (y_j - y_k) + P d' + Delta d',     (5)

where only d' meets the error of P; the rest was measured, up to 2 n sum |c_j|. At each sample the
tighter of both holds. A trial before that contradicts (4) is left out, for a disturbance was
another. The need of d is by how much y may move towards a limit by that, but for the last 2 n; it
grows in proportion to d. So of all shares alpha of d the largest that keeps the limits in the next
trial is

    alpha = min(1, least of room / need),    room = high - 2 n - y_k,    or y_k - low - 2 n,    (6)

and at least zero. If a trial's own outputs, without what does not repeat, are n below a limit, then
those of the next are, for the measured y_k is n above them at most. The measured y_{k+1} is then
below the limit. This is the proof; docs/proofs.md has it in full.

What is shortened is the law's own change d, or one that needs less. A program finds the signal that
is nearest to the law's and keeps limits that are tightened by theta times what (4) or (5) adds for
d; theta is one of THETAS. Of all of these, shortened by (6), that with the least cost

    ||P (d - d*)||^2 + weight ||d - d*||^2,    d* the law's change,                             (7)

is taken, or d = 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ilctools.law.nearest import NotFound
from ilctools.law.output_program import Program
from ilctools.law.output_spread import Done

THETAS = (0.3, 1.0)  # shares of (4) or (5) by which the limits of programs are tightened
BACK_THETAS = (1.2, 2.0)  # likewise, after a trial beyond a limit


def regained(program: Program, now: Done, noise: np.ndarray) -> np.ndarray | None:
    """A change after which all limits hold for sure, of a trial beyond one; None: none is found.

    Trials before do not count: something may have changed since.
    """
    plants, room = program.plants, program.room
    spreads = [plant.spread(program.wanted, now, [], noise) for plant in plants]
    for theta in BACK_THETAS:
        try:
            d = program.change(spreads, theta)
        except NotFound:
            continue
        sure = [plant.spread(d, now, [], noise) for plant in plants]
        if all(np.all(s.most <= room.up) and np.all(-s.least <= room.down) for s in sure):
            return d
    return None


class Step(NamedTuple):
    """The change of w that keeps all limits, and what keeps the law from its own."""

    change: np.ndarray  # (time, m)
    alpha: float  # share of the law's own change that (6) allows
    output: int  # which has the least alpha, with the next two at that sample
    room: float
    error: float  # the radius of what may come


def longest_step(program: Program, now: Done, past: Sequence[Done], noise: np.ndarray) -> Step:
    """Of the law's change, shortened by (6), and those of programs, that of least cost (7)."""
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
