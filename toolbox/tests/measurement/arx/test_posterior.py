"""The posterior of the unknowns: against the inverse of a dense matrix."""

import numpy as np
from records import trials_of

from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import prior
from ilctools.measurement.arx.regressors import data_of

ETA = np.array([0.1, 0.7, 0.2, 0.4, 2.0, 0.7, 0.3])


def test_mean_covariance_and_residue_are_those_of_normal_distributions():
    data = data_of([trials_of(3)], True, np.array([0, 7]))
    at = posterior(ETA, data)
    G = data.single + data.means / (1 + np.exp(0.7))
    covariance = np.linalg.inv(G[:-1, :-1] + np.diag(np.exp(-prior(ETA, data.layout).log_D)))
    mean = covariance @ G[:-1, -1]
    np.testing.assert_allclose(at.mean, mean, atol=1e-9 * np.abs(mean).max())
    np.testing.assert_allclose(at.spread, covariance, atol=1e-9 * covariance.max())
    np.testing.assert_allclose(at.r, G[-1, -1] - mean @ G[:-1, -1], rtol=1e-9)


def test_without_noise_the_residue_is_that_of_rounding():
    """And without means their weight is nothing to estimate."""
    data = data_of([trials_of(1, noise=0.0)], True, np.zeros(2, int))
    at = posterior(ETA + 20 * (np.arange(7) < 2), data)
    assert at.r >= 1e-14 * data.single[-1, -1] and at.weight == 1.0
