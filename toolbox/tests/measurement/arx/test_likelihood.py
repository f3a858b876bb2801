"""The marginal likelihood: against the same normal distribution, written out."""

from dataclasses import replace

import numpy as np
import pytest
from records import dense, group_of, trials_of
from scipy.optimize import approx_fprime
from scipy.signal import lfilter

from ilctools.measurement.arx import unknowns
from ilctools.measurement.arx.likelihood import Likelihood, likeliest, polished
from ilctools.measurement.arx.prior import CENTRE, OF_OUTPUT, WIDTH, prior
from ilctools.measurement.arx.regressors import data_of


@pytest.mark.parametrize(
    ("lengths", "trials", "starts", "kept"),
    [((60,), 3, 300, 180), ((40, 60), 1, 300, 100), ((60,), 3, 30, 135)],
)
def test_the_likelihood_is_that_of_the_normal_distribution(
    monkeypatch, lengths, trials, starts, kept
):
    """Of all samples; where starts are too many, without the first."""
    monkeypatch.setattr(unknowns, "MOST_OF_STARTS", starts)
    groups = [trials_of(trials, N, seed=N) for N in lengths]
    data = data_of(groups, True, np.array([0, 7]))
    rows, means = dense(groups, data.layout)
    X, y, count = rows[:, :-1], rows[:, -1], len(rows) - 2 * len(lengths) * trials
    assert len(rows) == kept
    eta = np.append(np.random.default_rng(1).uniform(0, 2, 5), [0.7, 0.4])
    ratio = 1 / (1 + np.exp(0.7)) if means.any() else 1.0
    D = np.exp(prior(eta, data.layout).log_D)
    S = np.diag(np.where(means, 1 / ratio, 1.0)) + X * D @ X.T
    rest = y @ np.linalg.solve(S, y)
    by_hand = count / 2 * np.log(rest) + np.linalg.slogdet(S)[1] / 2
    by_hand += np.log(ratio)  # twice its half: offset and slope of the mean are free
    off = eta + OF_OUTPUT * np.log(rest / count) - CENTRE
    at = Likelihood(eta, data)
    assert at.value == pytest.approx(by_hand + np.sum((off / WIDTH) ** 2) / 2, abs=1e-6)
    for of, slopes, tolerance in (("value", at.gradient, 1e-3), ("gradient", at.curvature, 1e-4)):
        steps = approx_fprime(eta, lambda x, of=of: getattr(Likelihood(x, data), of), 1e-6)
        np.testing.assert_allclose(slopes, steps, rtol=tolerance, atol=tolerance)


def with_noise_like_a_drift(seed):
    """One trial with coloured noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((1, 20)), 3, axis=1)
    noise = lfilter([1], [1, -0.9], 0.02 * rng.standard_normal(60))
    return replace(group_of(lfilter([0, 0.2], [1, -0.8], u) + noise, u), u=u[..., None])


def with_what_repeats(seed):
    """Two trials with a random walk that repeats."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((2, 12)), 5, axis=1)
    repeats = np.cumsum(0.3 * rng.standard_normal(60))
    noise = 0.03 * rng.standard_normal(u.shape)
    return group_of(lfilter([0, 0.2], [1, -0.8], u) + repeats + noise, u)


@pytest.mark.parametrize(
    ("make", "seed"),
    [
        (with_noise_like_a_drift, 80),  # with the guess of a drift alone, it is 4.4 higher
        (with_what_repeats, 92),  # with the guess of none alone, 13.1
    ],
)
def test_of_two_minima_the_lower_one_is_found(make, seed):
    """No search from 20 other guesses finds a lower one."""
    data, rng = data_of([make(seed)], True, np.zeros(1, int)), np.random.default_rng(0)
    others = CENTRE + 6 * OF_OUTPUT + WIDTH * rng.uniform(-1, 2, (20, len(CENTRE)))
    lowest = likeliest(data, others).cost
    assert likeliest(data).cost < lowest + 1e-4  # a search ends where the gradient is 0.01


def test_the_likeliest_eta_does_not_depend_on_where_its_search_began():
    """A search leaves a gradient of 0.01, Newton steps square it three times."""
    data = data_of([with_what_repeats(29)], True, np.zeros(1, int))
    best = likeliest(data)
    (one, S), (two, T) = (polished(likeliest(data, [best.eta + moved])) for moved in (0.1, -0.1))
    assert np.abs(np.linalg.solve(S, one.eta - two.eta)).max() < 1e-9
    assert np.abs(S @ Likelihood(one.eta, data).gradient).max() < 1e-9
    np.testing.assert_allclose(S, T, atol=1e-6 * np.abs(S).max())


def test_a_search_that_is_hopeless_ends_early_and_no_other_does():
    data = data_of([with_what_repeats(29)], True, np.zeros(1, int))
    least, first = likeliest(data), [CENTRE + 6 * OF_OUTPUT]
    whole = likeliest(data, first)
    assert likeliest(data, first, whole.cost + 1e-6).cost == whole.cost
    given_up = likeliest(data, first, least.cost - 100)
    assert given_up.cost > least.cost - 100 and np.any(given_up.eta != whole.eta)
