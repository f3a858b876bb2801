"""L = B K: its peaks against dense grids, and trials; B against its formula: test_pooled."""

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import STAGE_WITH_MODES as STAGE
from plants import as_matrix, furnace, lags, sigma_of_M

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    frequency_response,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.base import RegularisedInverse, extended, in_units
from ilctools.evidence.peak import peak_of_L, peak_of_M

LOOP, Q = ClosedLoop(STAGE), zero_phase_butterworth(2, 150.0, 1e-3)


def errors_of(L, reference, trials, **how):
    """RMS in trials on the stage."""
    return rms(run_trials(LOOP, Law(Q, L), reference, trials=trials, **how).e).values


@pytest.fixture(scope="module")
def with_base():
    """L = B K on trials of any length."""
    return synthesise(STAGE, Q, base=0.03)


@pytest.fixture(scope="module")
def finite():
    """The same as a filter that reaches so far, for trials without reset."""
    return synthesise(STAGE, Q, base=0.03, reach=200)


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
@pytest.mark.parametrize(("first", "order"), [(1, 4), (-3, 7), (-5, 2), (3, 2), (-80, 161)])
def test_a_filter_is_a_sum_over_samples(first, order, ends):
    N, taps = 9, np.random.default_rng(1).standard_normal((2, 2, order))
    at = np.arange(N)[:, None] + first + np.arange(order)
    taken = np.eye(N)[np.clip(at, 0, N - 1)]
    taken[at < 0] *= ends == "hold"
    taken[at >= N] *= ends != "zero"
    dense = np.einsum("pkq,ijk->piqj", taken, taps).reshape(2 * N, 2 * N)
    L = LearningFilter(taps, 1.0, ends, first)
    assert_allclose(as_matrix(L.apply, N, 2), dense, rtol=0, atol=1e-12)


@given(st.integers(0, 10**6), st.sampled_from([0.3, 0.03]), st.booleans())
def test_proven_peaks_are_those_of_a_dense_grid(seed, b, finite):
    random = np.random.default_rng(seed)
    poles = random.uniform(0.2, 0.98, 2)
    A = np.diag(poles) + 0.1 * np.triu(random.standard_normal((2, 2)), 1)
    P = control.ss(A, random.standard_normal((2, 1)), random.standard_normal((1, 2)), 0, 1.0)
    base = RegularisedInverse(P, b * abs(P(1)) + 1e-3, [1.0])
    if finite:
        base = LearningFilter(random.standard_normal((1, 1, 41)) / 9, 1.0, first=-20)
    L = base @ LearningFilter(random.standard_normal((1, 1, 5)) / 2, 1.0, first=-2)
    low = zero_phase_butterworth(2, 0.5, 1.0)
    omega = np.linspace(0, np.pi, 4001)
    M, gain = sigma_of_M(omega, P, low, L), np.abs(L.frequency_response(omega))
    for (peak, _), seen in ((peak_of_M(P, L, low), M), (peak_of_L(L), gain)):
        assert seen.max() * (1 - 1e-12) <= peak <= seen.max() * (1 + 1e-4)


def test_without_reset_it_is_refused_for_the_operator_and_learns_as_a_finite_filter(
    with_base, finite
):
    reference = np.sin(2 * np.pi * np.arange(600) / 600) ** 3
    with pytest.raises(ValueError, match="reach"):
        errors_of(with_base.filter, reference, 12, reset=False)
    errors = errors_of(finite.filter, reference, 12, reset=False)
    omega = np.fft.rfftfreq(600, 1e-3 / (2 * np.pi))
    P, L = (f(omega)[:, 0, 0] for f in (LOOP.frequency_response, finite.filter.frequency_response))
    low = Q.frequency_response(omega)
    left = (1 - low) * (1 - P) / (1 - low * (1 - P * L))  # of the periodic motion
    limit = np.fft.irfft(left * np.fft.rfft(reference), 600)
    assert errors[-1] == pytest.approx(np.sqrt(np.mean(limit**2)), rel=1e-2)


@pytest.mark.parametrize("share", [1.0, 0.0, "none", True])
def test_a_base_that_is_no_share_is_refused(share):
    with pytest.raises(ValueError, match="base = "):
        synthesise(STAGE, Q, base=share)


def test_K_does_not_leave_the_error_to_the_end_of_a_trial(with_base, finite):
    """Beyond it there is none: K of a base that knows the end takes the last to stand still."""
    reference = np.sin(np.pi * np.arange(300) / 400) ** 4  # it is cut off while it moves
    L = with_base.filter
    assert (L.K.ends, finite.filter.ends) == ("hold-last", "zero")
    zero = replace(L, K=replace(L.K, ends="zero"))
    assert errors_of(L, reference, 4)[-1] < 0.9 * errors_of(zero, reference, 4)[-1]


RANDOM = np.random.default_rng(0)
TAPS = LearningFilter(RANDOM.standard_normal((2, 2, 3)), 1.0)
INVERSE = RegularisedInverse(lags(), 0.3, [1.0, 1.0])


@pytest.mark.parametrize("L", [TAPS, INVERSE, INVERSE @ TAPS, TAPS @ INVERSE])
def test_L_in_other_units_and_for_more_channels(L):
    omega, of_v, of_y = [0.1, 1.0], np.array([2.0, 5.0]), np.array([3.0, 0.5])
    inside, scaled = (each.frequency_response(omega) for each in (L, in_units(L, of_v, of_y)))
    assert_allclose(scaled, of_v[:, None] * inside / of_y, rtol=1e-12)
    U, V = np.linalg.qr(RANDOM.standard_normal((2, 3, 2)))[0]
    assert_allclose(extended(L, U, V).frequency_response(omega), V @ inside @ U.T, atol=1e-12)


def test_the_unit_of_y_decides_nothing():
    """Behind a delay of thirty samples, whose B has poles that rounding may hide."""
    ours, theirs = (synthesise(gain * furnace(30)).certificate for gain in (1.0, 1e-8))
    assert theirs.rate == pytest.approx(ours.rate, rel=1e-6)
    assert theirs.settled_trial.norm == pytest.approx(ours.settled_trial.norm, rel=1e-6)


def test_where_P_passes_nothing_the_rest_is_learned_and_print_says_where():
    """Behind an AC amplifier: M is one at rest for any L, and below one elsewhere."""
    P = control.ss(STAGE * control.ss(control.tf([1, -1], [1, -0.995], 1e-3)))
    low = zero_phase_butterworth(2, 60.0, 1e-3)
    omega = np.linspace(0, np.pi / 1e-3, 800)
    design = synthesise(P, low)
    assert "P passes nothing at 0 rad/s" in repr(design) and design.certificate.failures == []
    above = np.linspace(design.omega[0], np.pi / 1e-3, 20_000)
    assert convergence(P, low, design.filter, above).rate < 0.5
    with pytest.raises(ValueError, match=r"P is singular at omega = 0 .* leave such"):
        synthesise(frequency_response(P, omega), low, omega)


def test_a_gain_without_states_is_learned():
    P = np.array([[2.0, 0.5], [0.0, 1.0]])
    design = synthesise(control.ss([], [], [], P, 0.1))
    b = 1 / (2 * design.problem.L_max)
    B = np.linalg.solve(P.T @ P + b**2 * np.eye(2), P.T)  # of norm-optimal learning
    assert np.allclose(design.filter.frequency_response([0.1, 5.0]), B, rtol=1e-9, atol=0)
