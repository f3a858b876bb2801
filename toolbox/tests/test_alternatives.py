"""Other designs in cases whose answers are known; filters known by a response, by convolution."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_loop
from plants import LOOPS, as_matrix, frequencies, lifted, random_stable

from ilctools import Law, LearningFilter, NormOptimal
from ilctools.alternatives import TwoSidedFilter, extent, gradient, pd_type, two_sided_taps
from ilctools.models import frequency_response

PLANTS = {"rod": paper_loop} | LOOPS


@pytest.fixture(scope="module", params=["rod", "tanks", "furnace"])
def P(request):
    return PLANTS[request.param]().P


def test_pd_type_adds_the_error_and_its_slope():
    time = np.arange(50) * 0.1
    e = np.stack([np.sin(time), time**2], axis=1)
    np.testing.assert_allclose(pd_type(0.5, 0.0, 3, 2, 0.1).apply(e)[:-3], 0.5 * e[3:])
    slope = (e[4:] - e[3:-1]) / 0.1
    np.testing.assert_allclose(pd_type(0.5, 2.0, 4, 2, 0.1).apply(e)[:-4], 0.5 * e[4:] + 2 * slope)


def test_gradient_is_the_adjoint_of_a_trial_and_converges_at_its_rate(P):
    model, omega = random_stable(0), frequencies(P.dt)
    adjoint = as_matrix(gradient(model, 0.3).apply, 40, 2)
    np.testing.assert_allclose(adjoint, 0.3 * lifted(model, 40).T, atol=1e-9)
    response = frequency_response(P, omega)
    sigma = np.linalg.svd(response, compute_uv=False)
    step = 1.2 / sigma.max() ** 2
    M = np.eye(P.noutputs) - response @ gradient(P, step).frequency_response(omega)
    rate = np.abs(1 - step * sigma**2).max(axis=1)
    np.testing.assert_allclose(np.linalg.norm(M, 2, axis=(1, 2)), rate, atol=1e-12)


def test_norm_optimal_solves_the_lifted_problem():
    """By dense algebra: with feedthrough, with a delay, with states in units of 1e-20 to 1e20."""
    weight, like = 0.03, random_stable(1)
    units = np.geomspace(1e-20, 1e20, like.nstates)
    A, B, C = like.A * units / units[:, None], like.B / units[:, None], like.C * units
    for P in (like, control.ss(A, B, C, like.D, like.dt), LOOPS["furnace"]().P):
        G, L = lifted(P, 60), NormOptimal(P, weight, 60)
        dense = np.linalg.solve(G.T @ G + weight * np.eye(len(G)), G.T)
        np.testing.assert_allclose(as_matrix(L.apply, 60, L.channels), dense, atol=1e-9)


def test_norm_optimal_tends_to_its_response_far_from_the_ends():
    P = LOOPS["tanks"]().P
    samples, middle, m = 2000, 1000, P.noutputs
    L, pulse = NormOptimal(P, 0.1, samples), np.zeros((m, samples, m))
    pulse[range(m), middle, range(m)] = 1
    omega = frequencies(P.dt, 9)
    turns = np.exp(-1j * np.outer(omega * P.dt, np.arange(samples) - middle))
    response = np.einsum("nt,jti->nij", turns, L.apply(pulse))
    np.testing.assert_allclose(response, L.frequency_response(omega), atol=1e-6)


def finite(seed, m, Ts, first=-3, count=7):
    """Random taps at the lags first, first + 1, ..., as a filter known by its response."""
    taps = np.random.default_rng(seed).standard_normal((count, m, m))
    lags = np.arange(first, first + count)

    def response(omega):
        return np.tensordot(np.exp(-1j * np.outer(omega * Ts, lags)), taps, axes=1)

    return TwoSidedFilter(response, m, Ts), lags, taps


@given(st.integers(0, 99), st.integers(1, 3), st.integers(1, 30))
def test_it_is_the_two_sided_convolution_cut_to_the_trial(seed, m, samples):
    L, lags, taps = finite(seed, m, Ts=40.0)
    e = np.random.default_rng(seed + 1).standard_normal((2, samples, m))
    expected = np.zeros_like(e)
    for p in range(samples):
        for lag, tap in zip(lags, taps, strict=True):
            if 0 <= p - lag < samples:
                expected[:, p] += e[:, p - lag] @ tap.T
    np.testing.assert_allclose(L.apply(e), expected, atol=1e-12)


def test_a_filter_that_looks_ahead_does_in_the_law_what_a_learning_filter_does(Q):
    coefficients, e = np.random.default_rng(0).standard_normal((2, 2, 80, 2))[:, 0]
    known = LearningFilter(coefficients[:5].T[:, None] * [[1.0], [0.5]], 1.0)
    same = TwoSidedFilter(known.frequency_response, 2, 1.0)
    expected = Law(Q, known).next(e, e)
    np.testing.assert_allclose(Law(Q, same).next(e, e), expected, atol=1e-11)


@pytest.mark.parametrize("pole", [-0.9, 1.05])
def test_a_pole_outside_the_circle_acts_backward_in_time(pole):
    """1 / (1 - p / z): p^k for k >= 0 inside, -p^k for k < 0 outside."""
    L = TwoSidedFilter(lambda w: 1 / (1 - pole * np.exp(-1j * w))[:, None, None], 1, 1.0)
    lags, taps = two_sided_taps(L)
    forward = abs(pole) < 1
    acts = (lags >= 0) == forward
    expected = np.zeros(len(lags))
    expected[acts] = (1 if forward else -1) * pole ** lags[acts].astype(float)
    np.testing.assert_allclose(taps[:, 0, 0], expected, atol=1e-8)


def test_extent_leaves_out_half_of_the_rest_at_each_end():
    assert extent(LearningFilter(np.ones((1, 1, 10)), 1.0)) == (10, -1)
    faint = np.array([0.01, 1.0, 1.0, 0.1])  # of the energy 0.00005 and 0.005
    assert extent(LearningFilter(faint[None, None], 1.0)) == (4, -2)


def test_what_cannot_be_applied_is_refused():
    standing = TwoSidedFilter(lambda w: 1 / (1.0000001 - np.exp(-1j * w))[:, None, None], 1, 1.0)
    with pytest.raises(ValueError, match="does not decay within 262144 samples"):
        standing.apply(np.ones((5, 1)))
    L, _, _ = finite(0, 2, 1.0)
    with pytest.raises(ValueError, match=r"signal has shape \(5, 1\)"):
        L.apply(np.ones((5, 1)))
