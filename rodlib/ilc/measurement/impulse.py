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
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.signal import fftconvolve, lfilter
from scipy.special import expit

from rodlib.ilc.loop.notes import LogError

MOST = 4000  # lags of all inputs together
CLOSE = 96  # the fast part is looked at lag by lag up to here, further on in steps of lag / CLOSE
SMOOTH = 6  # and the slow one in steps of lag / SMOOTH
ENDS = 0.5  # of a trial: all responses decay by e within less
KNOTS = 64  # of a drift at most, between which it is straight
COLOURS = 8  # coefficients at most of the filter that makes the noise white
FAST, SLOW, DRIFT = range(3)  # kinds of unknowns
ROUNDS = 3  # of estimating the noise's colour and the response in turn
WIDE = 3.0  # standard deviation of the logarithms of what the data are to tell, before they do
SETS, EACH = 25, 40  # sets of hyperparameters that are drawn, and responses for each


@dataclass(frozen=True)
class Impulse:
    """Impulse responses from m inputs to one output that the data admit."""

    drawn: np.ndarray  # (draw, m, n)
    prior: np.ndarray  # (draw, m, n): what they were before the data
    lasting: float  # samples in which a response falls by e, a priori


@dataclass(frozen=True)
class _Data:
    """Normal equations. The unknowns stand in blocks, of which `kind` says what they are."""

    R: np.ndarray  # (p, p)
    b: np.ndarray  # (p,)
    s: float
    count: int  # of data
    block: np.ndarray  # (p,): which one each unknown is in
    kind: np.ndarray  # (p,): FAST, SLOW or DRIFT
    lag: np.ndarray  # (p,): at which time of its response each unknown is
    apart: (
        np.ndarray
    )  # (p - 1,): samples to the next unknown; infinite between two blocks
    samples: int  # of a trial
    basis: tuple[np.ndarray, ...]  # (n, k): from the unknowns of each block to samples

    @property
    def slow(self) -> np.ndarray:
        """The blocks that are slow parts, each after its fast part."""
        return np.unique(self.block[self.kind == SLOW])


def impulse_of(u, y, seed: int = 0) -> Impulse:
    """From inputs (trial, time, m) and one output (trial, time); a single trial may drift."""
    sizes, size = u.std(axis=(0, 1)), y.std()
    u, y, m = u / sizes, y / size, u.shape[2]
    data, eta, H = _fitted(u, y)
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(H)
    spread = vectors / np.sqrt(np.maximum(values, 1 / WIDE**2))
    drawn, before = [], []
    for _ in range(SETS):
        prior, U, half = _posterior(eta + spread @ rng.standard_normal(len(eta)), data)
        deviation = np.sqrt((data.s - half @ half) / rng.chisquare(data.count, EACH))
        z = half[:, None] + deviation * rng.standard_normal((len(U), EACH))
        drawn.append(_responses(prior.d[:, None] * solve_triangular(U, z), data, m))
        free = deviation * rng.standard_normal((len(U), EACH))
        for i, rho in enumerate(prior.rho):
            free[i + 1] = rho * free[i] + np.sqrt(1 - rho**2) * free[i + 1]
        before.append(_responses(prior.d[:, None] * free, data, m))
    units = size / sizes[:, None]
    return Impulse(
        units * np.concatenate(drawn), units * np.concatenate(before), np.exp(eta[0])
    )


