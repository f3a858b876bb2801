"""The estimator: P of one output from signals as they come, and how far off it may be.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + line(t) + drift(t) + e(t)      (1)

with A monic, B and A of as many lags as a quarter of the longest record, and e white with variance
s^2: P = B / A. A start, which is not known, leaves a response as long; the line is an offset and a
slope of each record, the drift a random walk. Beside its lags each B has slow parts
x (1 - p) / (z - p) with time constants of the longest record and a third of it: what is small and
far slower than the rest would else be taken for drift, and its error not be seen.

*Prior.* Coefficients decay and neighbours are alike, by the tuned-correlated kernel
s^2 c exp(-max(i, j) / T), with one c for A, one for B, one for starts and one for drifts, and one T
(T. Chen, H. Ohlsson and L. Ljung, Automatica 48 (2012) 1525-1535; G. Pillonetto and others,
Automatica 50 (2014) 657-682). In increments x from lag to lag it is diagonal,

    x ~ N(0, s^2 D(eta)),    D = c (exp(-i / T) - exp(-(i + gap) / T)),                         (2)

and of a slow part D = c, with the logarithms of c and T in eta. Far lags share increments: knots,
between which coefficients are on straight lines. Lags of B are counted from a delay of each input,
where the posterior is larger for it: a little less than the lag of largest correlation of the
signals, or of their moves, in whose spectrum phases count more than sizes (C. H. Knapp and G. C.
Carter, IEEE Trans. Acoust. Speech Signal Process. 24 (1976) 320-327).

*Posterior.* With the regressors X of (1), without offset and slope,

    U' U = I + D^(1/2) X' X D^(1/2),    x = D^(1/2) U^-1 h,    U' h = D^(1/2) X' y,             (3)
    s^2 = (y' y - h' h) / n.

Over trials, a disturbance that repeats shows in their mean only, which has a weight of 1 / (1 +
exp(rho)), the sixth entry of eta.

*Hyperparameters.* The maximum of the marginal likelihood times a wide normal prior,

    n / 2 log(y' y - h' h) + log |U| + |(eta - centre) / wide|^2 / 2 -> min.                     (4)

It may have two maxima, with a drift and without one: the search starts near both. They are normal
about the larger with the inverse of the curvature S S', and integrated over by the points
eta + HEAVY sqrt(d) S_k, eta - HEAVY sqrt(d) S_k, d the number of entries (I. Arasaratnam and S.
Haykin, IEEE Trans. Autom. Control 54 (2009) 1254-1269, where HEAVY is one).

*Error of P.* To first order it is normal,

    dP_j = (dB_j - P_j dA) / A,                                                                 (5)

from x by (3), and from the points, at which P is another. No number is random.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, helmert, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize
from scipy.signal import fftconvolve, lfilter
from scipy.special import expit, log_expit

from ilctools.errors import LogError

SHARE = 4  # of the longest record: lags of A and B
SLOW = np.array([1.0, 3.0])  # longest records in time constants of slow parts
# Knots are one lag apart up to CLOSE, then 1 + (lag - CLOSE) // STEP.
CLOSE, STEP = 40, 8
START = (6, 4)  # likewise, for what a start leaves
STARTS = 300  # unknowns of all starts at most; with more, first samples are left out
KNOTS = 64  # of a drift, between which it is straight
# Before the data: of log(c s^2) of A, B, starts, log c of drifts, log T in samples, rho, and of
# log(c s^2) of slow parts: a twentieth of the output's size, as their motion, like drift's, says no
# other.
CENTRE = np.array([-4.0, -4.0, -4.0, -3.0, 2.3, 0.0, -5.8])
WIDE = np.array([3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 0.5])  # their standard deviations
SIZES = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0])  # relative to the output, not to the noise
DRIFTS = 0.0, 9.0  # log c of drifts above its centre, where the search starts
FIRST = [CENTRE + 6 * SIZES + drift * (np.arange(7) == 3) for drift in DRIFTS]
BOUND = 50.0  # of all logarithms
EXACT = 1e-14  # least noise, in the power of the output
LATE = 5  # samples: the least lag of largest correlation that counts as a delay
ROOM = 0.9, 0.98  # delays that are tried, relative to that lag of the signals and of their moves
PHASES = 0.8  # power of the sizes that is taken out of a spectrum: of 1, only phases would count
STEPS = 1e-3  # of eta, for the curvature
HEAVY = 1.2  # tails of eta, relative to normal ones
POLISH = 4  # Newton steps with it, after which eta is known to rounding
SURE = 1e6  # weight of a gain at rest that is known: by a thousandth of the noise
TURN = 4096  # frequencies at least on which the zeros of A are counted


class Trials(NamedTuple):
    """Trials of the same length, in each of which the same disturbance may repeat."""

    u: np.ndarray  # (trial, time, m), relative to before the trial
    y: np.ndarray  # (trial, time, p), relative to the first sample
    names: tuple[str, ...]  # of the trials, in messages


@dataclass(frozen=True)
class _Layout:
    """Unknowns, increments of coefficients: y's lags, those of each input, starts and drifts."""

    # 0 for y, 1 ... m for the inputs, m + 1 for starts, m + 2 for drifts, (unknown,)
    kind: np.ndarray
    c: np.ndarray  # which entry of eta has the c of each, (unknown,)
    lag: np.ndarray  # (unknown,)
    gap: np.ndarray  # (unknown,): to the next lag; infinite at the last
    knots: np.ndarray  # of A
    moved: tuple[np.ndarray, ...]  # of each B
    poles: np.ndarray  # of its slow parts
    start: np.ndarray  # (time, k)
    starts: int  # records with an unknown start

    @property
    def skipped(self) -> int:
        """Samples at the beginning of each record that are left out, where starts are too many."""
        return 0 if self.starts else len(self.start) - 1

    def prior(self, eta) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of D, (2), and their slope over log T."""
        lag, gap = self.lag * np.exp(-eta[4]), self.gap * np.exp(-eta[4])
        shorter = np.where(gap < BOUND**2, gap, 0) / np.expm1(np.clip(gap, 1e-300, BOUND))
        return eta[self.c] - lag + np.log(-np.expm1(-gap)), lag - shorter


def _knots(first, last, close, step):
    knots = [first]
    while knots[-1] < last:
        apart = 1 + max(0, knots[-1] - close) // step
        knots.append(min(last, knots[-1] + apart))
    return np.array(knots)


def increments(knots) -> np.ndarray:
    """One up to a knot, zero from the next one on and before the first, (lag, knot)."""
    lags = np.arange(knots[-1] + 1)
    hats = np.array([np.interp(lags, knots, one) for one in np.eye(len(knots))]).T
    return np.cumsum(hats, axis=1) * (lags >= knots[0])[:, None]


def _lagged(signal, knots):
    """A signal (time,) by each column of the increments, (time, knot), by running sums."""
    N, total = len(signal), np.cumsum(signal)

    def after(values, lag):
        return np.append(np.zeros(min(lag, N)), values)[:N]

    first, columns = after(total, knots[0]), []
    for knot, gap in zip(knots, [*np.diff(knots), 1], strict=True):
        mean = uniform_filter1d(total, gap, mode="constant", origin=(gap - 1) // 2)
        columns.append(first - after(mean, knot + 1))
    return np.stack(columns, axis=1)


def _layout(groups, direct, delays):
    longest = max(group.y.shape[1] for group in groups)
    m, reach, poles = len(delays), max(4, longest // SHARE), np.exp(-SLOW / longest)
    past, moves = (_knots(first, reach, CLOSE, STEP) for first in (1, 0 if direct else 1))
    start = _knots(0, reach, *START)
    records = sum(len(group.y) for group in groups)
    starts = records if records * len(start) <= STARTS else 0
    blocks = [past, *[moves] * m, *[start] * starts]
    blocks += [np.zeros(KNOTS)] * len(groups) + [0 * poles] * m
    sizes = [len(block) for block in blocks]
    kinds = [*range(m + 1), *[m + 1] * starts, *[m + 2] * len(groups), *range(1, m + 1)]
    c = np.repeat([0, *[1] * m, *[2] * starts, *[3] * len(groups), *[6] * m], sizes)
    gap = np.concatenate([np.append(np.diff(block), np.inf) for block in blocks])
    return _Layout(
        kind=np.repeat(kinds, sizes),
        c=c,
        lag=np.concatenate([block - block[0] for block in blocks]),
        gap=np.where(np.isin(c, (3, 6)), np.inf, gap),  # of drifts and slow parts D = c
        knots=past,
        moved=tuple(moves + delay for delay in delays),
        start=increments(start),
        starts=starts,
        poles=poles,
    )


def contrasts(signal: np.ndarray) -> np.ndarray:
    """Of K trials: sqrt(K) times their mean, then their differences."""
    return np.tensordot(helmert(len(signal), full=True), signal, 1)


def records(groups, layout) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]:
    """Regressors (time, unknown), output (time,), offset and slope, and whether it is a mean."""
    number, m = 0, len(layout.moved)
    past, *inputs, starts, drifts = (np.flatnonzero(layout.kind == k) for k in range(m + 3))
    for group, drift in zip(groups, drifts.reshape(len(groups), -1), strict=True):
        u_of, y_of = contrasts(group.u), contrasts(group.y[..., 0])
        N = y_of.shape[1]
        line = np.stack([np.ones(N), np.linspace(-1, 1, N)], axis=1)[layout.skipped :]
        line = np.linalg.qr(line)[0]
        ends = np.linspace(0, N - 1, KNOTS + 1)
        ramps = np.clip((np.arange(N)[:, None] - ends[:-1]) / np.diff(ends), 0, 1)
        for k, (u, y) in enumerate(zip(u_of, y_of, strict=True)):
            X = np.zeros((N, len(layout.kind)))  # (1)
            X[:, past] = -_lagged(y, layout.knots)
            for columns, x, knots in zip(inputs, u.T, layout.moved, strict=True):
                slow = [lfilter([0, 1 - p], [1, -p], x) for p in layout.poles]
                X[:, columns] = np.column_stack([_lagged(x, knots), *slow])
            if layout.starts:
                own = starts.reshape(layout.starts, -1)[number]
                X[: len(layout.start), own] = layout.start[:N]
            if k == 0:
                X[:, drift] = ramps
            number += 1
            X, y = (without(line, signal[layout.skipped :]) for signal in (X, y))
            yield X, y, line, k == 0 and len(y_of) > 1


def convolved(signals: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Signals (trial, time, column) with a finite impulse response."""
    return fftconvolve(signals, lags[None, :, None], axes=1)[:, : signals.shape[1]]


