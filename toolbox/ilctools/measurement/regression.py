"""A frequency response from signals as they come, and how far off it may be.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + offset + slope t + drift(t) + e(t)

with A monic, B and A of as many lags as a quarter of the longest record, and white e: P = B / A. A
priori coefficients decay and neighbours are alike, with the tuned-correlated kernel c exp(-max(i,
j) / T), each of A, B_j and the start with c and T of their own (T. Chen, H. Ohlsson and L. Ljung,
Automatica 48 (2012) 1525-1535; G. Pillonetto and others, Automatica 50 (2014) 657-682). In
increments from lag to lag this kernel is diagonal. Far lags share increments, geometrically more of
them, counted from the delay of each input, if the one that correlations show has the larger
posterior. The drift is a random walk. The maximum of their posterior, the marginal likelihood times
a wide normal prior, determines all c and T, and the variance of what repeats over trials. They are
drawn from a t distribution about it, with the curvature there, and coefficients for each of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, helmert, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.signal import fftconvolve, lfilter
from scipy.special import expit, log_expit

from ilctools.loop.notes import LogError

SHARE = 4  # of the longest record: lags of A and B
# Knots are one lag apart up to CLOSE, then 1 + (lag - CLOSE) // STEP.
CLOSE, STEP = 40, 8
START = (6, 4)  # likewise, for what a start leaves
STARTS = 300  # unknowns of all starts at most; with more, first samples are left out
KNOTS = 64  # of a drift, between which it is straight
CENTRE = np.log(10)  # of the logarithms of c, relative to the noise, and T in samples
CALM = -3.0  # the same of the drift
WIDE = 3.0  # their standard deviation before the data
BOUND = 30.0  # of all logarithms
EXACT = 1e-9  # least noise, in the power of the output
SETS, DRAWS = 80, 8  # draws of hyperparameters, and of coefficients for each of them
LATE = 5  # samples: the least lag of largest correlation that counts as a delay
ROOM = (0.6, 0.9)  # delays that are tried, relative to that lag
TAILS = 10  # degrees of freedom of the distribution that the first are drawn from
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
    lag: np.ndarray  # (unknown,)
    gap: np.ndarray  # (unknown,): to the next lag; infinite at the last
    past: np.ndarray  # (lag, k): coefficients of A from increments
    moves: np.ndarray  # (m, lag, k): those of B
    start: np.ndarray  # (time, k)
    starts: int  # records with an unknown start
    drifts: int  # and with a drift
    skipped: int  # samples at the beginning of each

    def prior(self, eta) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the variances of the increments, and their slope over log T."""
        scale, time = eta[:-1].reshape(2, -1)[:, self.kind]
        lag, gap = self.lag * np.exp(-time), self.gap * np.exp(-time)
        shorter = np.where(gap < BOUND**2, gap, 0) / np.expm1(np.clip(gap, 1e-300, BOUND))
        return scale - lag + np.log(-np.expm1(-gap)), lag - shorter


def _knots(first, last, close, step):
    knots = [first]
    while knots[-1] < last:
        apart = 1 + max(0, knots[-1] - close) // step
        knots.append(min(last, knots[-1] + apart))
    return np.array(knots)


def _increments(knots, count):
    """One up to a knot, zero from the next one on and before the first, (lag, knot)."""
    lags = np.arange(count)
    hats = np.array([np.interp(lags, knots, one) for one in np.eye(len(knots))]).T
    return np.cumsum(hats, axis=1) * ((lags >= knots[0]) & (lags <= knots[-1]))[:, None]


