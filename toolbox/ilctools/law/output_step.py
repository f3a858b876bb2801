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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control
import numpy as np
from scipy.fft import rfft

from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import NotFound
from ilctools.models import from_rest

THETAS = (0.3, 1.0)  # shares of (4) or (5) by which the limits of programs are tightened
BACK_THETAS = (1.2, 2.0)  # likewise, after a trial beyond a limit
PAST = 3  # trials before this one that (5) takes
REWEIGHTED = 6  # times, by which least squares come near to the least sum of norms
NEARLY_ZERO = 1e-6  # relative: what is smaller has the same weight in these
TINY = np.finfo(float).tiny  # instead of a zero that divides


class Done(NamedTuple):
    """A trial that has ended: what drove P, and what came of it; in units of `scale`."""

    w: np.ndarray  # (time, m)
    y: np.ndarray  # (time, p)


class Spread(NamedTuple):
    """From which to which change y may come, but for the last 2 n; shape (time, p)."""

    least: np.ndarray
    most: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """What is expected."""
        return (self.least + self.most) / 2

    @property
    def radius(self) -> np.ndarray:
        """What the error of the model adds."""
        return (self.most - self.least) / 2


class Room(NamedTuple):
    """How far outputs may move, (6), shape (time, p)."""

    down: np.ndarray
    up: np.ndarray

    def share(self, spread: Spread) -> np.ndarray:
        """alpha of (6), of each sample and output."""
        share = np.ones(spread.most.shape)
        for room, need in ((self.up, spread.most), (self.down, -spread.least)):
            limited = (need > 0) & np.isfinite(room)
            of_need = np.divide(np.maximum(room, 0), need, out=np.ones(need.shape), where=limited)
            share = np.minimum(share, of_need)  # (6)
        return share


@dataclass(frozen=True, eq=False)
class Plant:
    """A plant within its radius on trials of one length, in units of `scale`."""

    model: control.StateSpace
    bound: ErrorBound

    def output(self, w) -> np.ndarray:
        """P w, from rest, (time, p)."""
        return from_rest(self.model, w)

    def spread(self, d, now: Done, past: Sequence[Done], noise) -> Spread:
        """By (4), and where it is tighter by (5); noise (p,) is n."""
        y, rho = self.output(d), self.bound.over_time(d)[:, None]
        least, most = y - rho, y + rho  # (4)
        if past and rho.any():
            changes = np.array([done.w - now.w for done in past])
            came = np.array([done.y - now.y for done in past])
            c = self.combination(d, changes, np.max(noise))
            left = d - np.tensordot(c, changes, 1)  # d'
            middle = np.tensordot(c, came, 1) + self.output(left)
            q = self.bound.over_time(left)[:, None] + 2 * noise * np.abs(c).sum()
            least, most = np.maximum(least, middle - q), np.minimum(most, middle + q)  # (5)
        return Spread(least, most)

    def admits(self, done: Done, now: Done, noise) -> bool:
        """Whether a trial and the last one differ by no more than (4) lets them."""
        came, spread = done.y - now.y, self.spread(done.w - now.w, now, [], noise)
        slack = 2 * noise + NEARLY_ZERO * np.abs(came).max()
        return bool(np.all(came >= spread.least - slack) and np.all(came <= spread.most + slack))

    def combination(self, d, changes, noise: float) -> np.ndarray:
        """The c_j of (5) for which rho(d') + 2 n sum |c_j| is about least: any numbers hold."""
        D, W = (rfft(signal, self.bound.padded, axis=-2) for signal in (d, changes))
        size, each = np.abs(D).max() + TINY, self.bound.weights
        weights, of_c = each / size, np.zeros(len(W))
        for _ in range(REWEIGHTED):
            G = np.einsum("f,jfm,kfm->jk", weights, W.conj(), W, optimize=True).real
            b = np.einsum("f,jfm,fm->j", weights, W.conj(), D, optimize=True).real
            ridge = of_c + np.finfo(float).eps * len(d) * np.trace(G) + TINY
            c = np.linalg.solve(G + np.diag(ridge), b)
            left = np.linalg.norm(D - np.tensordot(c, W, 1), axis=1)
            weights = each / np.maximum(left, NEARLY_ZERO * size)
            of_c = 2 * noise / np.maximum(np.abs(c), NEARLY_ZERO)
        return c


def regained(
    plants: Sequence[Plant], room: Room, wanted, now: Done, noise, program
) -> np.ndarray | None:
    """A change after which all limits hold for sure, of a trial beyond one; None: none is found.

    Trials before do not count: something may have changed since.
    """
    spreads = [plant.spread(wanted, now, [], noise) for plant in plants]
    for theta in BACK_THETAS:
        try:
            d = program(spreads, theta)
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


def longest_step(
    plants: Sequence[Plant],
    room: Room,
    wanted: np.ndarray,
    now: Done,
    past: Sequence[Done],
    noise: np.ndarray,
    cost: Callable[[np.ndarray], float],
    program: Callable[[Sequence[Spread], float], np.ndarray],
) -> Step:
    """Of the law's change, shortened by (6), and those of programs, that of least cost (7).

    `program(spreads, theta)` is a change that keeps the limits, tightened by theta times the radius
    of each plant's spread; it may raise a NotFound.
    """

    def spreads_of(d):
        return [plant.spread(d, now, past, noise) for plant in plants]

    def shortened(d, spreads):
        return min(room.share(spread).min() for spread in spreads) * d

    spreads = spreads_of(wanted)
    shares = np.array([room.share(spread) for spread in spreads])
    plant, *at = np.unravel_index(shares.argmin(), shares.shape)
    spread, at = spreads[plant], tuple(at)
    towards = room.up if spread.middle[at] >= 0 else room.down
    candidates = [0 * wanted, shares.min() * wanted]
    for theta in THETAS if shares.min() < 1 else ():
        try:
            d = program(spreads, theta)
        except NotFound:
            continue
        candidates.append(shortened(d, spreads_of(d)))
    return Step(
        min(candidates, key=cost),
        float(shares.min()),
        at[1],
        float(np.maximum(towards[at], 0)),
        float(spread.radius[at]),
    )
