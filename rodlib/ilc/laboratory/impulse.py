"""An impulse response from signals as they come, and how far off it may be.

    y = g * u + what an unknown start leaves + offset and slope + drift + noise

by Gaussian process regression. A priori an impulse response decays and its neighbours are alike,
with the "diagonal/correlated" kernel c lambda^((i + j) / 2) rho^|i - j|; the marginal likelihood of
the data tells c, lambda and rho (Chen, Ohlsson and Ljung, On the estimation of transfer functions,
regularizations and Gaussian processes - revisited, Automatica 48, 2012). How well it tells them is
part of the accuracy: they are drawn, too. The transient has the same kernel with a c of its own,
the drift one that does not decay.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.signal import fftconvolve, lfilter

FIRST = 64  # lags of an impulse response at first; doubled until it has decayed
MOST = 4000  # lags of all inputs together
CLOSE = 128  # lags are looked at one by one up to here, further on in steps of lag / CLOSE
KNOTS = 100  # of a drift at most, between which it is straight
DECAYED = 3e-3  # a priori size of the last lag, relative to the first
COLOURS = 8  # coefficients at most of the filter that makes the noise white
ROUNDS = 3  # of estimating the noise's colour and the response in turn
WIDE = 3.0  # standard deviation of the logarithms of what the data are to tell, before they do
SETS, EACH = 25, 40  # sets of hyperparameters that are drawn, and responses for each


@dataclass(frozen=True)
class Impulse:
    """Impulse responses from m inputs to one output that the data admit."""

    drawn: np.ndarray  # (draw, m, n)
    prior: np.ndarray  # (draw, m, n): as large as the largest of them could be, before the data
    lasting: float  # samples in which a response falls by e, a priori
    told: int  # lags that the record holds


@dataclass(frozen=True)
class _Data:
    """Normal equations. The unknowns stand in blocks: m responses, transient, drift."""

    R: np.ndarray  # (p, p)
    b: np.ndarray  # (p,)
    s: float
    count: int  # of data
    lag: np.ndarray  # (p,): of each unknown; zero in the drift, which does not decay
    apart: np.ndarray  # (p - 1,): samples to the next unknown; infinite between two blocks
    block: np.ndarray  # (p,): which it is in
    drifts: np.ndarray  # (p,), bool
    lags: np.ndarray  # of a response that are unknowns; it is straight in between


def impulse_of(u, y, seed: int = 0) -> Impulse:
    """From inputs (trial, time, m) and one output (trial, time); a single trial may drift."""
    sizes, size = u.std(axis=(0, 1)), y.std()
    u, y = u / sizes, y / size
    m, n, data, eta, H = _fitted(u, y)
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(H)
    spread = vectors / np.sqrt(np.maximum(values, 1 / WIDE**2))
    k, lasting = len(data.lags), np.exp(eta[0])
    further = np.arange(n, int(np.clip(-np.log(DECAYED) * lasting, n, 5 * n)))
    every, drawn, before = np.append(data.lags, further), [], []
    full = np.arange(every[-1] + 1)
    for _ in range(SETS):
        one = eta + spread @ rng.standard_normal(len(eta))
        prior, U, half = _posterior(one, data)
        deviation = np.sqrt((data.s - half @ half) / rng.chisquare(data.count, EACH))
        z = half[:, None] + deviation * rng.standard_normal((len(U), EACH))
        x = solve_triangular(U, z)[: m * k].T.reshape(EACH, m, k)
        step = np.exp(-np.diff(every) / np.exp(one[1]))
        free = rng.standard_normal((EACH, m, len(every))) * deviation[:, None, None]
        x = np.concatenate([x, free[..., k:]], axis=2)
        for i in range(1, len(every)):  # as the kernel goes on, from one lag to the next
            own = np.sqrt(1 - step[i - 1] ** 2)
            free[..., i] = step[i - 1] * free[..., i - 1] + own * free[..., i]
            if i >= k:
                x[..., i] = step[i - 1] * x[..., i - 1] + own * x[..., i]
        shape = np.exp(-every / np.exp(one[0]))
        c = np.exp(one[3 : 3 + m, None] / 2)
        for own, kept in ((c * shape * x, drawn), (c.max() * shape * free, before)):
            own = own.reshape(EACH * m, -1)
            kept.append(np.array([np.interp(full, every, g) for g in own]).reshape(EACH, m, -1))
    units = size / sizes[:, None]
    return Impulse(units * np.concatenate(drawn), units * np.concatenate(before), lasting, n)


def correlated(a, b, n):
    """Sum over t of a(t) b(t - i), i = 0 ... n - 1, with b zero before it begins; by rows."""
    return fftconvolve(a, b[:, ::-1], axes=1)[:, b.shape[1] - 1 :][:, :n]


def gram(x, z, p, n):
    """Sum over trials and t >= p of x(t - i) z(t - j), shape (n, n), from its edges on."""
    # R(i + 1, j + 1) is R(i, j) but for what enters at the beginning and leaves at the end.
    late = [np.where(np.arange(x.shape[1]) < p, 0, signal) for signal in (x, z)]
    R = np.empty((n, n))
    R[0], R[:, 0] = correlated(late[0], z, n).sum(0), correlated(late[1], x, n).sum(0)

    def last(signal, end):
        piece = signal[:, max(0, end - n) : end][:, ::-1]
        return np.pad(piece, ((0, 0), (0, n - piece.shape[1])))

    change = last(x, p).T @ last(z, p) - last(x, x.shape[1]).T @ last(z, x.shape[1])
    for i in range(n - 1):
        R[i + 1, 1:] = R[i, :-1] + change[i, :-1]
    return R


def _hats(at, knots):
    """Functions that are one at a knot, zero at the others and straight between, (at, knot)."""
    return np.array([np.interp(at, knots, one) for one in np.eye(len(knots))]).T


def _line(N):
    """Offset and slope, orthonormal, (N, 2)."""
    return np.linalg.qr(np.stack([np.ones(N), np.linspace(-1, 1, N)], axis=1))[0]


def _knots_of_drift(N):
    return np.linspace(0, N - 1, min(KNOTS, N))


def _normal(u, y, white, n):
    """The data for n lags, with noise as white as `white` makes it."""
    p, (K, N, m) = len(white) - 1, u.shape
    lags = [0]
    while lags[-1] < n - 1:
        lags.append(min(n - 1, lags[-1] + 1 + lags[-1] // CLOSE))
    lags, drift = np.array(lags), _knots_of_drift(N) if K == 1 else np.empty(0)
    k, W = len(lags), _hats(np.arange(n), lags)
    own = np.empty((N, 0))
    if K == 1:
        own = np.hstack([np.pad(W, ((0, N - n), (0, 0))), _hats(np.arange(N), drift)])
    x = lfilter(white, 1, np.moveaxis(u, 2, 0), axis=2)
    Z, own, e = (
        np.pad(lfilter(white, 1, each.T)[:, p:], ((0, 0), (p, 0)))
        for each in (_line(N), np.pad(own, ((0, 0), (0, 1))), y.T)
    )
    Z, own = np.linalg.qr(Z.T)[0].T, own[:-1]
    total, first = m * k + len(own), m * k
    R, b, seen = np.zeros((total, total)), np.zeros(total), np.zeros((K, 2, total))
    R[first:, first:], b[first:], seen[:, :, first:] = own @ own.T, own @ e[0], Z @ own.T
    for j in range(m):
        at = slice(j * k, (j + 1) * k)
        b[at] = correlated(e, x[j], n).sum(0) @ W
        seen[:, :, at] = np.stack([correlated(z[None], x[j], n) for z in Z], axis=1) @ W
        for i in range(j + 1):
            to = slice(i * k, (i + 1) * k)
            R[at, to] = W.T @ gram(x[j], x[i], p, n) @ W
            R[to, at] = R[at, to].T
        if len(own):
            R[first:, at] = correlated(own, x[j], n) @ W
            R[at, first:] = R[first:, at].T
    seen, of_y = seen.reshape(-1, total), (e @ Z.T).ravel()
    sizes = [k] * m + ([k, len(drift)] if K == 1 else [])
    lag = np.concatenate([lags] * (m + (K == 1)) + [0 * drift])
    apart = np.concatenate([np.append(np.diff(lags), np.inf)] * (m + (K == 1)) + [np.diff(drift)])
    return _Data(
        R - seen.T @ seen, b - seen.T @ of_y, np.sum(e**2) - of_y @ of_y, K * (N - p - 2),
        lag, apart[: total - 1], np.repeat(np.arange(len(sizes)), sizes),
        np.arange(total) >= total - len(drift), lags,
    )  # fmt: skip


class _Prior:
    """Scales d and precision T, tridiagonal, of the prior covariance D T^-1 D, and derivatives.

    `eta` holds logarithms: of the samples in which responses decay, in which they and in which the
    drift stay alike, and of the variance of each block.
    """

    def __init__(self, eta, data):
        alike = np.exp(np.where(data.drifts[1:], eta[2], eta[1]))
        rho = np.exp(-data.apart / alike)
        left = -np.expm1(-2 * data.apart / alike)  # 1 - rho^2
        self.d = np.exp(eta[3 + data.block] / 2 - data.lag / np.exp(eta[0]))
        self.slope = rho * np.where(rho > 0, data.apart, 0) / alike  # of rho over log(alike)
        self.next, self.d_next = -rho / left, -(1 + rho**2) / left**2
        self.own = np.append(1, 1 / left) + np.append(rho**2 / left, 0)
        self.d_own = 2 * rho / left**2  # of both ends of a link
        self.logdet, self.d_logdet = np.log(left).sum(), -2 * rho / left


def _posterior(eta, data):
    """Prior, factor U of the precision U' U in units of d, and U times the mean in units of d."""
    prior = _Prior(eta, data)
    A, i = prior.d[:, None] * data.R * prior.d, np.arange(len(prior.d))
    A[i, i] = A[i, i] * (1 + 1e-10) + prior.own
    A[i[1:], i[:-1]] += prior.next
    A[i[:-1], i[1:]] += prior.next
    U = cholesky(A, check_finite=False)
    return prior, U, solve_triangular(U, prior.d * data.b, trans=1, check_finite=False)