def _layout(groups, direct, delays):
    longest = max(group.y.shape[1] for group in groups)
    m, reach = len(delays), max(4, longest // SHARE)
    past, moves = (_knots(first, reach, CLOSE, STEP) for first in (1, 0 if direct else 1))
    lags = reach + max(delays) + 1
    start = _knots(0, reach, *START)
    records = sum(len(group.y) for group in groups)
    starts = records if records * len(start) <= STARTS else 0
    blocks = [past, *[moves] * m, *[start] * starts, *[np.zeros(KNOTS)] * len(groups)]
    kinds = [*range(m + 1), *[m + 1] * starts, *[m + 2] * len(groups)]
    gaps = [np.append(np.diff(block), np.inf) for block in blocks[: 1 + m + starts]]
    gaps += [np.full(KNOTS, np.inf)] * len(groups)
    return _Layout(
        kind=np.repeat(kinds, [len(block) for block in blocks]),
        lag=np.concatenate([block - block[0] for block in blocks]),
        gap=np.concatenate(gaps),
        past=_increments(past, reach + 1),
        moves=np.stack([_increments(moves + delay, lags) for delay in delays]),
        start=_increments(start, reach + 1),
        starts=starts,
        drifts=len(groups),
        skipped=0 if starts else reach,
    )


def contrasts(signal: np.ndarray) -> np.ndarray:
    """Of K trials: sqrt(K) times their mean, then their differences."""
    return np.tensordot(helmert(len(signal), full=True), signal, 1)


def records(groups, layout) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]:
    """Regressors (time, unknown), output (time,), offset and slope, and whether it is a mean."""
    number = 0
    for g, group in enumerate(groups):
        inputs, outputs = contrasts(group.u), contrasts(group.y[..., 0])
        N = outputs.shape[1]
        line = np.stack([np.ones(N), np.linspace(-1, 1, N)], axis=1)[layout.skipped :]
        line = np.linalg.qr(line)[0]
        ends = np.linspace(0, N - 1, KNOTS + 1)
        ramps = np.clip((np.arange(N)[:, None] - ends[:-1]) / np.diff(ends), 0, 1)
        for k, (u, y) in enumerate(zip(inputs, outputs, strict=True)):
            starts = np.zeros((N, layout.starts, layout.start.shape[1]))
            if layout.starts:
                known = layout.start[:N]
                starts[: len(known), number] = known
            drifts = np.zeros((N, layout.drifts, KNOTS))
            if k == 0:
                drifts[:, g] = ramps
            X = [-_lagged(y, layout.past), *map(_lagged, u.T, layout.moves)]
            X = np.hstack([*X, starts.reshape(N, -1), drifts.reshape(N, -1)])
            number += 1
            X, y = (_without(line, signal[layout.skipped :]) for signal in (X, y))
            yield X, y, line, k == 0 and len(outputs) > 1