def without(basis: np.ndarray, signals: np.ndarray) -> np.ndarray:
    """Signals (..., time, column) without what an orthonormal basis (time, k) explains."""
    return signals - basis @ (basis.T @ signals)


class _Normal(NamedTuple):
    """Products of regressors and output; of differences and single records, and of means."""

    R: np.ndarray  # (2, unknown, unknown)
    b: np.ndarray  # (2, unknown)
    s: np.ndarray  # (2,)
    count: np.ndarray  # (2,)
    layout: _Layout


class _Posterior(NamedTuple):
    """(3): of unknowns in units of `size`, the root of D."""

    size: np.ndarray
    U: np.ndarray
    h: np.ndarray
    rest: float  # y' y - h' h
    ratio: float  # weight of means over trials, in which a disturbance may repeat

    @property
    def mean(self) -> np.ndarray:
        """Of the unknowns."""
        return self.size * solve_triangular(self.U, self.h)


def _normal(groups, layout, gain):
    p = len(layout.kind)
    R, b, s, count = np.zeros((2, p, p)), np.zeros((2, p)), np.zeros(2), np.zeros(2)
    for X, y, _, mean in records(groups, layout):
        k = int(mean)
        R[k] += X.T @ X
        b[k] += X.T @ y
        s[k] += y @ y
        count[k] += len(y) - 2
    for j, known in enumerate(() if gain is None else gain):  # B_j(1) = gain A(1)
        row = np.zeros(p)
        row[layout.kind == 1 + j] = [*increments(layout.moved[j]).sum(axis=0), *layout.poles**0]
        row[layout.kind == 0] = -known * increments(layout.knots).sum(axis=0)
        R[0] += SURE * np.outer(row, row)
        b[0] += SURE * known * row
        s[0] += SURE * known**2
    return _Normal(R, b, s, count, layout)


