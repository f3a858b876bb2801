"""The regression behind an estimate: against the same normal distributions, written out."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.optimize import approx_fprime
from scipy.signal import lfilter

from rodlib.ilc.measurement import impulse
from rodlib.ilc.measurement.impulse import DRIFT, FAST, SLOW, impulse_of, surprise

WHITE = np.array([2.0, -0.5, 0.1])


def record(trials, N=90, m=2, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((trials, N, m))
    g = np.exp(-np.arange(30) / [[5.0], [3.0]])[:m]
    y = sum(lfilter(g[j], 1, u[..., j]) for j in range(m))
    return u, y + noise * rng.standard_normal((trials, N)), g


def dense(u, y, data, n):
    """Regressors and outputs that are white and free of offset and slope, trial by trial."""
    K, N, m = u.shape
    line = np.stack([np.ones(N), np.arange(N)], axis=1)
    p, rows = len(WHITE) - 1, []
    for k in range(K):
        columns = [
            toeplitz(u[k, :, j], np.zeros(n)) @ B[:n]
            for j in range(m)
            for B in data.basis[:2]
        ]
        if K == 1:
            columns += [
                np.pad(B, ((0, N - len(B)), (0, 0))) for B in data.basis[2 * m :]
            ]
        white = [
            lfilter(WHITE, 1, x, axis=0)[p:] for x in (np.hstack(columns), y[k], line)
        ]
        off = np.eye(N - p) - white[2] @ np.linalg.pinv(white[2])
        rows.append((off @ white[0], off @ white[1]))
    return tuple(np.concatenate(each) for each in zip(*rows, strict=True))


@pytest.mark.parametrize(("trials", "n"), [(1, 90), (4, 20)])
def test_the_likelihood_is_that_of_the_normal_distribution(trials, n):
    u, y, _ = record(trials)
    data = impulse._normal(u, y, WHITE, n)
    X, e = dense(u, y, data, n)
    np.testing.assert_allclose(data.R, X.T @ X, atol=1e-9)
    np.testing.assert_allclose(data.b, X.T @ e, atol=1e-9)
    assert data.s == pytest.approx(e @ e)
    eta = np.concatenate([[1.5, 0.7, 0.3, 2.0], np.linspace(-1, 1, data.block[-1] + 1)])
    fast = np.exp(1.5)
    slow = 1 / (1 / (fast * (1 + np.exp(0.3))) + 1 / 45)
    decay = np.select([data.kind == FAST, data.kind == SLOW], [fast, slow], np.inf)
    alike = np.select(
        [data.kind == FAST, data.kind == SLOW], [fast / (1 + np.exp(-0.7)), slow]
    )
    alike = np.where(data.kind == DRIFT, np.exp(2.0), alike)
    size = np.exp(eta[4:] / 2)
    for k in data.slow:  # of the gain of the fast part, times its own
        size[k] *= size[k - 1] * fast / slow
    d = size[data.block] * np.exp(-data.lag / decay)
    same = data.block[:, None] == data.block
    prior = (
        np.exp(-np.abs(data.lag[:, None] - data.lag) / alike) * np.outer(d, d) * same
    )
    S = np.eye(len(X)) + X @ prior @ X.T
    value, gradient = surprise(eta, data, eta)
    by_hand = (
        data.count * np.log(e @ np.linalg.solve(S, e)) + np.linalg.slogdet(S)[1]
    ) / 2
    assert value == pytest.approx(
        by_hand, abs=1e-4
    )  # A is made definite by 1e-10 of itself
    steps = approx_fprime(eta, lambda x: surprise(x, data, eta)[0], 1e-6)
    np.testing.assert_allclose(gradient, steps, rtol=1e-3, atol=2e-2)


def test_of_much_data_it_is_the_response_and_in_other_units_the_same():
    u, y, g = record(6, noise=1e-4)
    found = impulse_of(u, y).drawn.mean(axis=0)
    np.testing.assert_allclose(found[:, :30], g, atol=2e-3)
    other = impulse_of(u * [1e3, 1.0], y * 1e-2).drawn.mean(axis=0)
    np.testing.assert_allclose(
        other, found * 1e-2 / [[1e3], [1.0]], rtol=1e-4, atol=1e-9
    )


def test_the_filter_of_coloured_noise_is_estimated():
    white = np.random.default_rng(0).standard_normal((5, 2000))
    noise = lfilter([1], [1, -0.9, 0.2], white)
    np.testing.assert_allclose(impulse._whitener(noise), [1, -0.9, 0.2], atol=0.03)
    assert len(impulse._whitener(white[:, :400])) == 1