def _responses(theta, data, m):
    """The m impulse responses of unknowns (p, draw), (draw, m, n)."""
    each = [B @ theta[data.block == k] for k, B in enumerate(data.basis[: 2 * m])]
    g = np.zeros((m, max(map(len, each)), theta.shape[1]))
    for k, part in enumerate(each):
        g[k // 2, : len(part)] += part
    return np.moveaxis(g, 2, 0)


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


def _lags(n, close):
    """One by one at first, further on in steps of lag / close."""
    lags = [0]
    while lags[-1] < n - 1:
        lags.append(min(n - 1, lags[-1] + 1 + lags[-1] // close))
    return np.array(lags)


def _line(N):
    """Offset and slope, orthonormal, (N, 2)."""
    return np.linalg.qr(np.stack([np.ones(N), np.linspace(-1, 1, N)], axis=1))[0]


def _normal(u, y, white, n):
    """The data for n lags, with noise as white as `white` makes it."""
    p, (K, N, m) = len(white) - 1, u.shape
    knots = [_lags(n, CLOSE), _lags(n, SMOOTH)] * m
    kinds = [FAST, SLOW] * m
    if K == 1:
        knots += [*knots[:2], np.linspace(0, N - 1, min(KNOTS, N))]
        kinds += [FAST, SLOW, DRIFT]
    basis = [_hats(np.arange(int(each[-1]) + 1), each) for each in knots]
    sizes = [len(each) for each in knots]
    ends = np.cumsum(sizes)
    places = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    x = lfilter(white, 1, np.moveaxis(u, 2, 0), axis=2)

    def whitened(rows):
        rows = lfilter(white, 1, rows) if len(rows) else rows
        rows[:, :p] = 0
        return rows

    e, Z = whitened(y), np.linalg.qr(whitened(_line(N).T).T)[0].T
    own = [np.pad(B[:N], ((0, max(0, N - len(B))), (0, 0))).T for B in basis[2 * m :]]
    own = whitened(np.concatenate([np.empty((0, N)), *own]))
    total, first = ends[-1], ends[2 * m - 1]
    R, b, seen = np.zeros((total, total)), np.zeros(total), np.zeros((K, 2, total))
    R[first:, first:], b[first:], seen[:, :, first:] = (
        own @ own.T,
        own @ e[0],
        Z @ own.T,
    )
    for j in range(m):
        W = np.hstack([B[:n] for B in basis[:2]])
        at = slice(places[2 * j].start, places[2 * j + 1].stop)
        b[at] = correlated(e, x[j], n).sum(0) @ W
        seen[:, :, at] = np.stack([correlated(z[None], x[j], n) for z in Z], axis=1) @ W
        for i in range(j + 1):
            to = slice(places[2 * i].start, places[2 * i + 1].stop)
            R[at, to] = W.T @ gram(x[j], x[i], p, n) @ W
            R[to, at] = R[at, to].T
        if len(own):
            R[first:, at] = correlated(own, x[j], n) @ W
            R[at, first:] = R[first:, at].T
    seen, of_y = seen.reshape(-1, total), (e @ Z.T).ravel()
    apart = np.concatenate([np.append(np.diff(each), np.inf) for each in knots])[:-1]
    return _Data(
        R - seen.T @ seen, b - seen.T @ of_y, np.sum(e**2) - of_y @ of_y, K * (N - p - 2),
        np.repeat(np.arange(len(sizes)), sizes), np.repeat(kinds, sizes), np.concatenate(knots),
        apart, N, tuple(basis),
    )  # fmt: skip


class _Prior:
    """Scales d and precision T, tridiagonal, of the prior covariance D T^-1 D, and derivatives.

    `eta`: the logarithm of the samples in which the fast part decays; the logit of the share of
    them in which it stays alike; the logarithms of how much longer the slow part takes, less one,
    but for its end, of the samples in which the drift stays alike, and of the variance of each
    block, which for a slow part is relative to that which has the gain of the fast part before it.
    """

    def __init__(self, eta, data):
        endless, end = np.exp(eta[0]) * (1 + np.exp(eta[2])), ENDS * data.samples
        slow = endless * end / (endless + end)
        times = np.array([np.exp(eta[0]), slow, np.inf])
        self.free = slow / endless  # derivative of one logarithm over the other
        of_block = eta[4:].copy()
        of_block[data.slow] += of_block[data.slow - 1] + 2 * np.log(times[FAST] / slow)
        alike = np.array([times[FAST] * expit(eta[1]), times[SLOW], np.exp(eta[3])])
        passed = data.lag / times[data.kind]
        self.d = np.exp(of_block[data.block] / 2 - passed)
        relative = data.apart / alike[data.kind[1:]]
        self.rho = rho = np.exp(-relative)
        left = -np.expm1(-2 * relative)  # 1 - rho^2
        self.next, self.own = (
            -rho / left,
            np.append(1, 1 / left) + np.append(rho**2 / left, 0),
        )
        self.logdet = np.log(left).sum()
        # Derivatives: of log d, and of T and logdet over the logarithm of `alike`.
        self.passed = passed
        slope = rho * np.where(rho > 0, relative, 0)
        self.d_next, self.d_own = (
            -(1 + rho**2) / left**2 * slope,
            2 * rho / left**2 * slope,
        )
        self.d_logdet = -2 * rho / left * slope


def _posterior(eta, data):
    """Prior, factor U of the precision U' U in units of d, and U times the mean in units of d."""
    prior = _Prior(eta, data)
    A, i = prior.d[:, None] * data.R * prior.d, np.arange(len(prior.d))
    A[i, i] = A[i, i] * (1 + 1e-10) + prior.own
    A[i[1:], i[:-1]] += prior.next
    A[i[:-1], i[1:]] += prior.next
    U = _factor(A)
    return prior, U, solve_triangular(U, prior.d * data.b, trans=1, check_finite=False)


def _factor(A):
    """U of A = U' U, of which rounding may have made the smallest eigenvalues negative."""
    most = A.diagonal().max()
    for more in (0.0, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10):
        try:
            return cholesky(
                A + more * most * np.eye(len(A)) if more else A, check_finite=False
            )
        except LinAlgError:
            continue
    raise LogError(
        "log cannot be distinguished from rounding: is it without any noise, or constant?"
    )


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
    rough = (
        prior.d_own * (own[1:] + own[:-1]) / 2
        + prior.d_next * link
        + prior.d_logdet / 2
    )
    fast, slow, drift = np.bincount(data.kind[1:], rough, 3)
    passed = np.bincount(data.kind, scale * prior.passed, 3)
    each = np.bincount(data.block, scale) / 2
    slower = each[data.slow].sum()
    each[data.slow - 1] += each[data.slow]
    slow = (slow + passed[SLOW] - 2 * slower) * prior.free
    fast_time = fast + passed[FAST] + 2 * slower + slow
    first = [fast_time, fast * expit(-eta[1]), slow * expit(eta[2]), drift]
    return value, np.append(first, each) + off / WIDE


def _fitted(u, y):
    """The data, the likeliest eta, and how sharp that is."""
    K, N, m = u.shape
    n, blocks = min(N, MOST // m), 2 * m + 3 * (K == 1)
    centre = np.array([np.log(10), 1, 1, np.log(N / 2), *[np.log(10)] * blocks])
    centre[4 + np.arange(1, blocks, 2)[: m + (K == 1)]] = 0
    bounds = [
        (-1, np.log(5 * N)),
        (-6, 6),
        (-3, 4),
        (0, np.log(20 * N)),
        *[(-40, 40)] * blocks,
    ]
    white, eta = np.ones(1), centre
    for left in reversed(range(ROUNDS)):
        data = _normal(u, y, white, n)
        eta = minimize(
            surprise, eta, (data, centre), jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": 60, "ftol": 1e-8},
        ).x  # fmt: skip
        if not left or (K == 1 and N <= 2 * KNOTS):
            break  # a drift with so many knots is noise of any colour
        new = _whitener(_residual(u, y, data, eta))
        if len(new) == len(white) == 1:
            break
        white = new
    step = 1e-3 * np.eye(len(eta))
    H = [
        surprise(eta + e, data, centre)[1] - surprise(eta - e, data, centre)[1]
        for e in step
    ]
    return data, eta, (np.array(H) + np.transpose(H)) / 4e-3


def _residual(u, y, data, eta):
    """What the likeliest responses, transient, drift, offset and slope leave of y."""
    prior, U, half = _posterior(eta, data)
    N, m = u.shape[1:]
    theta = (prior.d * solve_triangular(U, half))[:, None]
    for j, g in enumerate(_responses(theta, data, m)[0]):
        y = y - fftconvolve(u[:, :, j], g[None, :N], axes=1)[:, :N]
    for k in range(2 * m, len(data.basis)):
        part = (data.basis[k] @ theta[data.block == k])[:N, 0]
        y[0, : len(part)] -= part
    return y - y @ _line(N) @ _line(N).T


def _whitener(noise):
    """Coefficients of the filter that makes noise (trial, time) white, by Schwarz's criterion."""
    p = min(COLOURS, noise.shape[1] // 20)
    lagged = np.stack(
        [noise[:, p - i : noise.shape[1] - i].ravel() for i in range(p + 1)], 1
    )
    found = []
    for order in range(p + 1):
        a = np.linalg.lstsq(lagged[:, 1 : order + 1], -lagged[:, 0])[0]
        left = np.mean((lagged[:, : order + 1] @ np.append(1, a)) ** 2)
        cost = len(lagged) * np.log(max(left, 1e-300)) + order * np.log(len(lagged))
        found.append((cost, np.append(1, a)))
    return min(found, key=lambda pair: pair[0])[1]