def _posterior(eta, data):
    ratio = expit(-eta[5]) if data.count[1] else 1.0
    weights = np.array([1.0, ratio])
    size = np.exp(data.layout.prior(eta)[0] / 2)
    A = size[:, None] * np.tensordot(weights, data.R, 1) * size
    A[np.diag_indices_from(A)] = A.diagonal() * (1 + 1e-12) + 1
    try:
        U = cholesky(A, check_finite=False)
    except LinAlgError:
        raise LogError(
            "log is as exact as rounding, which cannot be distinguished from noise: is it "
            "simulated, or constant? Add noise, as much as the sensors have"
        ) from None
    h = solve_triangular(U, size * (weights @ data.b), trans=1, check_finite=False)
    total = weights @ data.s
    return _Posterior(size, U, h, max(total - h @ h, EXACT * total), ratio)


def surprise(eta: np.ndarray, data: _Normal) -> tuple[float, np.ndarray]:
    """(4), minus the logarithm of the posterior of hyperparameters, and its gradient."""
    layout, count = data.layout, data.count.sum()
    size, U, h, rest, ratio = _posterior(eta, data)
    off = (eta + SIZES * np.log(rest / count) - CENTRE) / WIDE
    value = count / 2 * np.log(rest) + np.log(np.diag(U)).sum() + off @ off / 2  # (4)
    if data.count[1]:
        value -= data.count[1] / 2 * log_expit(-eta[5])
    x = solve_triangular(U, h, check_finite=False)
    inverse = dpotri(U)[0]
    # over log variances, which change log(rest) by -x^2 / rest
    moved = count + 2 * SIZES @ (off / WIDE)
    each = (1 - np.diag(inverse) - moved * x**2 / rest) / 2
    gradient = np.bincount(layout.c, each, len(eta)) + off / WIDE
    gradient[4] += each @ layout.prior(eta)[1]
    if data.count[1]:
        mean, R = size * x, data.R[1]
        left = data.s[1] - 2 * mean @ data.b[1] + mean @ R @ mean
        inverse += np.triu(inverse, 1).T
        trace = np.sum(inverse * (size[:, None] * R * size))
        by_ratio = ratio * (moved * left / rest + trace) - data.count[1]
        gradient[5] -= (1 - ratio) / 2 * by_ratio
    return value, gradient


