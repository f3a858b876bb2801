"""The regression behind an estimate: against the same normal distributions, written out."""

from dataclasses import replace

import numpy as np
import pytest
from records import dense
from scipy.optimize import approx_fprime
from scipy.signal import detrend, lfilter

from ilctools.measurement import regression as module
from ilctools.measurement.regression import Trials, lagged, negative_log_posterior, regression


def trials_of(trials, N=60, m=2, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((trials, N, m))
    y = sum(lfilter([0, j + 1.0], [1, -0.6], u[..., j]) for j in range(m))
    y = y + noise * rng.standard_normal((trials, N))
    return Trials(u, y[..., None], tuple(f"trial {k}" for k in range(trials)))


@pytest.mark.parametrize(
    ("lengths", "trials", "starts", "kept"),
    [((60,), 3, 300, 180), ((40, 60), 1, 300, 100), ((60,), 3, 30, 135)],
)
def test_the_likelihood_is_that_of_the_normal_distribution(
    monkeypatch, lengths, trials, starts, kept
):
    """Of all samples, some at a time; where starts are too many, without the first."""
    monkeypatch.setattr(module, "STARTS", starts)
    monkeypatch.setattr(module, "STRETCH", 16)
    groups = [trials_of(trials, N, seed=N) for N in lengths]
    data = module._normal(groups, module._layout(groups, True, np.array([0, 7])), None)
    rows, means = dense(groups, data.layout)
    X, y, count = rows[:, :-1], rows[:, -1], len(rows) - 2 * len(lengths) * trials
    assert len(rows) == kept
    eta = np.append(np.random.default_rng(1).uniform(0, 2, 5), [0.7, 0.4])
    ratio = 1 / (1 + np.exp(0.7)) if means.any() else 1.0
    S = np.diag(np.where(means, 1 / ratio, 1.0)) + X * np.exp(data.layout.prior(eta)[0]) @ X.T
    rest = y @ np.linalg.solve(S, y)
    by_hand = count / 2 * np.log(rest) + np.linalg.slogdet(S)[1] / 2
    by_hand += np.log(ratio)  # twice its half: offset and slope of the mean are free
    off = eta + module.SIZES * np.log(rest / count) - module.CENTRE
    value, gradient = negative_log_posterior(eta, data)
    assert value == pytest.approx(by_hand + np.sum((off / module.WIDE) ** 2) / 2, abs=1e-6)
    steps = approx_fprime(eta, lambda x: negative_log_posterior(x, data)[0], 1e-6)
    np.testing.assert_allclose(gradient, steps, rtol=1e-3, atol=1e-3)


def test_the_prior_of_the_coefficients_is_the_tuned_correlated_kernel_after_a_delay():
    layout, scale, time = (module._layout([trials_of(1)], True, np.array([7, 2])), 0.7, 2.0)
    eta = np.array([scale, scale, scale, scale, time, 0.0, 0.3])
    variance, slow = np.split(np.exp(layout.prior(eta)[0])[layout.kind == 1], [-2])
    np.testing.assert_allclose(slow, np.exp(0.3))
    lags = np.arange(layout.knots[1][-1] + 1)
    moves = lagged(lags == 0, layout.knots[1])(slice(None)).T
    covariance = moves * variance @ moves.T
    lag = np.arange(len(covariance) - 7)
    kernel = np.exp(scale - np.maximum.outer(lag, lag) / np.exp(time))
    np.testing.assert_allclose(covariance[7:, 7:], kernel, rtol=1e-9)
    assert not covariance[:7].any()


def test_regressors_impulse_and_frequency_response_are_those_of_one_model():
    """Slow parts among them, of a size that counts; A is one."""
    groups = [trials_of(1)]
    fit, omega = regression(groups, direct=True), np.linspace(0.01, 3, 20)
    layout, rng = fit.data.layout, np.random.default_rng(0)
    x = rng.standard_normal(len(fit.mean)) * ((layout.kind == 1) | (layout.kind == 2))
    model = replace(fit, mean=x)
    y = sum(
        np.convolve(u, g)[:60] for u, g in zip(groups[0].u[0].T, model.impulse(60), strict=True)
    )
    X = dense(groups, layout)[0][:, :-1]
    np.testing.assert_allclose(X @ x, detrend(y), atol=1e-9)
    spectrum = np.exp(-1j * np.outer(omega, np.arange(3000))) @ model.impulse(3000).T
    np.testing.assert_allclose(spectrum, model.response(omega), atol=1e-9)


def test_the_covariance_of_P_is_that_of_the_coefficients_by_their_slopes():
    """To first order: slopes of P and of log A by differences, coefficient by coefficient."""
    fit, omega = regression([trials_of(1, N=100)], direct=True), np.linspace(0.01, 3, 5)
    step = 1e-6 * np.abs(fit.mean).max()

    def parts(x):
        changed = replace(fit, mean=x)
        A = 1 + fit.data.layout.waves(omega)[0] @ fit.of(0, x)
        both = np.column_stack([changed.response(omega), np.log(A)])
        return np.hstack([both.real, both.imag])  # (n, 2 (m + 1))

    slopes = [parts(fit.mean + e) - parts(fit.mean - e) for e in step * np.eye(len(fit.mean))]
    slopes = np.moveaxis(slopes, 0, 2) / (2 * step)
    expected = slopes @ fit.C @ slopes.swapaxes(1, 2)
    S, of_A = fit.covariance(omega)
    of_P = [0, 1, 3, 4]
    atol = 1e-6 * np.abs(S).max()
    np.testing.assert_allclose(S, expected[:, of_P][:, :, of_P], rtol=1e-5, atol=atol)
    variances = expected[:, [2, 5], [2, 5]].T
    np.testing.assert_allclose(of_A, variances, rtol=1e-5, atol=1e-6 * of_A.max())


def test_the_covariance_is_that_of_normal_distributions_with_other_hyperparameters():
    """About the estimate, at each of the points: inverses of dense matrices."""
    groups = [trials_of(1, N=40, noise=0.3)]
    fit = regression(groups, direct=True)
    best, S = module._polished(module._fitted(groups, True, np.zeros(2, int), None))
    data, expected = best.data, 0.0
    b, s = data.products[0][:-1, -1], data.products[0][-1, -1]
    points = best.eta + module.HEAVY * len(S) ** 0.5 * np.concatenate([S, -S])
    for eta in np.clip(points, -module.BOUND, module.BOUND):
        precision = data.products[0][:-1, :-1] + np.diag(np.exp(-data.layout.prior(eta)[0]))
        mean = np.linalg.solve(precision, b)
        variance = (s - mean @ b) / data.count[0]
        off = mean - fit.mean
        expected = expected + variance * np.linalg.inv(precision) + np.outer(off, off)
    expected /= len(points)
    np.testing.assert_allclose(fit.C, expected, rtol=1e-5, atol=1e-6 * expected.max())
