"""Trials as the regression takes them, and series: their mean and differences, one by one.

A disturbance that repeats is the same in all trials of a group. K trials y_k therefore enter as K
series by Helmert's orthonormal contrasts,

    sqrt(K) times the mean of the y_k,  and  K - 1 differences between them,

as the disturbance is in the first of these only. White noise in the trials is white in each series,
and independent between them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import helmert


@dataclass(frozen=True)
class Trials:
    """Trials of the same length, in each of which the same disturbance may repeat: a group."""

    # The commanded inputs, relative to before the trial, and after them the known disturbances,
    # relative to the first sample, (trial, time, m + d).
    u: np.ndarray
    y: np.ndarray  # (trial, time, p), relative to the first sample
    names: tuple[str, ...]  # of the trials, in messages
    known: int = 0  # d, how many of the inputs are known disturbances

    @property
    def commanded(self) -> int:
        """m, the number of inputs of which P is asked: they stand first."""
        return self.u.shape[2] - self.known


def longest_of(groups: Sequence[Trials]) -> int:
    """Samples of the longest trial."""
    return max(group.y.shape[1] for group in groups)


class SeriesKey(NamedTuple):
    """By which all that belongs to a series is found."""

    group: int  # the position of its group
    contrast: int  # 0 for the mean of the group's trials, then the differences between them

    @property
    def has_what_repeats(self) -> bool:
        """Whether the series contains what all trials of its group have in common."""
        return self.contrast == 0


class Series(NamedTuple):
    """One contrast of the trials of a group, of one output."""

    key: SeriesKey
    u: np.ndarray  # (time, m + d)
    y: np.ndarray  # (time,)
    trials: int  # of the group

    @property
    def is_mean(self) -> bool:
        """Whether it is a mean over several trials."""
        return self.key.has_what_repeats and self.trials > 1


def keys_of(groups: Sequence[Trials]) -> list[SeriesKey]:
    """The keys of all series: each group has as many as trials."""
    return [SeriesKey(i, k) for i, group in enumerate(groups) for k in range(len(group.y))]


def series_of(groups: Sequence[Trials]) -> Iterator[Series]:
    """All series of the first output, one after the other."""
    for i, group in enumerate(groups):
        signals = zip(contrasts(group.u), contrasts(group.y[..., 0]), strict=True)
        for k, (u, y) in enumerate(signals):
            yield Series(SeriesKey(i, k), u, y, len(group.y))


def contrasts(signal: np.ndarray) -> np.ndarray:
    """The contrasts of trials (trial, ...), (contrast, ...)."""
    return np.tensordot(helmert(len(signal), full=True), signal, 1)
