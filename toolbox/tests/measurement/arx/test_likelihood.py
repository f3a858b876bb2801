"""The marginal likelihood: against the same normal distribution, written out."""

import numpy as np
import pytest
from records import dense, trials_of
from scipy.optimize import approx_fprime

from ilctools.measurement.arx import regressors, unknowns
from ilctools.measurement.arx.likelihood import negative_log_posterior
from ilctools.measurement.arx.prior import CENTRE, OF_OUTPUT, WIDTH, Hyperparameters, prior
from ilctools.measurement.arx.regressors import data_of


@pytest.mark.parametrize(
    ("lengths", "trials", "starts", "kept"),
    [((60,), 3, 300, 180), ((40, 60), 1, 300, 100), ((60,), 3, 30, 135)],
)
def test_the_likelihood_is_that_of_the_normal_distribution(
    monkeypatch, lengths, trials, starts, kept
):
    """Of all samples, some at a time; where starts are too many, without the first."""
    monkeypatch.setattr(unknowns, "MOST_OF_STARTS", starts)
    monkeypatch.setattr(regressors, "STRETCH", 16)
    groups = [trials_of(trials, N, seed=N) for N in lengths]
    data = data_of(groups, True, np.array([0, 7]))
    rows, means = dense(groups, data.layout)
    X, y, count = rows[:, :-1], rows[:, -1], len(rows) - 2 * len(lengths) * trials
    assert len(rows) == kept
    eta = np.append(np.random.default_rng(1).uniform(0, 2, 5), [0.7, 0.4])
    ratio = 1 / (1 + np.exp(0.7)) if means.any() else 1.0
    D = np.exp(prior(Hyperparameters(*eta), data.layout).log_D)
    S = np.diag(np.where(means, 1 / ratio, 1.0)) + X * D @ X.T
    rest = y @ np.linalg.solve(S, y)
    by_hand = count / 2 * np.log(rest) + np.linalg.slogdet(S)[1] / 2
    by_hand += np.log(ratio)  # twice its half: offset and slope of the mean are free
    off = eta + OF_OUTPUT * np.log(rest / count) - CENTRE
    value, gradient = negative_log_posterior(eta, data)
    assert value == pytest.approx(by_hand + np.sum((off / WIDTH) ** 2) / 2, abs=1e-6)
    steps = approx_fprime(eta, lambda x: negative_log_posterior(x, data)[0], 1e-6)
    np.testing.assert_allclose(gradient, steps, rtol=1e-3, atol=1e-3)