class _Fit(NamedTuple):
    """The likeliest hyperparameters of a layout."""

    eta: np.ndarray
    surprise: float
    data: _Normal


def _fitted(groups, direct, delays, gain, first=FIRST):
    longest = max(group.y.shape[1] for group in groups)
    data = _normal(groups, _layout(groups, direct, delays), gain)
    bounds = [(-BOUND, BOUND)] * len(CENTRE)
    bounds[4] = -1.5, np.log(5 * longest)
    searches = [
        minimize(
            surprise, eta, (data,), jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": 60, "ftol": 1e-7},
        )
        for eta in first
    ]  # fmt: skip
    found = min(searches, key=lambda search: search.fun)
    rare = np.log(longest) * any(delays)  # before the data, any delay is as likely as another
    return _Fit(found.x, found.fun + rare, data)


def _polished(fit):
    """The fit to rounding, and S of its curvature, (4)."""
    eta, data = fit.eta.copy(), fit.data
    steps = STEPS * np.eye(len(eta))
    H = np.array([surprise(eta + e, data)[1] - surprise(eta - e, data)[1] for e in steps])
    values, vectors = np.linalg.eigh((H + H.T) / (4 * STEPS))
    S = vectors / np.sqrt(np.maximum(values, WIDE.max() ** -2)) @ vectors.T  # symmetric: no signs
    for _ in range(POLISH):
        step = S @ S @ surprise(eta, data)[1]
        eta -= np.clip(step, -1, 1)
    return fit._replace(eta=eta), S


