"""Delays of the inputs, where correlations show one and the posterior is larger for it.

Lags of B are counted from the delay of its input. Delays that are tried are a little less than the
lag of the largest correlation between an input and the output, or between their moves. In the
spectrum of the correlation phases count more than sizes (C. H. Knapp and G. C. Carter, IEEE Trans.
Acoust. Speech Signal Process. 24 (1976) 320-327).

Before the data any delay up to the longest trial is as likely as another: one costs log(longest) in
(4).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ilctools.measurement.arx.likelihood import Fit, likeliest
from ilctools.measurement.arx.regressors import data_of
from ilctools.measurement.arx.trials import Channels, Trials, contrasts, longest_of

LEAST_DELAY = 5  # samples: the least lag of largest correlation that counts as a delay
# Delays that are tried, relative to that lag: of the signals, whose correlation is wide, and of
# their moves. Counted: of 100 records with a long delay both are near.
ROOM_OF_SIGNALS, ROOM_OF_MOVES = 0.9, 0.98
# The power of the sizes that is taken out of a spectrum: of 1, only phases would count. Counted: of
# 100 records with a long delay 0.8 is near in 99.
WHITENING = 0.8


class Search(NamedTuple):
    """What a search for delays needs to know."""

    groups: Sequence[Trials]
    direct: bool  # whether y(t) may depend on the commanded inputs at t, or after their delay
    gain: Sequence[float] | None  # P at rest, (m,), where it is known


class Delayed(NamedTuple):
    """A fit, and the delays for which it is one."""

    fit: Fit
    delays: np.ndarray  # of all inputs, samples
    cost: float  # (4), with that of the delays


def with_delays(search: Search, least: np.ndarray) -> Fit:
    """The likeliest fit with the least delays, or with delays that correlations show."""
    best = _fitted(search, least)
    tried = [
        (_latest(search.groups, differences), room)
        for differences, room in ((0, ROOM_OF_SIGNALS), (1, ROOM_OF_MOVES))
    ]
    for together in _searched_together(search.groups):
        before = best.delays
        for latest, room in tried:
            more = np.zeros_like(before)
            more[together] = np.maximum(latest - before, 0)[together]
            if more.max() >= LEAST_DELAY:
                further = _fitted(search, before + (room * more).astype(int), [best.fit.eta])
                best = min(best, further, key=lambda one: one.cost)
    return best.fit


def _fitted(search, delays, first=None):
    longest = longest_of(search.groups)
    fit = likeliest(data_of(search.groups, search.direct, delays, search.gain), longest, first)
    late = sum(delays[inputs].any() for inputs in _searched_together(search.groups))
    return Delayed(fit, delays, fit.cost + late * np.log(longest))


def _searched_together(groups):
    """Inputs whose delays are searched for at once: all commanded ones; each disturbance alone."""
    commanded, inputs = Channels.of(groups)
    return [slice(commanded), *(slice(j, j + 1) for j in range(commanded, inputs))]


def _latest(groups, differences):
    """Lags of largest correlation of each input, or of its moves, with the output, (m + d,)."""
    longest, products = longest_of(groups), 0.0
    for group in groups:
        signals = contrasts(np.concatenate([group.inputs, group.y], axis=2))
        signals = np.diff(signals - signals.mean(axis=1, keepdims=True), differences, axis=1)
        spectra = np.fft.rfft(signals, 2 * longest, axis=1)
        products = products + np.sum(spectra[..., :-1].conj() * spectra[..., -1:], axis=0)
    phases = products / np.maximum(np.abs(products), 1e-300) ** WHITENING
    return np.argmax(np.abs(np.fft.irfft(phases, axis=0))[: longest // 2], axis=0)
