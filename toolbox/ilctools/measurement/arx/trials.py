"""Trials as the regression uses them, and series, which are means and differences of trials.

A disturbance that repeats is the same in all trials of a group. K trials y_k are therefore
transformed into K series by Helmert's orthonormal contrasts,

    sqrt(K) times the mean of the y_k,  and  K - 1 differences between them,

because the disturbance is in the first series only. White noise in the trials is white in each
series, and independent between series.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import helmert


@dataclass(frozen=True)
class Trials:
    """A group of trials of the same length; one disturbance may repeat in all of them."""

    # The commanded inputs, relative to their values before the trial, and then the known
    # disturbances, relative to the first sample, (trial, time, m + d).
    u: np.ndarray
    y: np.ndarray  # (trial, time, p), relative to the first sample
    names: tuple[str, ...]  # of the trials, in messages
    known: int = 0  # d, the number of inputs that are known disturbances

    @property
    def commanded(self) -> int:
        """The number m of commanded inputs, which stand first."""
        return self.u.shape[2] - self.known


def longest_of(groups: Sequence[Trials]) -> int:
    """Return the number of samples of the longest trial."""
    return max(group.y.shape[1] for group in groups)


class SeriesKey(NamedTuple):
    """The key under which the unknowns and other parts of a series are stored."""

    group: int  # the position of its group
    contrast: int  # 0 for the mean of the group's trials, then the differences between them

    @property
    def has_what_repeats(self) -> bool:
        """Whether the series contains what all trials of its group have in common."""
        return self.contrast == 0


class Series(NamedTuple):
    """One contrast of the trials of a group, for one output."""

    key: SeriesKey
    u: np.ndarray  # (time, m + d)
    y: np.ndarray  # (time,)
    trials: int  # number of trials of the group

    @property
    def is_mean(self) -> bool:
        """Whether the series is a mean over several trials."""
        return self.key.has_what_repeats and self.trials > 1


def keys_of(groups: Sequence[Trials]) -> list[SeriesKey]:
    """List the keys of all series: a group has as many series as trials."""
    return [SeriesKey(i, k) for i, group in enumerate(groups) for k in range(len(group.y))]


def series_of(groups: Sequence[Trials]) -> Iterator[Series]:
    """Iterate over all series of the first output."""
    for i, group in enumerate(groups):
        signals = zip(contrasts(group.u), contrasts(group.y[..., 0]), strict=True)
        for k, (u, y) in enumerate(signals):
            yield Series(SeriesKey(i, k), u, y, len(group.y))


def contrasts(signal: np.ndarray) -> np.ndarray:
    """Compute the contrasts of trials: their mean and their differences.

    The trials have the shape (trial, ...), and the contrasts have the shape (contrast, ...).
    """
    return np.tensordot(helmert(len(signal), full=True), signal, 1)
