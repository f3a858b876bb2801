"""Resonances that the residual shows."""

import numpy as np
import pytest
from plants import lag
from records import dense, group_of, held, log_of, moved, resonant, trials_of
from scipy.signal import freqz, lfilter

from ilctools import measured_response
from ilctools.measurement.arx import resonances
from ilctools.measurement.arx.likelihood import likeliest
from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import prior
from ilctools.measurement.arx.regressors import data_of
from ilctools.measurement.arx.resonances import noticeable, statistic, with_resonances

FREE = np.zeros(1, int)  # the delay of one input


def two_modes(seed, weak=0.47, N=1000):
    """White noise through a large mode at 0.45 and a weak one, under noise of 10 %; and P."""
    rng = np.random.default_rng(seed)
    u, modes = rng.standard_normal(N), [(1.0, resonant(0.45, 0.006)), (0.3, resonant(weak, 0.006))]
    y = sum(gain * lfilter(*mode, u) for gain, mode in modes)
    y = y + 0.1 * y.std() * rng.standard_normal(N)
    return u[None], y[None], lambda omega: sum(gain * freqz(*m, omega)[1] for gain, m in modes)


def distance(estimate, P):
    """How far the truth is from an estimate near both modes at most, in joint radii."""
    omega = np.linspace(0.4, 0.52, 300)
    response, radius = estimate.on(omega, 0.99)
    return np.max(np.abs(response[:, 0, 0] - P(omega)) / radius)


def test_a_weak_mode_next_to_a_large_one_is_within_the_region(monkeypatch):
    """Without resonant parts the truth is four radii away."""
    u, y, P = two_modes(0)
    estimate = measured_response(log_of(u, y))
    found = estimate.fits[0].data.layout.resonances
    assert np.abs(found - 0.47).min() < 5 / 1000
    assert distance(estimate, P) < 1
    assert f"and with resonant parts at {found[0]:.3g} rad/s" in str(estimate)
    monkeypatch.setattr(resonances, "TESTS", 0)
    assert distance(measured_response(log_of(u, y)), P) > 4


def test_the_statistic_is_that_of_the_normal_distribution():
    """By the inverse of the covariance of y without columns Z: of two groups, and two inputs."""
    groups, omega = [trials_of(1, N=120), trials_of(1, N=80, seed=1)], np.array([0.6, 1.1])
    data = data_of(groups, True, np.zeros(2, int))
    at = posterior(likeliest(data).eta, data)
    rows, _ = dense(groups, data.layout)
    X, y = rows[:, :-1], rows[:, -1]
    S = np.eye(len(y)) + X * np.exp(prior(likeliest(data).eta, data.layout).log_D) @ X.T
    A, found = data.layout.denominator(at.mean), statistic(data, at, groups, omega)
    for F, angle in zip(found.F, omega, strict=True):
        Z = []
        for group in groups:
            t = np.arange(group.y.shape[1])
            columns = [
                np.convolve(np.convolve(A, u)[: len(t)], wave(angle * (t - 1)) * decays)[: len(t)]
                for rate in (2, 4, 8)
                for decays in [np.where(t > 0, np.exp(-rate / 120 * (t - 1)), 0)]
                for wave in (np.cos, np.sin)
                for u in group.u[0].T
            ]
            line = np.linalg.qr(np.vander(t, 2))[0]
            Z.append(np.array(columns).T - line @ line.T @ np.array(columns).T)
        Z = np.concatenate(Z)
        white = np.linalg.solve(S, Z)
        q, J = white.T @ y, Z.T @ white
        by_hand = q @ np.linalg.solve(J, q) / Z.shape[1] / (at.r / data.n)
        assert pytest.approx(by_hand, rel=1e-5) == F
    assert found.k == 2 * 3 * 2 and found.n == 120 + 80 - 4


def test_a_lag_has_no_resonance():
    """Over twenty draws one is found by chance in one of twenty, and three or fewer in all."""
    found = 0
    for seed in range(20):
        estimate = measured_response(moved(lag(), 300, seed, 0.05))
        found += len(estimate.fits[0].data.layout.resonances) > 0
    assert found <= 3


def test_none_is_looked_for_in_trials_under_learning_and_in_very_long_ones(monkeypatch):
    u, y, _ = two_modes(0)
    together = group_of(y[0].reshape(2, 500), u[0].reshape(2, 500))
    alone = group_of(y, u)
    for groups, longest, expected in (
        ([together], 4096, False),
        ([alone], 4096, True),
        ([alone], 999, False),
    ):
        monkeypatch.setattr(resonances, "LONGEST_TESTED", longest)
        fit = likeliest(data_of(groups, True, FREE))
        assert bool(with_resonances(fit, groups, True).data.layout.resonances.size) == expected


def test_the_highest_peak_comes_first_and_none_is_below_the_lowest_frequency(monkeypatch):
    u, y, _ = two_modes(1, weak=0.5)
    groups = [group_of(y, u)]
    fit = likeliest(data_of(groups, True, FREE))
    both = noticeable(fit, groups)
    np.testing.assert_allclose(both, [0.5, 0.45], atol=0.002)
    monkeypatch.setattr(resonances, "MOST_AT_ONCE", 1)
    np.testing.assert_array_equal(noticeable(fit, groups), both[:1])
    again = with_resonances(fit, groups, True).data.layout.resonances
    assert again[0] == both[0] and again.size == 2  # one by each test
    monkeypatch.setattr(resonances, "LOWEST", 1000 * 0.52)
    assert not np.any(noticeable(fit, groups) < 0.51)


def test_a_short_trial_has_no_frequency_to_test():
    rng = np.random.default_rng(0)
    u = held(rng, 1, 20)
    groups = [group_of(lfilter([0, 0.3], [1, -0.7], u), u)]
    assert not len(noticeable(likeliest(data_of(groups, True, FREE)), groups))
