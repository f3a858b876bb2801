"""The estimator: P of one output from signals as they come, and how far off it may be.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + line(t) + drift(t) + e(t)      (1)

The inputs u are those that were commanded, of which P is asked, and then the known disturbances,
which were measured. A known disturbance has a B of its own, which is estimated like the others.

A is monic, B and A have as many lags as a quarter of the longest record, and e is white with
variance s^2: P = B / A, of the commanded inputs. A start, which is not known, leaves a response as
long; the line is an offset and a slope of each record, the drift a random walk. Beside its lags
each B has slow parts x (1 - p) / (z - p) with time constants of the longest record and a third of
it: what is small and far slower than the rest would else be taken for drift, and its error not be
seen.

*Prior.* Coefficients decay and neighbours are alike, by the tuned-correlated kernel
s^2 c exp(-max(i, j) / T), with one c for A, one for B, one for starts and one for drifts, and one T
(T. Chen, H. Ohlsson and L. Ljung, Automatica 48 (2012) 1525-1535; G. Pillonetto and others,
Automatica 50 (2014) 657-682). In increments x from lag to lag it is diagonal,

    x ~ N(0, s^2 D(eta)),    D = c (exp(-i / T) - exp(-(i + gap) / T)),                         (2)

and of a slow part D = c, with the logarithms of c and T in eta; what a start leaves, an input that
rested elsewhere among it, decays from the latest delay on only. Far lags share increments: knots,
between which coefficients are on straight lines. Lags of B are counted from a delay of each input,
where the posterior is larger for it: a little less than the lag of largest correlation of the
signals, or of their moves, in whose spectrum phases count more than sizes (C. H. Knapp and G. C.
Carter, IEEE Trans. Acoust. Speech Signal Process. 24 (1976) 320-327).

*Posterior.* With the regressors of (1), T(u) the matrix of the lags of u, H their increments,

    X = [-T(y) H, T(u_1) H, slow parts, ..., T(u_m) H, slow parts, T(1, 0, 0 ...) H, ramps]

without offset and slope, and so y,

    U' U = I + D^(1/2) X' X D^(1/2),    x = D^(1/2) U^-1 h,    U' h = D^(1/2) X' y,             (3)
    s^2 = r / n,    r = y' y - h' h.

Over trials, a disturbance that repeats shows in their mean only, which has a weight of 1 / (1 +
exp(rho)), the sixth entry of eta.

*Hyperparameters.* The maximum of the marginal likelihood times a wide normal prior,

    n / 2 log r + log |U| + |(eta - centre) / wide|^2 / 2 -> min.                               (4)

It may have two maxima, with a drift and without one: the search starts near both. They are normal
about the larger with the inverse of the curvature S S', and integrated over by the points
eta + HEAVY sqrt(d) S_k, eta - HEAVY sqrt(d) S_k, d the number of entries (I. Arasaratnam and S.
Haykin, IEEE Trans. Autom. Control 54 (2009) 1254-1269, where HEAVY is one).

*Error of P.* To first order it is normal,

    dP_j = (dB_j - P_j dA) / A,                                                                 (5)

from x by (3), and from the points, at which P is another. No number is random.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import cholesky, helmert, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.special import diric, expit

SHARE = 4  # of the longest record: lags of A and B
SLOW = np.array([1.0, 3.0])  # longest records in time constants of slow parts
# Knots are one lag apart up to CLOSE, then 1 + (lag - CLOSE) // STEP; of starts, coarser.
CLOSE, STEP = 40, 8
STARTS = 300  # unknowns of all starts at most; with more, first samples are left out
KNOTS = 64  # of a drift, between which it is straight
STRETCH = 2048  # samples whose regressors fit into a processor's cache
# Before the data: of log(c s^2) of A, B, starts, log c of drifts, log T in samples, rho, and of
# log(c s^2) of slow parts: a twentieth of the output's size, as their motion, like drift's, says no
# other.
CENTRE = np.array([-4.0, -4.0, -4.0, -3.0, 2.3, 0.0, -5.8])
WIDE = np.array([3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 0.5])  # their standard deviations
SIZES = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0])  # relative to the output, not to the noise
# Where the search starts: without a drift, and with one.
FIRST = [CENTRE + 6 * SIZES + drift * (np.arange(7) == 3) for drift in (0.0, 9.0)]
BOUND = 50.0  # of all logarithms
LATE = 5  # samples: the least lag of largest correlation that counts as a delay
ROOM = 0.9, 0.98  # delays that are tried, relative to that lag of the signals and of their moves
PHASES = 0.8  # power of the sizes that is taken out of a spectrum: of 1, only phases would count
STEPS = 1e-3  # of eta, for the curvature
HEAVY = 1.2  # tails of eta, relative to normal ones


class Trials(NamedTuple):
    """Trials of the same length, in each of which the same disturbance may repeat."""

    u: np.ndarray  # commanded inputs, (trial, time, m), relative to before the trial
    y: np.ndarray  # (trial, time, p), relative to the first sample
    names: tuple[str, ...]  # of the trials, in messages
    # the known ones (trial, time, d), relative to the first sample; None if there are none
    disturbance: np.ndarray | None = None

    @property
    def inputs(self) -> np.ndarray:
        """The commanded inputs, and after them the known disturbances, (trial, time, m + d)."""
        if self.disturbance is None:
            return self.u
        return np.concatenate([self.u, self.disturbance], axis=2)


def longest_of(groups: Sequence[Trials]) -> int:
    """Samples of the longest trial."""
    return max(group.y.shape[1] for group in groups)


class Channels(NamedTuple):
    """How many inputs records have."""

    commanded: int  # of which P is asked
    all: int  # with the known disturbances, which stand behind them

    @classmethod
    def of(cls, groups: Sequence[Trials]) -> "Channels":
        """Those of any of the groups, as all have the same."""
        return cls(groups[0].u.shape[2], groups[0].inputs.shape[2])


@dataclass(frozen=True)
class _Layout:
    """Unknowns x, in blocks: increments of A, of each B, of starts, of drifts, and slow parts."""

    # 0 for A, 1 ... m for the inputs, m + 1 for starts, m + 2 for drifts, (unknown,)
    kind: np.ndarray
    c: np.ndarray  # which entry of eta has the c of each, (unknown,)
    lag: np.ndarray  # (unknown,)
    gap: np.ndarray  # (unknown,): to the next lag; infinite at the last
    knots: tuple[np.ndarray, ...]  # lags of A, then of each B, between which lines are straight
    start: np.ndarray  # likewise, of what a start leaves
    starts: int  # records with an unknown start
    poles: np.ndarray  # of slow parts

    @property
    def skipped(self) -> int:
        """Samples at the beginning of each record that are left out, where starts are too many."""
        return 0 if self.starts else self.knots[0][-1]

    def prior(self, eta) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of D, (2), and their slope over log T."""
        lag, gap = self.lag * np.exp(-eta[4]), np.minimum(self.gap * np.exp(-eta[4]), BOUND)
        return eta[self.c] - lag + np.log(-np.expm1(-gap)), lag - gap / np.expm1(gap)

    def waves(self, omega) -> list[np.ndarray]:
        """What A, then each B, are of their unknowns at angles omega Ts, (n, unknown) each."""
        slow = (1 - self.poles) / (np.exp(1j * omega)[:, None] - self.poles)
        A, *B = (waves(knots, omega) for knots in self.knots)
        return [A, *(np.hstack([wave, slow]) for wave in B)]


