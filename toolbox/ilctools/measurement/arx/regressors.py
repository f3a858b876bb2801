"""The regressors of equation (1) in `unknowns`, and their products, summed over all series.

A series is the mean of trials or a difference between them, see `trials`. T(u) is the matrix of
lagged samples of u, and `unknowns` defines H. A drift is straight between samples that are called
knots, and consists of ramps from knot to knot. Then

    X = [-T(y) H, T(u_1) H, ..., T(u_m) H, parts, T(1, 0, 0 ...) H, ramps].

The line of (1), an offset and a slope of each series, is removed from X and y beforehand. The later
steps need X' X, X' y and y' y, but not X. These products are added up series by series.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from ilctools.measurement.arx.trials import Series, Trials, series_of
from ilctools.measurement.arx.unknowns import DRIFT_KNOTS, Kind, Layout, layout_of

# The weight of a known P at rest among the products: the fit meets P to a thousandth of s.
WEIGHT_AT_REST = 1e6
STRETCH = 8192  # samples of X at a time, which take some 30 MB


class Regressors:
    """The transposed regressors X' of a series, shape (unknown, time).

    X' is computed in parts, because the whole matrix may take gigabytes.
    """

    def __init__(self, series: Series, layout: Layout):
        self.samples, self.layout = len(series.y), layout
        self._lagged = [(layout.where(Kind.A), Lagged(-series.y, layout.knots_of_A))]
        self._parts = []
        for j, (u, knots) in enumerate(zip(series.u.T, layout.knots_of_B, strict=True)):
            self._lagged.append((layout.where(Kind.B, j), Lagged(u, knots)))
            self._parts.append((layout.where(Kind.PART, j), layout.parts.answers(u)))
        if not layout.skipped:
            start = Lagged(np.eye(1, self.samples)[0], layout.knots_of_start)
            self._lagged.append((layout.where(Kind.START, series.key), start))
        self._drifts, self._group = series.key.has_what_repeats, series.key.group

    def rows(self, begin: int = 0, end: int | None = None) -> np.ndarray:
        """Compute X' from sample `begin` up to the sample before `end`."""
        end = self.samples if end is None else end
        X = np.zeros((self.layout.size, end - begin))
        for where, lagged in self._lagged:
            lagged.write(X[where], begin)
        for where, answers in self._parts:
            X[where] = answers[:, begin:end]
        if self._drifts:  # from zero before a knot to one at the next knot
            ends = np.linspace(0, self.samples - 1, DRIFT_KNOTS + 1)
            ramps = np.clip((np.arange(begin, end) - ends[:-1, None]) / ends[1], 0, 1)
            X[self.layout.where(Kind.DRIFT, self._group)] = ramps
        return X


class Lagged:
    """The transpose of T(u) H, shape (knot, time).

    This is a signal u, shape (time,), that is filtered by each column of H. A column of H has the
    value one from the first knot to its own knot. From there the column falls to zero at the next
    knot, in a straight line. Each column therefore computes a running sum of u, minus the mean of
    earlier running sums.
    """

    def __init__(self, signal: np.ndarray, knots: np.ndarray):
        self._knots, self._before = knots, knots[-1] + 1
        self._sums = np.append(np.zeros(self._before), np.cumsum(signal))

    def write(self, rows: np.ndarray, begin: int = 0) -> None:
        """Write the transpose of T(u) H into `rows`, shape (knot, time), from `begin` on."""
        knots, begin = self._knots, begin + self._before
        end = begin + rows.shape[1]
        now = self._sums[begin - knots[0] : end - knots[0]]
        for row, knot, gap in zip(rows, knots, np.append(np.diff(knots), 1), strict=True):
            # running sums from one knot earlier up to the next knot earlier
            earlier = self._sums[begin - knot - gap : end - knot - 1]
            if gap > 1:
                earlier = uniform_filter1d(earlier, gap, origin=(gap - 1) // 2)[gap - 1 :]
            np.subtract(now, earlier, out=row)


class Data(NamedTuple):
    """All information about the unknowns of a layout: products Z Z'.

    Z = [X, y, ...]' holds the regressors, the output and possibly further rows. Offset and slope
    are removed from Z. Means over trials are kept apart, because they have a weight of their own.
    """

    layout: Layout
    single: np.ndarray  # products of differences between trials, and of single trials
    means: np.ndarray  # products of means over several trials
    n: int  # number of samples, minus two of each series for offset and slope
    n_1: int  # number of samples of means among the n samples

    def weighted(self, weight: float) -> np.ndarray:
        """Add up the products of all series; the products of means have this weight."""
        return self.single + weight * self.means


def products(
    groups: Sequence[Trials], layout: Layout, beside: Callable[[Series], Sequence] = lambda _: ()
) -> Data:
    """Compute Z Z', summed over all series.

    Z consists of the rows of X', y' and the further rows that `beside` returns. An offset and a
    slope are removed from each series beforehand. For a series, `beside` returns rows of the shape
    (row, time).
    """
    single, means, n, n_1 = 0.0, 0.0, 0, 0
    for series in series_of(groups):
        products = _products(Regressors(series, layout), np.vstack([series.y, *beside(series)]))
        samples = len(series.y) - layout.skipped - 2
        if series.is_mean:
            means, n_1 = means + products, n_1 + samples
        else:
            single = single + products
        n += samples
    return Data(layout, single, means, n, n_1)


def _products(regressors, beside):
    """Compute Z Z' - (Z l) (Z l)' of one series.

    These are the products Z Z' after an offset and a slope are removed from the rows of Z.
    """
    skipped = regressors.layout.skipped
    line = line_of(beside.shape[1] - skipped)
    products, on_line = 0.0, 0.0
    for begin in range(skipped, beside.shape[1], STRETCH):
        end = min(begin + STRETCH, beside.shape[1])
        Z = np.vstack([regressors.rows(begin, end), beside[:, begin:end]])
        products = products + Z @ Z.T
        on_line = on_line + Z @ line[begin - skipped : end - skipped]
    return products - on_line @ on_line.T


def line_of(samples: int) -> np.ndarray:
    """Compute an orthonormal basis of all offsets and slopes, shape (samples, 2)."""
    return np.linalg.qr(np.vander(np.linspace(-1, 1, samples), 2))[0]


def data_of(
    groups: Sequence[Trials],
    direct: bool,
    delays: np.ndarray,
    gain: Sequence[float] = (),
    resonances: Sequence[float] = (),
) -> Data:
    """Compute the products of trials for given delays.

    `layout_of` explains `direct` and `resonances`. `delays` are the delays of all inputs, (m + d,).
    `gain` is P at zero frequency, (m,), or empty if this is not known.
    """
    layout = layout_of(groups, direct, delays, resonances)
    data = products(groups, layout)
    for j, known in enumerate(gain):
        data = data._replace(single=data.single + _at_rest(layout, j, known))
    return data


def _at_rest(layout, j, known):
    """Compute the products of a further row of [X, y], which states B_j(1) = known A(1).

    The weight of this row is so large that the equation holds almost exactly.
    """
    row, rest = np.zeros(layout.size + 1), np.zeros(1)
    row[layout.where(Kind.A)] = -known * layout.waves_of_A(rest)[0].real
    row[layout.where_B(j)] = layout.waves_of_B(j, rest)[0].real
    row[-1] = known
    return WEIGHT_AT_REST * np.outer(row, row)
