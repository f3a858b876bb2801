"""The regressors of (1), and the products to which the series add up.

With T(u) the matrix of the lags of u, H as in `unknowns`, and ramps from knot to knot for a drift,

    X = [-T(y) H, T(u_1) H, ..., T(u_m) H, slow parts, T(1, 0, 0 ...) H, ramps].

The line of (1), an offset and a slope of each series, is taken out of X and y beforehand. Nothing
that follows needs X, but X' X, X' y and y' y, which are added up series by series.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from ilctools.measurement.arx.trials import Series, Trials, series_of
from ilctools.measurement.arx.unknowns import DRIFT_KNOTS, Kind, Layout, layout_of

# The weight of a known P at rest among the products: it is met to a thousandth of the noise s.
WEIGHT_AT_REST = 1e6


def regressors(series: Series, layout: Layout) -> np.ndarray:
    """X' of a series, (unknown, time)."""
    X, N = np.zeros((layout.size, len(series.y))), len(series.y)
    X[layout.where(Kind.A)] = lagged(-series.y, layout.knots_of_A)
    for j, u in enumerate(series.u.T):
        X[layout.where(Kind.B, j)] = lagged(u, layout.knots_of_B[j])
        X[layout.where(Kind.SLOW, j)] = [lfilter([0, 1 - p], [1, -p], u) for p in layout.poles]
    if not layout.skipped:
        X[layout.where(Kind.START, series.key)] = lagged(np.eye(1, N)[0], layout.knots_of_start)
    if series.key.has_what_repeats:  # a drift is common to the trials of a group
        # from zero before a knot to one at the next
        ends = np.linspace(0, N - 1, DRIFT_KNOTS + 1)
        ramps = np.clip((np.arange(N) - ends[:-1, None]) / ends[1], 0, 1)
        X[layout.where(Kind.DRIFT, series.key.group)] = ramps
    return X


def lagged(signal: np.ndarray, knots: np.ndarray) -> list[np.ndarray]:
    """T(u) H, transposed: a signal (time,) by each column of H, (knot, time).

    A column of H is one from the first knot to its own, and from there falls to zero at the next in
    a straight line: it makes a running sum of u, less the mean of earlier ones.
    """
    N, before = len(signal), knots[-1] + 1
    sums = np.append(np.zeros(before), np.cumsum(signal))
    now, rows = sums[before - knots[0] :][:N], []
    for knot, gap in zip(knots, np.append(np.diff(knots), 1), strict=True):
        earlier = uniform_filter1d(sums, gap, mode="constant", origin=(gap - 1) // 2)
        rows.append(now - earlier[before - 1 - knot :][:N])
    return rows


class Data(NamedTuple):
    """All that the records say of the unknowns of a layout: products Z Z' of Z = [X, y, ...]'.

    Z is without offset and slope. Means over trials are apart, as they have a weight of their own.
    """

    layout: Layout
    single: np.ndarray  # of differences between trials, and of trials that are alone
    means: np.ndarray  # of means over several trials
    n: int  # samples, less two of each series for offset and slope
    n_1: int  # those of means, which are among them

    def weighted(self, weight: float) -> np.ndarray:
        """The products of all series, with a weight for the means."""
        return self.single + weight * self.means


def products(
    groups: Sequence[Trials], layout: Layout, beside: Callable[[Series], Sequence] = lambda _: ()
) -> Data:
    """The products of [X, y], and of more rows behind them.

    `beside` returns these rows of a series, (row, time).
    """
    single, means, n, n_1 = 0.0, 0.0, 0, 0
    for series in series_of(groups):
        rows = np.vstack([regressors(series, layout), series.y, *beside(series)])
        rows = _without_line(rows[:, layout.skipped :])
        products, samples = rows @ rows.T, rows.shape[1] - 2
        if series.is_mean:
            means, n_1 = means + products, n_1 + samples
        else:
            single = single + products
        n += samples
    return Data(layout, single, means, n, n_1)


def _without_line(rows):
    """Rows (row, time), from which offset and slope are taken out in place."""
    line = np.linalg.qr(np.vander(np.linspace(-1, 1, rows.shape[1]), 2))[0]
    rows -= (rows @ line) @ line.T
    return rows


def data_of(groups: Sequence[Trials], direct: bool, delays: np.ndarray, gain=None) -> Data:
    """What trials say for some delays.

    `direct`: see `layout_of`; `delays`: of all inputs, (m + d,); `gain`: P at rest, (m,), if it is
    known.
    """
    layout = layout_of(groups, direct, delays)
    data = products(groups, layout)
    for j, known in enumerate(() if gain is None else gain):
        data = data._replace(single=data.single + _at_rest(layout, j, known))
    return data


def _at_rest(layout, j, known):
    """The products of one more row of [X, y], nearly without an error: B_j(1) = known A(1)."""
    row, rest = np.zeros(layout.size + 1), np.zeros(1)
    row[layout.where(Kind.A)] = -known * layout.waves_of_A(rest)[0].real
    row[layout.where_B(j)] = layout.waves_of_B(j, rest)[0].real
    row[-1] = known
    return WEIGHT_AT_REST * np.outer(row, row)
