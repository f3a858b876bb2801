"""The unknowns of the regression, in blocks for A, each B, starts, drifts and slow parts.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + line(t) + drift(t) + e(t)      (1)

A is monic. The number of lags of A and of each B is a quarter of the samples of the longest trial.
The lags of a B are counted from the delay of its input. In addition to its lags, each B has parts
with poles of their own, see `parts`. A series is the mean of trials or a difference between them,
see `trials`. A start is the response to signals before a series, and has the same number of lags. A
line is an offset and a slope of a series. A drift is a random walk.

The unknowns of a response are its increments from lag to lag. Several successive lags may share one
increment: the coefficients lie on straight lines between *knots*. The coefficients are H x, where x
are the increments. A column of H has the value one from the first knot to its own knot, and from
there falls to zero at the next knot.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import diric

from ilctools.measurement.arx.parts import Parts
from ilctools.measurement.arx.trials import Trials, keys_of, longest_of

# The longest trial has SHARE_OF_LAGS times as many samples as A and B have lags. More lags cost
# time. Fewer lags truncate the responses of slow plants.
SHARE_OF_LAGS = 4
FEWEST_LAGS = 4
# Knots are one lag apart up to lag CLOSE_KNOTS, then 1 + (lag - CLOSE_KNOTS) // KNOTS_STEP. This
# distance is up to an eighth of the lag, and saves time. The knots of starts are coarser.
CLOSE_KNOTS, KNOTS_STEP = 40, 8
CLOSE_KNOTS_OF_STARTS, KNOTS_STEP_OF_STARTS = 6, 4
# Largest number of unknowns of all starts, because of the time that they take. If more would be
# needed, the first samples are left out instead.
MOST_OF_STARTS = 300
DRIFT_KNOTS = 64  # number of knots of a drift, which is straight between them


class Kind(IntEnum):
    """The part of (1) that an unknown belongs to; unknowns of a kind share c, see `prior`."""

    A = 0  # increments of A
    B = 1  # increments of the B of an input
    START = 2  # increments of the response to what was before a series
    DRIFT = 3  # steps of the drift of a group
    PART = 4  # parts of the B of an input, which have poles of their own


class Block(NamedTuple):
    """Unknowns that belong together, and the lag of each unknown in (2) of `prior`."""

    kind: Kind
    owner: Hashable  # the input of B and parts, the key of a series, the position of a group
    lag: np.ndarray  # (unknown,)
    gap: np.ndarray  # (unknown,): distance to the next lag; infinite at the last

    @classmethod
    def of_lags(cls, kind: Kind, owner: Hashable, knots: np.ndarray, late: int = 0) -> "Block":
        """Make a block of increments at knots, whose variances decay after `late` lags."""
        lag = np.maximum(knots - knots[0] - late, 0.0)
        return cls(kind, owner, lag, np.append(np.diff(knots), np.inf))

    @classmethod
    def alike(cls, kind: Kind, owner: Hashable, n: int) -> "Block":
        """Make a block of n unknowns without an order, each with the variance c."""
        return cls(kind, owner, np.zeros(n), np.full(n, np.inf))


@dataclass(frozen=True)
class Layout:
    """The unknowns x, block by block, and the lags that they represent.

    The block of A stands first, and then the block of each B. The blocks of parts, starts and
    drifts follow.
    """

    blocks: tuple[Block, ...]
    knots_of_A: np.ndarray  # lags
    knots_of_B: tuple[np.ndarray, ...]  # lags of each input
    knots_of_start: np.ndarray  # samples after the beginning of a series
    delays: np.ndarray  # of all inputs, samples
    parts: Parts  # of each B
    resonances: np.ndarray  # angles omega Ts at which B has resonant parts
    skipped: int  # samples left out at the beginning of each series, if it has no start

    @cached_property
    def kind(self) -> np.ndarray:
        """The kind of each unknown, shape (unknown,)."""
        return np.repeat([b.kind for b in self.blocks], [len(b.lag) for b in self.blocks])

    @cached_property
    def lag(self) -> np.ndarray:
        """The lag of each unknown, shape (unknown,), see :class:`Block`."""
        return np.concatenate([block.lag for block in self.blocks])

    @cached_property
    def gap(self) -> np.ndarray:
        """The gap of each unknown, shape (unknown,), see :class:`Block`."""
        return np.concatenate([block.gap for block in self.blocks])

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.kind)

    @cached_property
    def _places(self):
        places, first = {}, 0
        for kind, owner, lag, _ in self.blocks:
            places[kind, owner] = slice(first, first + len(lag))
            first += len(lag)
        return places

    def where(self, kind: Kind, owner: Hashable = None) -> slice:
        """Return where the unknowns of a block stand in x."""
        return self._places[kind, owner]

    def where_B(self, j: int) -> np.ndarray:
        """Return where the increments, and then the parts, of the B of input j stand in x."""
        return np.r_[self.where(Kind.B, j), self.where(Kind.PART, j)]

    @property
    def lags(self) -> int:
        """The number of lags of A."""
        return self.knots_of_A[-1]

    def denominator(self, x: np.ndarray) -> np.ndarray:
        """Compute the coefficients of A from the unknowns x, from lag 0 on."""
        past = coefficients(x[self.where(Kind.A)], self.knots_of_A, self.lags + 1)
        past[0] = 1.0  # A is monic
        return past

    def waves_of_A(self, omega: np.ndarray) -> np.ndarray:
        """Compute what each unknown of A adds to A - 1 at n angles omega Ts.

        The result has the shape (n, unknown).
        """
        return waves(self.knots_of_A, omega)

    def waves_of_B(self, j: int, omega: np.ndarray) -> np.ndarray:
        """Compute what each unknown of B adds to the B of input j at n angles omega Ts.

        The result has the shape (n, unknown).
        """
        return np.hstack([waves(self.knots_of_B[j], omega), self.parts.waves(omega)])


def layout_of(
    groups: Sequence[Trials], direct: bool, delays: np.ndarray, resonances: Sequence[float] = ()
) -> Layout:
    """Make the layout of the unknowns for these trials.

    `direct` says whether y(t) may depend on the commanded inputs at the same time t, or at t minus
    their delay, and not only on earlier inputs. `delays` are the delays of all inputs, (m + d,).
    Each B has resonant parts at the angles omega Ts of `resonances`.
    """
    longest, commanded = longest_of(groups), groups[0].commanded
    reach = max(FEWEST_LAGS, longest // SHARE_OF_LAGS)
    past, at_once = (knots_between(first, reach, CLOSE_KNOTS, KNOTS_STEP) for first in (1, 0))
    # A disturbance does not follow y. y(t) may therefore depend on the disturbance at t, whatever
    # the commands do.
    knots_of_B = tuple(
        delay + (at_once if direct or j >= commanded else past) for j, delay in enumerate(delays)
    )
    keys, late = keys_of(groups), max(delays)
    start = _knots_of_start(len(keys), late, reach)
    has_starts = len(keys) * len(start) <= MOST_OF_STARTS
    parts = Parts.of(longest, resonances)
    blocks = (
        Block.of_lags(Kind.A, None, past),
        *(Block.of_lags(Kind.B, j, knots) for j, knots in enumerate(knots_of_B)),
        *(Block.alike(Kind.PART, j, parts.size) for j in range(len(delays))),
        *(Block.of_lags(Kind.START, key, start, late) for key in keys if has_starts),
        *(Block.alike(Kind.DRIFT, i, DRIFT_KNOTS) for i in range(len(groups))),
    )
    skipped = 0 if has_starts else reach
    return Layout(blocks, past, knots_of_B, start, delays, parts, np.array(resonances), skipped)


def _knots_of_start(series: int, late: int, reach: int) -> np.ndarray:
    """Choose the knots of the starts, for this number of series.

    The argument `late` is the latest delay, in samples. Until this delay has passed, inputs from
    before the series still act on the output, and their effect may be of any form. There is then a
    knot at each sample, unless all starts together would have too many.
    """
    coarse = late + knots_between(0, reach, CLOSE_KNOTS_OF_STARTS, KNOTS_STEP_OF_STARTS)
    fine = np.union1d(np.arange(late), coarse)
    return fine if series * len(fine) <= MOST_OF_STARTS else np.unique(np.append(0, coarse))


def knots_between(first: int, last: int, close: int, step: int) -> np.ndarray:
    """Choose lags from `first` to `last`.

    All lags up to `close` are chosen. Beyond `close`, the chosen lags are further and further
    apart.
    """
    knots = [first]
    while knots[-1] < last:
        apart = 1 + max(0, knots[-1] - close) // step
        knots.append(min(last, knots[-1] + apart))
    return np.array(knots)


def waves(knots: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Compute the frequency response of each column of H, by geometric series.

    The result has the shape (n, knot).
    """
    gap, omega = np.append(np.diff(knots), 1), np.where(omega, omega, 1e-200)[:, None]
    earlier = np.exp(-1j * omega * (knots + (gap + 1) / 2)) * diric(omega, gap)
    return (np.exp(-1j * omega * knots[0]) - earlier) / (1 - np.exp(-1j * omega))


def coefficients(x: np.ndarray, knots: np.ndarray, n: int) -> np.ndarray:
    """Compute the first n entries of H x; entries beyond the last knot are zero."""
    return np.interp(np.arange(n), knots, np.cumsum(x[::-1])[::-1], 0, 0)