@dataclass(frozen=True)
class Regression:
    """P from m inputs to one output, and the error that it may have."""

    mean: np.ndarray  # x, (unknown,)
    data: _Normal
    posterior: _Posterior  # for the likeliest hyperparameters
    C: np.ndarray  # covariance of x, over the points of the quadrature, (unknown, unknown)

    @property
    def knots(self) -> tuple[np.ndarray, ...]:
        """Lags of A, then of each B, between which coefficients are on straight lines."""
        return self.data.layout.knots, *self.data.layout.moved

    def of(self, kind: int, x: np.ndarray) -> np.ndarray:
        """Those of some unknowns (..., unknown) that are of A, kind 0, or of the input `kind`."""
        return x[..., self.data.layout.kind == kind]

    def _waves(self, omega):
        """What increments make of A, then of each B, at angles omega Ts, (n, knot) each."""
        of_lag = np.exp(-1j * np.outer(omega, np.arange(1 + max(k[-1] for k in self.knots))))
        A, *B = (of_lag[:, : knots[-1] + 1] @ increments(knots) for knots in self.knots)
        poles = self.data.layout.poles
        slow = (1 - poles) / (np.exp(1j * omega)[:, None] - poles)
        return [A, *(np.hstack([wave, slow]) for wave in B)]

    def response(self, omega: np.ndarray) -> np.ndarray:
        """P at angles omega Ts, shape (n, m)."""
        return self._ratio(*self._waves(omega))[0]

    def _ratio(self, A, *B):
        """P = B / A, and A."""
        below = 1 + A @ self.of(0, self.mean)
        above = [wave @ self.of(1 + j, self.mean) for j, wave in enumerate(B)]
        return np.stack(above, axis=1) / below[:, None], below

    def covariance(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of dP, real parts first, (n, 2 m, 2 m), and variances of dA / A, (2, n), likewise."""
        A, *B = self._waves(omega)
        P, below = self._ratio(A, *B)
        kind = self.data.layout.kind
        slopes = np.zeros((len(omega), len(B) + 1, len(kind)), complex)
        for j, wave in enumerate(B):  # (5)
            slopes[:, j, kind == 0], slopes[:, j, kind == 1 + j] = -P[:, [j]] * A, wave
        slopes[:, -1, kind == 0] = A
        slopes /= below[:, None, None]
        slopes = np.concatenate([slopes.real, slopes.imag], axis=1)
        S = slopes @ self.C @ slopes.swapaxes(1, 2)
        m = len(B)
        of_P = np.delete(np.arange(2 * m + 2), [m, 2 * m + 1])
        return S[:, of_P[:, None], of_P], np.array([S[:, m, m], S[:, -1, -1]])

    @property
    def denominator(self) -> np.ndarray:
        """The estimate of A, lag by lag."""
        return np.append(1.0, (increments(self.data.layout.knots) @ self.of(0, self.mean))[1:])

    @property
    def stable(self) -> bool:
        """Whether the estimate of A has no zero outside the unit circle, by how often it turns."""
        a = self.denominator
        waves = np.fft.rfft(a, 1 << int(np.log2(2 * len(a) + TURN)))
        return bool(abs(np.angle(waves[1:] / waves[:-1]).sum()) < 1)

    def impulse(self, n: int) -> np.ndarray:
        """Impulse response of the estimate over n samples, shape (m, n)."""
        B, poles = np.zeros((len(self.data.layout.moved), n)), self.data.layout.poles
        for j, knots in enumerate(self.data.layout.moved):
            x, slow = np.split(self.of(1 + j, self.mean), [len(knots)])
            lags = (increments(knots) @ x)[:n]
            B[j, : len(lags)] = lags
            B[j, 1:] += slow * (1 - poles) @ poles[:, None] ** np.arange(n - 1)
        return lfilter([1.0], self.denominator, B, axis=1)


def regression(groups: Sequence[Trials], direct: bool, gain=None) -> Regression:
    """Of one output; `direct`: whether y(t) may depend on u(t); `gain`, (m,): P at rest, if known.

    If correlations show a delay, also with it, from the prior and from what is estimated without.
    """
    best = _fitted(groups, direct, np.zeros(groups[0].u.shape[2], int), gain)
    for differences, room in enumerate(ROOM):
        peaks = _peaks(groups, differences)
        if peaks.max() >= LATE:
            late = _fitted(groups, direct, (room * peaks).astype(int), gain, (*FIRST, best.eta))
            best = min(best, late, key=lambda fit: fit.surprise)
    best, S = _polished(best)
    farther = HEAVY * np.sqrt(len(S)) * np.concatenate([S, -S])
    points = np.clip(best.eta + farther, -BOUND, BOUND)
    at, count, C = _posterior(best.eta, best.data), best.data.count.sum(), 0.0
    for other in (_posterior(eta, best.data) for eta in points):
        W = other.size[:, None] * solve_triangular(other.U, np.eye(len(other.U)))
        off = other.mean - at.mean
        C = C + (other.rest / count * W @ W.T + np.outer(off, off)) / len(points)
    return Regression(at.mean, best.data, at, C)


def _peaks(groups, differences):
    """Lags of largest correlation of each input, or of its moves, with the output, (m,)."""
    longest, products = max(group.y.shape[1] for group in groups), 0.0
    for group in groups:
        signals = contrasts(np.concatenate([group.u, group.y], axis=2))
        signals = np.diff(signals - signals.mean(axis=1, keepdims=True), differences, axis=1)
        spectra = np.fft.rfft(signals, 2 * longest, axis=1)
        products = products + np.sum(spectra[..., :-1].conj() * spectra[..., -1:], axis=0)
    phases = products / np.maximum(np.abs(products), 1e-300) ** PHASES
    return np.argmax(np.abs(np.fft.irfft(phases, axis=0))[: longest // 2], axis=0)
