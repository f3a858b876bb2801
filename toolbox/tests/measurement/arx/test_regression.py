"""P of one output and the covariance of its error, by the unknowns of the regression."""

from dataclasses import replace

import numpy as np
from records import dense, trials_of
from scipy.signal import detrend

from ilctools.measurement.arx.regression import regression
from ilctools.measurement.arx.regressors import data_of
from ilctools.measurement.arx.unknowns import Kind


def test_regressors_impulse_and_frequency_response_are_those_of_one_model():
    """Slow and resonant parts among them, of a size that counts; A is one."""
    groups = [trials_of(1)]
    data, omega = data_of(groups, True, np.zeros(2, int), (), [0.5]), np.linspace(0.01, 3, 20)
    layout, rng = data.layout, np.random.default_rng(0)
    x = rng.standard_normal(layout.size) * np.isin(layout.kind, [Kind.B, Kind.PART])
    model = replace(regression(groups, direct=True), mean=x, data=data)
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
        layout = fit.data.layout
        A = 1 + layout.waves_of_A(omega) @ x[layout.where(Kind.A)]
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


def test_a_P_that_is_known_at_rest_is_met_there():
    """Each of two gains, though the records say others: the error is a thousandth."""
    groups, rest, gain = [trials_of(1)], np.array([1e-4]), np.array([3.0, 4.0])
    free, known = (regression(groups, True, gain=given) for given in ((), gain))
    np.testing.assert_allclose(known.response(rest)[0], gain, rtol=1e-3)
    assert np.abs(free.response(rest)[0] - gain).min() > 0.1
    variances = [np.trace(fit.covariance(rest).of_P[0]) for fit in (free, known)]
    assert variances[1] < 1e-4 * variances[0]
