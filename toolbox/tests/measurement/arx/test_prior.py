"""The prior of the unknowns."""

import numpy as np
from records import trials_of

from ilctools.measurement.arx.prior import LOG_T, Hyperparameters, prior
from ilctools.measurement.arx.regressors import Lagged
from ilctools.measurement.arx.unknowns import Kind, layout_of

ETA = Hyperparameters(
    log_c_A=0.1, log_c_B=0.7, log_c_START=0.2, log_c_DRIFT=0.4, log_T=2.0, rho=0.0, log_c_PART=0.3
)


def test_the_prior_of_the_coefficients_is_the_tuned_correlated_kernel_after_a_delay():
    layout = layout_of([trials_of(1)], True, np.array([7, 2]))
    D = np.exp(prior(ETA, layout).log_D)
    np.testing.assert_allclose(D[layout.where(Kind.PART, 0)], np.exp(0.3))
    np.testing.assert_allclose(D[layout.where(Kind.DRIFT, 0)], np.exp(0.4))
    for kind, owner, log_c, knots in (
        (Kind.B, 0, 0.7, layout.knots_of_B[0]),
        (Kind.A, None, 0.1, layout.knots_of_A),
    ):
        lags, first = np.arange(knots[-1] + 1), knots[0]
        moves = np.empty((len(knots), len(lags)))
        Lagged(lags == 0, knots).write(moves)
        covariance = moves.T * D[layout.where(kind, owner)] @ moves
        lag = np.arange(len(covariance) - first)
        kernel = np.exp(log_c - np.maximum.outer(lag, lag) / np.exp(2.0))
        np.testing.assert_allclose(covariance[first:, first:], kernel, rtol=1e-9)
        assert not covariance[:first].any()


def test_slope_and_curvature_of_the_prior_are_those_of_differences():
    layout = layout_of([trials_of(1)], True, np.array([7, 2]))
    step = 1e-6
    above, below = (prior(ETA._replace(log_T=ETA.log_T + sign * step), layout) for sign in (1, -1))
    at = prior(ETA, layout)
    slope = (above.log_D - below.log_D) / (2 * step)
    np.testing.assert_allclose(at.slopes[:, LOG_T], slope, atol=1e-7)
    curvature = (above.slopes - below.slopes)[:, LOG_T] / (2 * step)
    np.testing.assert_allclose(at.curvature, curvature, atol=1e-7)
