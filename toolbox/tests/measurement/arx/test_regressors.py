"""The regressors of a series, and the products of all."""

import numpy as np
import pytest
from records import dense, trials_of
from scipy.signal import lfilter

from ilctools.measurement.arx import regressors
from ilctools.measurement.arx.regressors import Regressors, products
from ilctools.measurement.arx.trials import series_of
from ilctools.measurement.arx.unknowns import Kind, coefficients, layout_of


def test_each_regressor_is_the_response_to_a_signal():
    """By convolution with the coefficients of one increment; ramps by hand."""
    groups = [trials_of(2)]
    layout = layout_of(groups, True, np.array([0, 7]), resonances=[0.4])
    for series in series_of(groups):
        X = Regressors(series, layout).rows()

        def moved(signal, knots, increment):
            g = coefficients(np.eye(len(knots))[increment], knots, 60)
            return np.convolve(signal, g)[:60]

        np.testing.assert_allclose(
            X[layout.where(Kind.A)][4], moved(-series.y, layout.knots_of_A, 4), atol=1e-12
        )
        late = moved(series.u[:, 1], layout.knots_of_B[1], 3)
        np.testing.assert_allclose(X[layout.where(Kind.B, 1)][3], late, atol=1e-12)
        parts, p = X[layout.where(Kind.PART, 0)], np.exp(-3 / 60)  # a third of a trial
        slow = lfilter([0, 1 - p], [1, -p], series.u[:, 0])
        np.testing.assert_allclose(parts[1], slow, atol=1e-12)
        np.testing.assert_allclose(parts, layout.parts.answers(series.u[:, 0]), atol=1e-12)
        own, others = (X[layout.where(Kind.START, key)] for key in ((0, 0), (0, 1)))
        own, others = (own, others) if series.is_mean else (others, own)
        pulse = moved(np.eye(1, 60)[0], layout.knots_of_start, 2)
        np.testing.assert_allclose(own[2], pulse, atol=1e-12)
        assert not others.any()
        drift = X[layout.where(Kind.DRIFT, 0)]
        ends = [0.0, 1.0] if series.is_mean else [0.0, 0.0]  # what repeats is in the mean alone
        np.testing.assert_allclose(drift[:, [0, -1]], np.tile(ends, (len(drift), 1)), atol=1e-12)


@pytest.mark.parametrize("stretch", [8192, 7])
def test_products_are_those_of_all_rows_at_once(monkeypatch, stretch):
    """In short stretches, too."""
    monkeypatch.setattr(regressors, "STRETCH", stretch)
    groups = [trials_of(2), trials_of(1, N=40)]
    layout = layout_of(groups, True, np.array([0, 7]))
    rows, means = dense(groups, layout)
    found = products(groups, layout)
    for part, which in ((found.single, ~means), (found.means, means)):
        Z = rows[which]
        np.testing.assert_allclose(part, Z.T @ Z, atol=1e-9 * np.abs(Z.T @ Z).max())
    assert (found.n, found.n_1) == (160 - 6, 60 - 2)
