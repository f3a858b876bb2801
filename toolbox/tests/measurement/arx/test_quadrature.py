"""The covariance over the hyperparameters: inverses of dense matrices, point by point."""

import numpy as np
from records import trials_of

from ilctools.measurement.arx.likelihood import likeliest, polished
from ilctools.measurement.arx.prior import Hyperparameters, prior
from ilctools.measurement.arx.quadrature import HEAVY
from ilctools.measurement.arx.regression import regression
from ilctools.measurement.arx.regressors import data_of


def test_the_covariance_is_that_of_normal_distributions_with_other_hyperparameters():
    """About the estimate, at each of the points; and with parts that are 3.5 times as large."""
    groups = [trials_of(1, N=40, noise=0.3)]
    fit = regression(groups, direct=True)
    best, S = polished(likeliest(data_of(groups, True, np.zeros(2, int))))
    data, expected = best.data, 0.0
    b, s = data.single[:-1, -1], data.single[-1, -1]

    def normal(eta):
        D = np.exp(prior(eta, data.layout).log_D)
        covariance = np.linalg.inv(data.single[:-1, :-1] + np.diag(1 / D))
        return covariance @ b, covariance

    points = best.eta + HEAVY * len(S) ** 0.5 * np.concatenate([S, -S])
    for eta in points:
        mean, covariance = normal(eta)
        off = mean - fit.mean
        expected = expected + (s - mean @ b) / data.n * covariance + np.outer(off, off)
    expected /= len(points)
    larger = best.eta + 2 * np.log(3.5) * (np.array(Hyperparameters._fields) == "log_c_PART")
    off = normal(larger)[0] - fit.mean
    expected = expected + np.outer(off, off)
    np.testing.assert_allclose(fit.C, expected, rtol=1e-5, atol=1e-6 * expected.max())
