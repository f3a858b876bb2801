"""The regressors of (1), and the products to which the series add up.

With T(u) the matrix of the lags of u, H as in `unknowns`, and ramps from knot to knot for a drift,

    X = [-T(y) H, T(u_1) H, ..., T(u_m) H, slow parts, T(1, 0, 0 ...) H, ramps].

The line of (1), an offset and a slope of each series, is taken out of X and y beforehand. Nothing
that follows needs X, but X' X, X' y and y' y. They are added up series by series, and of a long one
stretch by stretch: X of 100,000 samples has some 300 MB.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from ilctools.measurement.arx.trials import Series, Trials, series_of
from ilctools.measurement.arx.unknowns import Kind, Layout, layout_of

STRETCH = 2048  # samples whose regressors fit into a processor's cache
# The weight of a known P at rest among the products: it is met to a thousandth of the noise s.
WEIGHT_AT_REST = 1e6


class Regressors(NamedTuple):
    """X' of a series, (row, time), in two parts."""

    # of A and each B: each gives its rows in a stretch of time, which are too many for all of it
    by_lags: list[Callable[[slice], np.ndarray]]
    others: np.ndarray  # of slow parts, starts and drifts

    def rows(self, stretch: slice) -> np.ndarray:
        """All rows in a stretch of time."""
        return np.vstack([*(part(stretch) for part in self.by_lags), self.others[:, stretch]])


def regressors(series: Series, layout: Layout) -> Regressors:
    """X' of a series, in the order of the layout's unknowns."""
    N = len(series.y)
    knots = (layout.knots_of_A, *layout.knots_of_B)
    by_lags = [lagged(x, at) for x, at in zip([-series.y, *series.u.T], knots, strict=True)]
    first = layout.where(Kind.SLOW, 0).start  # behind A and all B
    others = np.zeros((layout.size - first, N))

    def rows_of(kind, owner):
        where = layout.where(kind, owner)
        return others[where.start - first : where.stop - first]

    for j, u in enumerate(series.u.T):
        rows_of(Kind.SLOW, j)[:] = [lfilter([0, 1 - p], [1, -p], u) for p in layout.poles]
    if not layout.skipped:
        at_first = np.arange(N) == 0
        rows_of(Kind.START, series.key)[:] = lagged(at_first, layout.knots_of_start)(slice(None))
    if series.key.has_what_repeats:  # a drift is common to the trials of a group
        drift = rows_of(Kind.DRIFT, series.key.group)
        drift[:] = _ramps(N, len(drift))
    return Regressors(by_lags, others)


def _ramps(N, knots):
    """From zero before a knot of a drift to one at the next, (knot, time)."""
    ends = np.linspace(0, N - 1, knots + 1)
    return np.clip((np.arange(N) - ends[:-1, None]) / ends[1], 0, 1)


def lagged(signal: np.ndarray, knots: np.ndarray) -> Callable[[slice], np.ndarray]:
    """T(u) H, transposed, of a stretch of time: a signal (time,) by each column of H, (knot, time).

    A column of H is one from the first knot to its own, and from there falls to zero at the next in
    a straight line: it makes a running sum of u, less the mean of earlier ones.
    """
    gap, before, N = np.append(np.diff(knots), 1), knots[-1] + 1, len(signal)
    sums = np.append(np.zeros(before), np.cumsum(signal))
    lengths, which = np.unique(gap, return_inverse=True)
    means = [uniform_filter1d(sums, n, mode="constant", origin=(n - 1) // 2) for n in lengths]
    now, earlier = sums[before - knots[0] :][:N], sliding_window_view(means, N, axis=1)
    return lambda stretch: now[stretch] - earlier[which, before - 1 - knots, stretch]


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
        Z = regressors(series, layout)
        Z = Z._replace(others=np.vstack([Z.others, series.y, *beside(series)]))
        for rows in _without_line(Z, len(series.y), layout.skipped):
            added = rows @ rows.T
            single, means = single + added * (not series.is_mean), means + added * series.is_mean
        own = len(series.y) - layout.skipped - 2
        n, n_1 = n + own, n_1 + own * series.is_mean
    return Data(layout, single, means, n, n_1)


def _without_line(Z, N, skipped):
    """Rows of one series without offset and slope, stretch by stretch, from a first sample on."""
    line = np.linalg.qr(np.vander(np.linspace(-1, 1, N - skipped), 2))[0]
    line = np.pad(line, ((skipped, 0), (0, 0)))
    stretches = [slice(t, t + STRETCH) for t in range(skipped, N, STRETCH)]
    along = sum(Z.rows(now) @ line[now] for now in stretches)
    for now in stretches:
        yield Z.rows(now) - along @ line[now].T


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