def convolved(signals: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Signals (trial, time, column) with a finite impulse response."""
    return fftconvolve(signals, lags[None, :, None], axes=1)[:, : signals.shape[1]]


def _lagged(signal, basis):
    """A signal (time,) by each column of a basis (lag, k), (time, k)."""
    N = len(signal)
    return fftconvolve(signal[:, None], basis[:N], axes=0)[:N]


def _without(line, signal):
    return signal - line @ (line.T @ signal)


class _Normal(NamedTuple):
    """Products of regressors and output; of differences and single records, and of means."""

    R: np.ndarray  # (2, unknown, unknown)
    b: np.ndarray  # (2, unknown)
    s: np.ndarray  # (2,)
    count: np.ndarray  # (2,)
    layout: _Layout


class _Posterior(NamedTuple):
    """Of unknowns in units of `size`: precision U' U and U times the mean, over the noise."""

    size: np.ndarray
    U: np.ndarray
    half: np.ndarray
    rest: float  # sum of squares that is left
    ratio: float  # weight of means over trials, in which a disturbance may repeat

    @property
    def mean(self) -> np.ndarray:
        """Of the unknowns."""
        return self.size * solve_triangular(self.U, self.half)


def _normal(groups, layout):
    p = len(layout.kind)
    R, b, s, count = np.zeros((2, p, p)), np.zeros((2, p)), np.zeros(2), np.zeros(2)
    for X, y, _, mean in records(groups, layout):
        k = int(mean)
        R[k] += X.T @ X
        b[k] += X.T @ y
        s[k] += y @ y
        count[k] += len(y) - 2
    return _Normal(R, b, s, count, layout)


def _posterior(eta, data):
    ratio = expit(-eta[-1]) if data.count[1] else 1.0
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
    half = solve_triangular(U, size * (weights @ data.b), trans=1, check_finite=False)
    total = weights @ data.s
    return _Posterior(size, U, half, max(total - half @ half, EXACT * total), ratio)


def surprise(eta: np.ndarray, data: _Normal, centre: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the logarithm of the posterior of hyperparameters, and its gradient."""
    layout, count = data.layout, data.count.sum()
    size, U, half, rest, ratio = _posterior(eta, data)
    off = (eta - centre) / WIDE
    value = count / 2 * np.log(rest) + np.log(np.diag(U)).sum() + off @ off / 2
    if data.count[1]:
        value -= data.count[1] / 2 * log_expit(-eta[-1])
    h = solve_triangular(U, half, check_finite=False)
    inverse = dpotri(U)[0]
    each = (1 - np.diag(inverse) - count * h**2 / rest) / 2  # over log variances
    kinds = len(eta) // 2
    slope = each * layout.prior(eta)[1]
    gradient = [np.bincount(layout.kind, x, kinds) for x in (each, slope)]
    gradient = np.append(np.concatenate(gradient), 0.0) + off / WIDE
    if data.count[1]:
        mean, R = size * h, data.R[1]
        left = data.s[1] - 2 * mean @ data.b[1] + mean @ R @ mean
        inverse += np.triu(inverse, 1).T
        doubt = np.sum(inverse * (size[:, None] * R * size))
        by_ratio = ratio * (count * left / rest + doubt) - data.count[1]
        gradient[-1] -= (1 - ratio) / 2 * by_ratio
    return value, gradient


class _Fit(NamedTuple):
    """The likeliest hyperparameters of a layout."""

    eta: np.ndarray
    surprise: float
    centre: np.ndarray  # of their prior
    data: _Normal

    @property
    def spread(self) -> np.ndarray:
        """The symmetric root of the covariance of the hyperparameters.

        Eigenvectors have signs, and among equal values directions, that are LAPACK's choice; the
        symmetric root has no choice, so that draws are the same on every processor.
        """
        eta, _, centre, data = self
        steps = 1e-3 * np.eye(len(eta))
        H = [surprise(eta + e, data, centre)[1] - surprise(eta - e, data, centre)[1] for e in steps]
        values, vectors = np.linalg.eigh(np.array(H) + np.transpose(H))
        return vectors / np.sqrt(np.maximum(values / 4e-3, 1 / WIDE**2)) @ vectors.T


def _fitted(groups, direct, delays):
    longest = max(group.y.shape[1] for group in groups)
    data = _normal(groups, _layout(groups, direct, delays))
    kinds = data.layout.kind.max() + 1
    centre = np.append(np.full(2 * kinds, CENTRE), 0.0)
    centre[kinds - 1] = CALM
    bounds = [(-BOUND, BOUND)] * kinds + [(-1.5, np.log(5 * longest))] * kinds
    found = minimize(
        surprise, centre, (data, centre), jac=True, method="L-BFGS-B",
        bounds=[*bounds, (-BOUND, BOUND)], options={"maxiter": 60, "ftol": 1e-7},
    )  # fmt: skip
    return _Fit(found.x, found.fun, centre, data)


@dataclass(frozen=True)
class Regression:
    """Responses from m inputs to one output that the data admit, the estimate first."""

    a: np.ndarray  # (k, draw): increments of A
    b: np.ndarray  # (m, k, draw): and of B
    data: _Normal
    posterior: _Posterior  # for the likeliest hyperparameters
    stable: float  # share of the draws that are; only these are kept

    @property
    def past(self) -> np.ndarray:
        """Lags of A from increments."""
        return self.data.layout.past

    @property
    def moves(self) -> np.ndarray:
        """Lags of B from increments, of each input."""
        return self.data.layout.moves

    def _waves(self, omega):
        """Of A (n, k) and of B (m, n, k) at angles omega Ts what one increment makes."""
        waves = np.exp(-1j * np.outer(omega, np.arange(self.moves.shape[1])))
        return waves[:, : len(self.past)] @ self.past, waves @ self.moves

    def response(self, omega: np.ndarray, draws: slice = slice(None)) -> np.ndarray:
        """P at angles omega Ts, shape (draw, n, m)."""
        A, B = self._waves(omega)
        above = np.moveaxis(B @ self.b[..., draws], 0, 2)  # (n, draw, m)
        return np.moveaxis(above / (1 + A @ self.a[:, draws])[..., None], 1, 0)

    @property
    def denominator(self) -> np.ndarray:
        """The estimate of A, lag by lag."""
        return _monic(self.past @ self.a[:, 0])

    def impulse(self, n: int) -> np.ndarray:
        """Impulse response of the estimate over n samples, shape (m, n)."""
        lags = np.einsum("jlk,jk->jl", self.moves, self.b[..., 0])[:, :n]
        B = np.pad(lags, ((0, 0), (0, n - lags.shape[1])))
        return lfilter([1.0], self.denominator, B)

    def learned(self, omega: np.ndarray) -> np.ndarray:
        """Standard deviation of P after the data, relative to that before them, (n, m)."""
        size, U = self.posterior.size, self.posterior.U
        A, B = self._waves(omega)
        P = self.response(omega, slice(1))[0]
        shares = []
        for j in range(len(self.b)):
            slopes = np.zeros((len(omega), len(size)), complex)
            kind = self.data.layout.kind
            slopes[:, kind == 0], slopes[:, kind == 1 + j] = -P[:, [j]] * A, B[j]
            slopes *= size
            after = solve_triangular(U, slopes.T, trans=1)
            shares.append(np.linalg.norm(after, axis=0) / np.linalg.norm(slopes, axis=1))
        return np.transpose(shares)


def _monic(a):
    """With the leading one, in front of which no lag is."""
    return np.concatenate([np.ones_like(a[:1]), a[1:]])


def _are_stable(a):
    """Whether A has no zero outside the unit circle, by how often it turns; a (lag, draw)."""
    size = 1 << int(np.log2(2 * len(a) + TURN))
    waves = np.fft.rfft(_monic(a), size, axis=0)
    return np.abs(np.angle(waves[1:] / waves[:-1]).sum(axis=0)) < 1


def regression(groups: Sequence[Trials], direct: bool, seed: int = 0) -> Regression:
    """Of one output; `direct`: whether y(t) may depend on u(t).

    If an input is late, also with delays of 0.6 and then 0.9 of the lags of largest correlation, as
    long as the posterior grows.
    """
    best = _fitted(groups, direct, np.zeros(groups[0].u.shape[2], int))
    peaks = _peaks(groups, best)
    for room in ROOM if peaks.max() >= LATE else ():
        other = _fitted(groups, direct, (room * peaks).astype(int))
        if other.surprise > best.surprise:
            break
        best = other
    return _drawn(best, seed)


def _peaks(groups, fit):
    """Lags of largest correlation of each input with the output, both filtered by A, (m,)."""
    layout = fit.data.layout
    a = layout.past @ _posterior(fit.eta, fit.data).mean[layout.kind == 0]
    longest, total = max(group.y.shape[1] for group in groups), 0.0
    for group in groups:
        signals = contrasts(np.concatenate([group.u, group.y], axis=2))
        spectra = np.fft.rfft(convolved(signals, _monic(a)), 2 * longest, axis=1)
        products = np.sum(spectra[..., :-1].conj() * spectra[..., -1:], axis=0)
        total = total + np.fft.irfft(products, axis=0)[: longest // 2]
    return np.argmax(np.abs(total), axis=0)


def _drawn(fit, seed):
    eta, data = fit.eta, fit.data
    layout, likeliest = data.layout, _posterior(eta, data)
    rng, count = np.random.default_rng(seed), data.count.sum()
    z = rng.standard_normal((SETS, len(eta)))
    z *= np.sqrt(TAILS / rng.chisquare(TAILS, (SETS, 1)))
    moved = np.clip(eta + z @ fit.spread, -BOUND, BOUND)
    # Without importance weights: with them a few draws dominate, and the region is too small.
    drawn = [likeliest.mean[:, None]]
    for one in moved:
        at = _posterior(one, data)
        noise = np.sqrt(at.rest / rng.chisquare(count, DRAWS))
        noise = noise * rng.standard_normal((len(at.U), DRAWS))
        drawn.append(at.size[:, None] * solve_triangular(at.U, at.half[:, None] + noise))
    drawn = np.concatenate(drawn, axis=1)
    a = drawn[layout.kind == 0]
    stable = np.concatenate([_are_stable(layout.past @ part) for part in np.array_split(a, 20, 1)])
    share = stable[1:].mean()
    if not stable[0] and stable.any():  # the stable one that is nearest
        off = np.linalg.norm(layout.past @ (a - a[:, :1]), axis=0)
        drawn[:, 0] = drawn[:, np.where(stable, off, np.inf).argmin()]
        stable[0] = True
    drawn = drawn[:, stable]
    m = layout.kind.max() - 2
    b = np.stack([drawn[layout.kind == 1 + j] for j in range(m)])
    return Regression(drawn[layout.kind == 0], b, data, likeliest, share)
