"""Bounds on the change of outputs between two trials, from a model and earlier trials.

The equations (4) to (6) are in :mod:`.output_step`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control
import numpy as np
from scipy.fft import rfft

from ilctools.law.error_bound import ErrorBound
from ilctools.models import from_rest

PAST = 3  # number of earlier trials that (5) uses
REWEIGHTED = 6  # iterations of reweighted least squares, which approximate the least sum of norms
NEARLY_ZERO = 1e-6  # relative size below which all values have the same weight in the iterations
TINY = np.finfo(float).tiny  # added to divisors that may be zero


class Done(NamedTuple):
    """The signal w that drove P in a past trial, and the outputs, in units of `scale`."""

    w: np.ndarray  # (time, m)
    y: np.ndarray  # (time, p)


class Spread(NamedTuple):
    """The least and the greatest change of y, (time, p), without the term 2 n of (4)."""

    least: np.ndarray
    most: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """The expected change of y."""
        return (self.least + self.most) / 2

    @property
    def radius(self) -> np.ndarray:
        """The most by which the change of y may differ from the expected change."""
        return (self.most - self.least) / 2


class Room(NamedTuple):
    """How far outputs may fall and rise before they reach a limit, see (6).

    Both arrays have the shape (time, p).
    """

    down: np.ndarray
    up: np.ndarray

    def share(self, spread: Spread) -> np.ndarray:
        """Compute the share alpha of (6) for each sample and output."""
        share = np.ones(spread.most.shape)
        for room, need in ((self.up, spread.most), (self.down, -spread.least)):
            of_need = np.divide(np.maximum(room, 0), need, out=np.ones(need.shape), where=need > 0)
            share = np.minimum(share, of_need)  # (6)
        return share


@dataclass(frozen=True, eq=False)
class Plant:
    """A model, and the bound of its error on trials of one length, in units of `scale`."""

    model: control.StateSpace
    bound: ErrorBound

    def output(self, w) -> np.ndarray:
        """Compute the output P w from rest, shape (time, p)."""
        return from_rest(self.model, w)

    def spread(self, d, now: Done | None = None, past: Sequence[Done] = (), noise=0.0) -> Spread:
        """Compute the spread for a change d of w by (4), or by (5) where (5) is tighter.

        Only (5) needs the trials `now` and `past`, and the bound n, which is `noise`.
        """
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
        """Whether a trial and the last one differ by no more than (4) allows."""
        came, spread = done.y - now.y, self.spread(done.w - now.w)
        slack = 2 * noise + NEARLY_ZERO * np.abs(came).max()
        return bool(np.all(came >= spread.least - slack) and np.all(came <= spread.most + slack))

    def combination(self, d, changes, noise: float) -> np.ndarray:
        """Find c_j of (5) that nearly minimise rho(d') + 2 n sum |c_j|.

        The bound (5) is valid for any c_j.
        """
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
