"""The regression behind an estimate: against the same normal distributions, written out."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.signal import lfilter

from ilctools.measurement import regression as module
from ilctools.measurement.regression import Trials, contrasts, records, regression, surprise


def trials_of(trials, N=60, m=2, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((trials, N, m))
    y = sum(lfilter([0, j + 1.0], [1, -0.6], u[..., j]) for j in range(m))
    y = y + noise * rng.standard_normal((trials, N))
    return Trials(u, y[..., None], tuple(f"trial {k}" for k in range(trials)))


@pytest.mark.parametrize(("lengths", "trials"), [((60,), 1), ((60,), 3), ((40, 60), 1)])
def test_the_likelihood_is_that_of_the_normal_distribution(lengths, trials):
    groups = [trials_of(trials, N, seed=N) for N in lengths]
    data = module._normal(groups, module._layout(groups, True, np.array([0, 7])))
    rows = list(records(groups, data.layout))
    X, y = (np.concatenate([row[k] for row in rows]) for k in (0, 1))
    means = np.concatenate([np.full(len(row[1]), row[3]) for row in rows])
    kinds = data.layout.kind.max() + 1
    eta = np.append(np.random.default_rng(1).uniform(0, 2, 2 * kinds), 0.7)
    centre = eta + 0.5
    ratio = 1 / (1 + np.exp(0.7)) if means.any() else 1.0
    weight = np.where(means, ratio, 1.0)
    S = np.diag(1 / weight) + X * np.exp(data.layout.prior(eta)[0]) @ X.T
    count = len(y) - 2 * len(rows)
    by_hand = count / 2 * np.log(y @ np.linalg.solve(S, y)) + np.linalg.slogdet(S)[1] / 2
    by_hand += np.log(ratio) * 2 * means.any() / 2  # offset and slope of the mean are free
    value, gradient = surprise(eta, data, centre)
    assert value == pytest.approx(by_hand + len(eta) * 0.5**2 / 9 / 2, abs=1e-6)
    steps = approx_fprime(eta, lambda x: surprise(x, data, centre)[0], 1e-6)
    np.testing.assert_allclose(gradient, steps, rtol=1e-3, atol=1e-3)


def test_the_prior_of_the_coefficients_is_the_tuned_correlated_kernel_after_a_delay():
    layout, scale, time = (module._layout([trials_of(1)], True, np.array([7, 2])), 0.7, 2.0)
    kinds = layout.kind.max() + 1
    eta = np.append(np.repeat([scale, time], kinds), 0.0)
    variance = np.exp(layout.prior(eta)[0])[layout.kind == 1]
    covariance = layout.moves[0] * variance @ layout.moves[0].T
    lag = np.arange(len(covariance) - 7)
    kernel = np.exp(scale - np.maximum.outer(lag, lag) / np.exp(time))
    np.testing.assert_allclose(covariance[7:, 7:], kernel, rtol=1e-9)
    assert not covariance[:7].any()


def test_contrasts_keep_independent_noise_and_take_what_repeats_into_one():
    rng = np.random.default_rng(0)
    signal = np.concatenate([np.zeros((5, 1)), rng.standard_normal((5, 30))], axis=1)
    apart = contrasts(signal)
    np.testing.assert_allclose(apart.T @ apart, signal.T @ signal, atol=1e-12)
    again = contrasts(signal + np.arange(31.0))
    np.testing.assert_allclose(again[1:], apart[1:], atol=1e-12)


def test_zeros_are_counted_as_the_roots_have_them():
    a = 0.25 * np.random.default_rng(0).standard_normal((12, 200))
    largest = [np.abs(np.roots(np.append(1, column[1:]))).max() for column in a.T]
    np.testing.assert_array_equal(module._are_stable(a), np.array(largest) < 1)
    assert 20 < np.sum(np.array(largest) < 1) < 180


def test_of_much_data_it_is_the_plant():
    groups = [trials_of(1, N=4000, noise=1e-3)]
    fit, omega = regression(groups, direct=True), np.linspace(0.01, 3, 50)
    z = np.exp(1j * omega)[:, None]
    truth = np.array([1.0, 2.0]) / (z - 0.6)
    drawn = fit.response(omega)
    np.testing.assert_allclose(drawn[0], truth, atol=1e-3)
    assert np.quantile(np.abs(drawn[1:] - drawn[0]), 0.95) < 2e-3
    assert fit.learned(omega).max() < 0.1
    spectrum = np.exp(-1j * np.outer(omega, np.arange(400))) @ fit.impulse(400).T
    np.testing.assert_allclose(spectrum, drawn[0], atol=1e-6)


def test_the_draws_do_not_depend_on_the_signs_of_eigenvectors(monkeypatch):
    """Which are LAPACK's choice, another one on another processor."""
    groups, omega = [trials_of(1, N=60, noise=0.1)], np.linspace(0.01, 3, 20)
    here, eigh = regression(groups, direct=True).response(omega), np.linalg.eigh

    def other_signs(matrix):
        values, vectors = eigh(matrix)
        return values, vectors * (-1) ** np.arange(len(values))

    monkeypatch.setattr(np.linalg, "eigh", other_signs)
    there = regression(groups, direct=True).response(omega)
    np.testing.assert_allclose(there, here, rtol=1e-6, atol=1e-6 * np.abs(here).max())


def test_outputs_are_drawn_independently():
    groups, omega = [trials_of(1, N=60, noise=0.1)], np.linspace(0.01, 3, 20)
    one, other = (regression(groups, True, seed).response(omega)[1:, :, 0] for seed in (0, 1))
    n = min(len(one), len(other))
    likeness = np.corrcoef(np.abs(one[:n, 10]), np.abs(other[:n, 10]))[0, 1]
    assert abs(likeness) < 4 / np.sqrt(n)
