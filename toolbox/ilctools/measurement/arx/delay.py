"""Find the delays of the inputs: correlations propose delays, and posteriors decide on them.

A delay is accepted if the posterior of the regression is larger with this delay. The lags of the
numerator B of an input are counted from the delay of the input. The delays that are tried are a
little less than the lag of the largest correlation between an input and the output, or between
their changes from sample to sample. In the spectrum of the correlation, phases have more weight
than magnitudes (C. H. Knapp and G. C. Carter, IEEE Trans. Acoust. Speech Signal Process. 24 (1976)
320-327).

In the prior, all delays up to the length of the longest trial are equally likely. A delay therefore
adds log(longest) to the cost (4) in `likelihood`, where longest is the length of the longest trial.
"""

from collections.abc import Sequence

import numpy as np

from ilctools.measurement.arx.likelihood import Fit, likeliest
from ilctools.measurement.arx.prior import FIRST_GUESSES, WITHOUT_DRIFT, Hyperparameters
from ilctools.measurement.arx.regressors import data_of
from ilctools.measurement.arx.trials import Trials, contrasts, longest_of

LEAST_DELAY = 5  # samples: the least lag of largest correlation that counts as a delay
# Delays that are tried, relative to the lag of largest correlation: of the signals, where the peak
# is wide, and of their changes. In 100 records with a long delay, both are near the true delay.
ROOM_OF_SIGNALS, ROOM_OF_MOVES = 0.9, 0.98
# The spectrum is divided by this power of its magnitudes. With 1, only phases would count. In a
# count of 100 records with a long delay, 0.8 is near in 99.
WHITENING = 0.8


def with_delays(groups: Sequence[Trials], direct: bool, least: np.ndarray, gain=()) -> Fit:
    """Find the likeliest fit, with the least delays or with delays from correlations.

    The argument `least` holds the least delay of each input, shape (m + d,). `data_of` explains
    `direct` and `gain`. The cost of a fit is (4) in `likelihood`, plus the cost of its delays.
    """
    commanded, longest = groups[0].commanded, longest_of(groups)
    alone = [slice(j, j + 1) for j in range(commanded, len(least))]
    searched_at_once = [slice(commanded), *alone]  # all commanded inputs; each disturbance

    def fitted(delays, first=FIRST_GUESSES, least=np.inf):
        late = np.log(longest) * sum(delays[inputs].any() for inputs in searched_at_once)
        fit = likeliest(data_of(groups, direct, delays, gain), first, least - late)
        return fit._replace(cost=fit.cost + late)

    best = fitted(least)
    tried = [(_latest(groups, 0), ROOM_OF_SIGNALS), (_latest(groups, 1), ROOM_OF_MOVES)]
    for inputs in searched_at_once:
        before = best.data.layout.delays
        for latest, room in tried:
            more = np.zeros_like(before)
            more[inputs] = np.maximum(latest - before, 0)[inputs]
            if more.max() >= LEAST_DELAY:
                further = fitted(before + (room * more).astype(int), [_anew(best.eta)], best.cost)
                best = min(best, further, key=lambda fit: fit.cost)
    return best


def _anew(eta):
    """Return eta with a new guess of the size of B.

    The old size comes from a fit without the delay. Such a fit makes B too small.
    """
    return np.array(Hyperparameters(*eta)._replace(log_c_B=WITHOUT_DRIFT.log_c_B))


def _latest(groups, differences):
    """Find, for each input, the lag of its largest correlation with the output.

    The result has the shape (m + d,). `differences` is 0 for the correlation of signals, and 1 for
    the correlation of their changes from sample to sample.
    """
    longest, products = longest_of(groups), 0.0
    for group in groups:
        signals = contrasts(np.concatenate([group.u, group.y], axis=2))
        signals = np.diff(signals - signals.mean(axis=1, keepdims=True), differences, axis=1)
        spectra = np.fft.rfft(signals, 2 * longest, axis=1)
        products = products + np.sum(spectra[..., :-1].conj() * spectra[..., -1:], axis=0)
    phases = products / np.maximum(np.abs(products), 1e-300) ** WHITENING
    return np.argmax(np.abs(np.fft.irfft(phases, axis=0))[: longest // 2], axis=0)
