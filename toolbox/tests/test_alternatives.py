"""Other designs in cases whose answers are known; filters known by a response, by convolution."""

import control
import numpy as np
import pytest
from plants import LOOPS, as_matrix, lifted, random_stable

from ilctools import LearningFilter, NormOptimal
from ilctools.alternatives import extent, finite_filter, gradient, pd_type


def test_pd_type_adds_the_error_and_its_slope():
    time = np.arange(50) * 0.1
    e = np.stack([np.sin(time), time**2], axis=1)
    slope = (e[4:] - e[3:-1]) / 0.1
    np.testing.assert_allclose(pd_type(0.5, 2.0, 4, 2, 0.1).apply(e)[:-4], 0.5 * e[4:] + 2 * slope)


def test_gradient_is_the_adjoint_of_a_trial():
    model = random_stable(0)
    adjoint = as_matrix(gradient(model, 0.3).apply, 40, 2)
    np.testing.assert_allclose(adjoint, 0.3 * lifted(model, 40).T, atol=1e-9)


def test_norm_optimal_solves_the_lifted_problem():
    """By dense algebra: with feedthrough, a delay, more outputs, states of 1e-20 to 1e20."""
    weight, like, rng = 0.03, random_stable(1), np.random.default_rng(0)
    units = np.geomspace(1e-20, 1e20, like.nstates)
    A, B, C = like.A * units / units[:, None], like.B / units[:, None], like.C * units
    scaled, furnace = control.ss(A, B, C, like.D, like.dt), LOOPS["furnace"]().P
    for P in (like, scaled, furnace, like[:, 0]):
        G, L = lifted(P, 60), NormOptimal(P, weight, 60)
        e = rng.standard_normal((60, L.channels))
        dense = np.linalg.solve(G.T @ G + weight * np.eye(G.shape[1]), G.T @ e.ravel())
        np.testing.assert_allclose(L.apply(e).ravel(), dense, atol=1e-9)


@pytest.mark.parametrize("pole", [-0.9, 1.05])
def test_a_pole_outside_the_circle_acts_backward_in_time(pole):
    """1 / (1 - p / z): p^k for k >= 0 inside, -p^k for k < 0 outside."""
    L = finite_filter(lambda w: 1 / (1 - pole * np.exp(-1j * w))[:, None, None], 1.0)
    taps, lags = L.coefficients[0, 0, ::-1], np.arange(-L.last, 1 - L.first)
    forward = abs(pole) < 1
    acts = (lags >= 0) == forward
    expected = np.zeros(len(lags))
    expected[acts] = (1 if forward else -1) * pole ** lags[acts].astype(float)
    np.testing.assert_allclose(taps, expected, atol=1e-8)


def test_extent_leaves_out_half_of_the_rest_at_each_end():
    assert extent(LearningFilter(np.ones((1, 1, 10)), 1.0)) == (10, -1)
    faint = np.array([0.01, 1.0, 1.0, 0.1])  # of the energy 0.00005 and 0.005
    assert extent(LearningFilter(faint[None, None], 1.0)) == (4, -2)


def test_what_does_not_decay_is_refused():
    with pytest.raises(ValueError, match="does not decay within 262144 samples"):
        finite_filter(lambda w: 1 / (1.0000001 - np.exp(-1j * w))[:, None, None], 1.0)