def surprise(eta, data, centre):
    """Minus the logarithm of the marginal likelihood, and its gradient."""
    prior, U, half = _posterior(eta, data)
    rest, off = max(data.s - half @ half, 1e-9 * data.s), (eta - centre) / WIDE
    value = (data.count * np.log(rest) + prior.logdet + off @ off) / 2
    value += np.log(np.diag(U)).sum()
    h, inverse = solve_triangular(U, half, check_finite=False), dpotri(U)[0]
    # A h and A^-1 in the band of T: each derivative of T has both as factors.
    weight = data.count / rest
    own = np.diag(inverse) + weight * h**2
    link = np.diag(inverse, 1) + weight * h[1:] * h[:-1]
    scale = 1 - prior.own * own
    scale[1:] -= prior.next * link
    scale[:-1] -= prior.next * link
    rough = prior.d_own * (own[1:] + own[:-1]) / 2 + prior.d_next * link + prior.d_logdet / 2
    rough *= prior.slope
    drifts = data.drifts[1:]
    times = [scale @ data.lag / np.exp(eta[0]), rough[~drifts].sum(), rough[drifts].sum()]
    return value, np.append(times, np.bincount(data.block, scale) / 2) + off / WIDE


def _fitted(u, y):
    """Number of inputs, of lags, the data, the likeliest eta and how sharp that is."""
    K, N, m = u.shape
    blocks, longest = m + 2 * (K == 1), min(N, MOST // m)
    centre = np.log([10.0, 10.0, N / 2] + [10.0] * blocks)
    bounds = [(-1, np.log(5 * longest)), (-2, np.log(20 * longest)), (0, np.log(20 * N))]
    white, n, eta = np.ones(1), min(FIRST, longest), centre
    for left in reversed(range(ROUNDS)):
        while True:
            data = _normal(u, y, white, n)
            eta = minimize(
                surprise, eta, (data, centre), jac=True, method="L-BFGS-B",
                bounds=bounds + [(-40, 40)] * blocks, options={"maxiter": 60, "ftol": 1e-9},
            ).x  # fmt: skip
            if np.exp(-n / np.exp(eta[0])) < DECAYED or n == longest:
                break
            n = min(2 * n, longest)
        if not left or (K == 1 and N <= 2 * KNOTS):
            break  # a drift with so many knots is noise of any colour
        new = _whitener(_residual(u, y, data, eta))
        if len(new) == len(white) == 1:
            break
        white = new
    step = 1e-3 * np.eye(len(eta))
    H = [surprise(eta + e, data, centre)[1] - surprise(eta - e, data, centre)[1] for e in step]
    return m, n, data, eta, (np.array(H) + np.transpose(H)) / 4e-3


def _residual(u, y, data, eta):
    """What the likeliest responses, transient, drift, offset and slope leave of y."""
    prior, U, half = _posterior(eta, data)
    (K, N, m), blocks = u.shape, data.block
    theta, every = prior.d * solve_triangular(U, half), np.arange(data.lags[-1] + 1)
    g = [np.interp(every, data.lags, theta[blocks == j]) for j in range(m + (K == 1))]
    y = y - sum(fftconvolve(u[:, :, j], g[j][None], axes=1)[:, :N] for j in range(m))
    if K == 1:
        y[0, : len(every)] -= g[m]
        y[0] -= np.interp(np.arange(N), _knots_of_drift(N), theta[data.drifts])
    return y - y @ _line(N) @ _line(N).T


def _whitener(noise):
    """Coefficients of the filter that makes noise (trial, time) white, by Schwarz's criterion."""
    p = min(COLOURS, noise.shape[1] // 20)
    lagged = np.stack([noise[:, p - i : noise.shape[1] - i].ravel() for i in range(p + 1)], 1)
    found = []
    for order in range(p + 1):
        a = np.linalg.lstsq(lagged[:, 1 : order + 1], -lagged[:, 0])[0]
        left = np.mean((lagged[:, : order + 1] @ np.append(1, a)) ** 2)
        cost = len(lagged) * np.log(max(left, 1e-300)) + order * np.log(len(lagged))
        found.append((cost, np.append(1, a)))
    return min(found, key=lambda pair: pair[0])[1]