def _knots(first, last, close, step):
    knots = [first]
    while knots[-1] < last:
        apart = 1 + max(0, knots[-1] - close) // step
        knots.append(min(last, knots[-1] + apart))
    return np.array(knots)


def _layout(groups, direct, delays):
    longest, records = longest_of(groups), sum(len(group.y) for group in groups)
    m, reach, poles = len(delays), max(4, longest // SHARE), np.exp(-SLOW / longest)
    past, at_once = (_knots(first, reach, CLOSE, STEP) for first in (1, 0))
    commanded = Channels.of(groups).commanded
    # A disturbance does not follow y: y(t) may depend on it at t, whatever the commands do.
    moves = [at_once if direct or j >= commanded else past for j in range(m)]
    # An input that rested elsewhere before is still on its way until the latest delay.
    start, late = _knots(0, reach, CLOSE // 6, STEP // 2), delays.max()
    start = np.unique(np.append(0, late + start))
    starts = records if records * len(start) <= STARTS else 0
    inputs = range(1, m + 1)  # kind, c, knots; of slow parts and drifts D = c
    of_B = [(j, 1, own) for j, own in zip(inputs, moves, strict=True)]
    blocks = [(0, 0, past), *of_B, *((j, 6, 0 * poles) for j in inputs)]
    blocks += [(m + 1, 2, start)] * starts + [(m + 2, 3, np.zeros(KNOTS))] * len(groups)
    kind, c, lag, gap = np.hstack([_of_block(*block) for block in blocks])
    lag[c == 2] = np.maximum(lag[c == 2] - late, 0)
    knots = (past, *(own + delay for own, delay in zip(moves, delays, strict=True)))
    return _Layout(kind, c.astype(int), lag, gap, knots, start, starts, poles)


def _of_block(kind, c, knots):
    """Kind, c, lag and gap of each knot."""
    gap = np.append(np.diff(knots), 0.0)
    both = np.full((2, len(knots)), [[kind], [c]])
    return np.vstack([both, knots - knots[0], np.where(gap > 0, gap, np.inf)])


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


def waves(knots: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """The frequency response of each column of H, (n, knot), by sums of geometric series."""
    gap, omega = np.append(np.diff(knots), 1), np.where(omega, omega, 1e-200)[:, None]
    earlier = np.exp(-1j * omega * (knots + (gap + 1) / 2)) * diric(omega, gap)
    return (np.exp(-1j * omega * knots[0]) - earlier) / (1 - np.exp(-1j * omega))


def _coefficients(x, knots, n):
    """H x, filled up with zeros, or cut off, to n lags."""
    return np.interp(np.arange(n), knots, np.cumsum(x[::-1])[::-1], 0, 0)


def contrasts(signal: np.ndarray) -> np.ndarray:
    """Of K trials: sqrt(K) times their mean, then their differences."""
    return np.tensordot(helmert(len(signal), full=True), signal, 1)


def _regressors(groups, layout):
    """Of each record: regressors of A and B; others, without lags, (row, time); y; if a mean."""
    c = layout.c[layout.c > 1]  # of slow parts, starts, drifts
    starts, drifts = np.flatnonzero(c == 2), np.flatnonzero(c == 3)
    starts = iter(starts.reshape(-1, len(layout.start)))
    for group, drift in zip(groups, drifts.reshape(len(groups), -1), strict=True):
        t, ends = np.arange(group.y.shape[1]), np.linspace(0, group.y.shape[1] - 1, KNOTS + 1)
        signals = zip(contrasts(group.inputs), contrasts(group.y[..., 0]), strict=True)
        for k, (u, y) in enumerate(signals):
            dynamics = [lagged(x, at) for x, at in zip([-y, *u.T], layout.knots, strict=True)]
            others = np.zeros((len(c), len(t)))
            others[c == 6] = [lfilter([0, 1 - p], [1, -p], x) for x in u.T for p in layout.poles]
            if layout.starts:
                others[next(starts)] = lagged(t == 0, layout.start)(slice(None))
            if k == 0:  # which the trials have in common
                others[drift] = np.clip((t - ends[:-1, None]) / ends[1], 0, 1)
            yield dynamics, others, y, int(k == 0 and len(group.y) > 1)


def products(groups, layout, beside=None) -> tuple[list[np.ndarray], np.ndarray]:
    """Of [X, y] and more rows of each record, `beside`, (row, time), without offset and slope.

    Of differences and single records; and of means over trials. And how many samples each are of.
    """
    total, count, first = [0.0, 0.0], np.zeros(2), layout.skipped
    for dynamics, others, y, mean in _regressors(groups, layout):
        line = np.linalg.qr(np.vander(np.linspace(-1, 1, len(y) - first), 2))[0]
        line = np.pad(line, ((first, 0), (0, 0)))
        others = np.vstack([others, y, *(next(beside) if beside else ())])
        stretches = [slice(t, t + STRETCH) for t in range(first, len(y), STRETCH)]
        along = sum(_rows(dynamics, others, now) @ line[now] for now in stretches)
        for now in stretches:
            rows = _rows(dynamics, others, now) - along @ line[now].T
            total[mean] = total[mean] + rows @ rows.T
        count[mean] += len(y) - first - 2
    return total, count


def _rows(dynamics, others, now):
    """Those of a stretch of time."""
    return np.vstack([*(part(now) for part in dynamics), others[:, now]])


class _Normal(NamedTuple):
    """Products of [X, y]; of differences and single records, and of means over trials."""

    products: list[np.ndarray]  # (unknown + 1, unknown + 1) each
    count: np.ndarray  # n, (2,)
    layout: _Layout


def _normal(groups, layout, gain):
    p, (total, count) = len(layout.kind), products(groups, layout)
    A, *B = (wave[0].real for wave in layout.waves(np.zeros(1)))
    for j, known in enumerate(() if gain is None else gain):  # B_j(1) = gain A(1)
        row = np.append(np.zeros(p), known)
        row[:p][layout.kind == 0], row[:p][layout.kind == 1 + j] = -known * A, B[j]
        total[0] += 1e6 * np.outer(row, row)  # by a thousandth of the noise
    return _Normal(total, count, layout)


class _Posterior(NamedTuple):
    """(3): of unknowns in units of `size`, the root of D."""

    size: np.ndarray
    U: np.ndarray
    h: np.ndarray
    rss: float  # r, a residual sum of squares
    weight: float  # of means over trials, in which a disturbance may repeat

    @property
    def mean(self) -> np.ndarray:
        """x."""
        return self.size * solve_triangular(self.U, self.h)


def _posterior(eta, data):
    weight = expit(-eta[5]) if data.count[1] else 1.0
    size = np.exp(data.layout.prior(eta)[0] / 2)
    products = data.products[0] + weight * data.products[1]
    A = size[:, None] * products[:-1, :-1] * size
    A[np.diag_indices_from(A)] = A.diagonal() * (1 + 1e-12) + 1
    # Also without noise it is positive definite: what is added is more than Cholesky's rounding, a
    # few hundred times 1e-16 of the diagonal.
    U = cholesky(A, check_finite=False)
    h = solve_triangular(U, size * products[:-1, -1], trans=1, check_finite=False)
    power = products[-1, -1]
    return _Posterior(size, U, h, max(power - h @ h, 1e-14 * power), weight)  # rounding is noise


def negative_log_posterior(eta: np.ndarray, data: _Normal) -> tuple[float, np.ndarray]:
    """(4) and its gradient.

    With z = D^(-1/2) x, the weight w of means (X_1, y_1), and n' = n + 2 SIZES' (eta - centre) /
    wide^2, as sizes are relative to s,

        d / d log D_i = (1 - (U' U)^-1_ii - n' z_i^2 / r) / 2,    d w / d rho = -w (1 - w),
        d / d w = (n' |y_1 - X_1 x|^2 / r + tr((U' U)^-1 D^(1/2) X_1' X_1 D^(1/2)) - n_1 / w) / 2.
    """
    layout, n, n_1 = data.layout, data.count.sum(), data.count[1]
    size, U, h, r, w = _posterior(eta, data)
    off = (eta + SIZES * np.log(r / n) - CENTRE) / WIDE
    value = n / 2 * np.log(r) + np.log(np.diag(U)).sum() + off @ off / 2 - n_1 / 2 * np.log(w)
    z, inverse = solve_triangular(U, h, check_finite=False), dpotri(U)[0]  # its upper half
    more = n + 2 * SIZES @ (off / WIDE)  # n'
    slope = (1 - np.diag(inverse) - more * z**2 / r) / 2
    gradient = np.bincount(layout.c, slope, len(eta)) + off / WIDE
    gradient[4] += slope @ layout.prior(eta)[1]
    if n_1:
        inverse += np.triu(inverse, 1).T
        products, residual = data.products[1], np.append(-size * z, 1.0)
        trace = size @ (inverse * products[:-1, :-1]) @ size
        of_w = more * (residual @ products @ residual) / r + trace - n_1 / w
        gradient[5] -= w * (1 - w) / 2 * of_w
    return value, gradient


class _Fit(NamedTuple):
    """The likeliest hyperparameters of a layout."""

    eta: np.ndarray
    cost: float  # minus the logarithm of the posterior, of the delays, too
    data: _Normal
    delays: np.ndarray  # of all inputs, samples


def _fitted(groups, direct, delays, gain, first=FIRST):
    longest = longest_of(groups)
    data = _normal(groups, _layout(groups, direct, delays), gain)
    bounds = [(-BOUND, BOUND)] * len(CENTRE)
    bounds[4] = -1.5, np.log(5 * longest)
    searches = [
        minimize(
            negative_log_posterior, eta, (data,), jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": 60, "ftol": 1e-7},
        )
        for eta in first
    ]  # fmt: skip
    found = min(searches, key=lambda search: search.fun)
    late = sum(delays[part].any() for part in _delayed_together(groups))
    rare = np.log(longest) * late  # before the data, any delay is as likely as another
    return _Fit(found.x, found.fun + rare, data, delays)


def _delayed_together(groups):
    """Inputs whose delays are searched for at once: all commanded ones; each disturbance alone."""
    commanded, inputs = Channels.of(groups)
    return [slice(commanded), *(slice(j, j + 1) for j in range(commanded, inputs))]


def _with_delays(best, groups, direct, gain):
    """The likeliest fit, or with delays that correlations show a likelier one."""
    peaks = [_peaks(groups, differences) for differences in range(len(ROOM))]
    for part in _delayed_together(groups):
        before = best.delays
        for peak, room in zip(peaks, ROOM, strict=True):
            more = np.zeros_like(before)
            more[part] = np.maximum(peak - before, 0)[part]
            if more.max() >= LATE:
                further = before + (room * more).astype(int)
                late = _fitted(groups, direct, further, gain, [best.eta])
                best = min(best, late, key=lambda fit: fit.cost)
    return best


def _polished(fit):
    """The fit to rounding, and S of its curvature, (4)."""
    eta, data = fit.eta.copy(), fit.data

    def gradient(eta):
        return negative_log_posterior(eta, data)[1]

    H = np.array([gradient(eta + e) - gradient(eta - e) for e in STEPS * np.eye(len(eta))])
    values, vectors = np.linalg.eigh((H + H.T) / (4 * STEPS))
    S = vectors / np.sqrt(np.maximum(values, WIDE.max() ** -2)) @ vectors.T  # symmetric: no signs
    for _ in range(4):  # Newton steps, after which eta is known to rounding
        eta -= np.clip(S @ S @ gradient(eta), -1, 1)
    return fit._replace(eta=eta), S


@dataclass(frozen=True)
class Regression:
    """P from m commanded inputs to one output, and the error that it may have."""

    channels: Channels
    mean: np.ndarray  # x, (unknown,)
    data: _Normal
    posterior: _Posterior  # for the likeliest hyperparameters
    C: np.ndarray  # covariance of x, over the points of the quadrature, (unknown, unknown)

    def of(self, kind: int, x: np.ndarray) -> np.ndarray:
        """Those of some unknowns (..., unknown) that are of A, kind 0, or of the input `kind`."""
        return x[..., self.data.layout.kind == kind]

    def response(self, omega: np.ndarray) -> np.ndarray:
        """P at angles omega Ts, shape (n, m)."""
        return self._ratio(*self._waves(omega))[0]

    def _waves(self, omega):
        """Of A, and of each B of which P is asked."""
        A, *B = self.data.layout.waves(omega)
        return A, *B[: self.channels.commanded]

    def _ratio(self, A, *B):
        """P = B / A, and A."""
        below = 1 + A @ self.of(0, self.mean)
        above = [wave @ self.of(1 + j, self.mean) for j, wave in enumerate(B)]
        return np.stack(above, axis=1) / below[:, None], below

    def covariance(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of dP, real parts first, (n, 2 m, 2 m), and of dA / A, (2, n)."""
        A, *B = self._waves(omega)
        (P, below), kind = self._ratio(A, *B), self.data.layout.kind
        slopes = np.zeros((len(omega), len(B) + 1, len(kind)), complex)
        slopes[:, -1, kind == 0] = A / below[:, None]
        for j, wave in enumerate(B):  # (5)
            slopes[:, j] = -P[:, [j]] * slopes[:, -1]
            slopes[:, j, kind == 1 + j] = wave / below[:, None]
        of_P, of_A = np.split(np.stack([slopes.real, slopes.imag]), [-1], axis=2)
        of_P = np.hstack([*of_P])
        return of_P @ self.C @ of_P.swapaxes(1, 2), np.sum(of_A @ self.C * of_A, axis=(2, 3))

    @property
    def denominator(self) -> np.ndarray:
        """The estimate of A, lag by lag."""
        past = self.data.layout.knots[0]
        return np.eye(1, past[-1] + 1)[0] + _coefficients(self.of(0, self.mean), past, past[-1] + 1)

    @property
    def stable(self) -> bool:
        """Whether the estimate of A has no zero outside the unit circle, by how often it turns."""
        a = self.denominator
        turns = np.fft.rfft(a, 2 * len(a) + 4096)
        return bool(abs(np.angle(turns[1:] / turns[:-1]).sum()) < 1)

    def impulse(self, n: int) -> np.ndarray:
        """Impulse responses over n samples to all inputs, (m + d, n): disturbances stand last."""
        poles, B = self.data.layout.poles, []
        for j, knots in enumerate(self.data.layout.knots[1:]):
            x, slow = np.split(self.of(1 + j, self.mean), [len(knots)])
            B.append(_coefficients(x, knots, n))
            B[j][1:] += slow * (1 - poles) @ poles[:, None] ** np.arange(n - 1)
        return lfilter([1.0], self.denominator, np.array(B))


def regression(groups: Sequence[Trials], direct: bool, delays=0, gain=None) -> Regression:
    """Of one output; `direct`: whether y(t) may depend on u(t); what is known of P beforehand.

    `delays`, (m,): of the commanded inputs, at least; if correlations show more, also with that,
    from what is estimated without. `gain`, (m,): P at rest.
    """
    channels = Channels.of(groups)
    least = np.zeros(channels.all, int)  # of a known disturbance nothing is known beforehand
    least[: channels.commanded] = delays
    best = _with_delays(_fitted(groups, direct, least, gain), groups, direct, gain)
    best, S = _polished(best)
    at = _posterior(best.eta, best.data)
    return Regression(channels, at.mean, best.data, at, _covariance(best, S, at.mean))


def _covariance(best, S, mean):
    """Of x, over the points of the quadrature."""
    apart = HEAVY * np.sqrt(len(S)) * np.concatenate([S, -S])
    points, n, C = np.clip(best.eta + apart, -BOUND, BOUND), best.data.count.sum(), 0.0
    for there in (_posterior(eta, best.data) for eta in points):
        off, D = there.mean - mean, np.outer(there.size, there.size)
        C = C + (there.rss / n * dpotri(there.U)[0] * D + np.outer(off, off)) / len(points)
    return np.triu(C) + np.triu(C, 1).T


def _peaks(groups, differences):
    """Lags of largest correlation of each input, or of its moves, with the output, (m + d,)."""
    longest, products = longest_of(groups), 0.0
    for group in groups:
        signals = contrasts(np.concatenate([group.inputs, group.y], axis=2))
        signals = np.diff(signals - signals.mean(axis=1, keepdims=True), differences, axis=1)
        spectra = np.fft.rfft(signals, 2 * longest, axis=1)
        products = products + np.sum(spectra[..., :-1].conj() * spectra[..., -1:], axis=0)
    phases = products / np.maximum(np.abs(products), 1e-300) ** PHASES
    return np.argmax(np.abs(np.fft.irfft(phases, axis=0))[: longest // 2], axis=0)
