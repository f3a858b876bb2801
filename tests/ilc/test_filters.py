import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, filtfilt

from rodlib import LearningFilter, zero_phase_butterworth


def as_matrix(apply, samples, channels=1):
    """Matrix of a linear map of signals, column by column."""
    units = np.eye(samples * channels).reshape(-1, samples, channels)
    return apply(units).reshape(-1, samples * channels).T


@given(st.integers(1, 6), st.floats(0.01, 1.5), st.floats(0.1, 2.0))
def test_q_is_the_squared_magnitude_of_the_analytic_butterworth(order, cutoff, Ts):
    omega = np.linspace(0, np.pi / Ts * 0.99, 50)
    warped = np.tan(omega * Ts / 2) / np.tan(cutoff * Ts / 2)
    Q = zero_phase_butterworth(order, cutoff, Ts)
    expected = 1 / (1 + warped ** (2 * order))
    np.testing.assert_allclose(Q.frequency_response(omega), expected, atol=1e-9)
    assert Q.frequency_response([cutoff])[0] == pytest.approx(0.5)


def test_q_agrees_with_filtfilt_away_from_the_ends(Q):
    signal = np.random.default_rng(0).standard_normal((1500, 2))
    signal[:500] = signal[-500:] = 0
    expected = filtfilt(*butter(2, 0.1 / np.pi), signal, axis=0, padlen=0)
    np.testing.assert_allclose(Q.apply(signal), expected, atol=1e-12)


def test_q_on_a_trial_is_the_toeplitz_matrix_of_its_frequency_response(Q):
    matrix = as_matrix(Q.apply, 300)
    grid = 2 * np.pi * np.arange(4096) / 4096
    grid[grid > np.pi] -= 2 * np.pi
    impulse = np.fft.ifft(Q.frequency_response(np.abs(grid))).real
    lags = np.abs(np.subtract.outer(np.arange(300), np.arange(300)))
    np.testing.assert_allclose(matrix, impulse[lags], atol=1e-12)
    assert np.linalg.norm(matrix, 2) <= 1


def test_q_that_holds_the_ends_passes_a_constant():
    constant = np.full((40, 2), 3.0)
    held = zero_phase_butterworth(ends="hold").apply(constant)
    np.testing.assert_allclose(held, constant, rtol=1e-12)
    assert zero_phase_butterworth().apply(constant)[-1, 0] < 2


def test_q_that_holds_the_last_sample_takes_what_was_before_the_trial_as_zero():
    rng = np.random.default_rng(5)
    signal = rng.standard_normal((200, 2))
    held = zero_phase_butterworth(ends="hold-last").apply(signal)
    begun = np.vstack([np.zeros((700, 2)), signal])
    expected = zero_phase_butterworth(ends="hold").apply(begun)[700:]
    np.testing.assert_allclose(held, expected, rtol=0, atol=1e-12)
    assert abs(held - zero_phase_butterworth(ends="hold").apply(signal))[0].max() > 0.01


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
def test_filters_act_on_every_trial_of_a_stack_alike(ends):
    rng = np.random.default_rng(1)
    trials = rng.standard_normal((3, 80, 2))
    for filter_ in (
        zero_phase_butterworth(ends=ends),
        LearningFilter(rng.standard_normal((2, 2, 4)), 1.0, ends),
    ):
        np.testing.assert_allclose(
            filter_.apply(trials)[1], filter_.apply(trials[1]), atol=1e-13
        )


@given(st.integers(1, 4), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_learning_filter_looks_ahead(m, order, seed):
    rng = np.random.default_rng(seed)
    coefficients, e = rng.standard_normal((m, m, order)), rng.standard_normal((20, m))
    L = LearningFilter(coefficients, 1.0)
    ahead = np.vstack([e, np.zeros((order, m))])
    expected = [
        sum(coefficients[:, :, k - 1] @ ahead[p + k] for k in range(1, order + 1))
        for p in range(20)
    ]
    np.testing.assert_allclose(L.apply(e), expected, atol=1e-12)


def test_learning_filter_in_time_and_in_frequency():
    rng = np.random.default_rng(3)
    L = LearningFilter(rng.standard_normal((2, 2, 10)), 0.5)
    impulse = np.zeros((60, 2))
    impulse[30, 1] = 1
    omega = np.linspace(0, np.pi / 0.5, 7)
    transform = np.exp(-0.5j * np.outer(omega, np.arange(60) - 30)) @ L.apply(impulse)
    np.testing.assert_allclose(
        transform, L.frequency_response(omega)[:, :, 1], atol=1e-12
    )


def test_held_end_lets_a_constant_error_be_seen_whole():
    L = LearningFilter(np.ones((1, 1, 5)), 1.0, ends="hold")
    np.testing.assert_allclose(L.apply(np.ones((8, 1))), 5.0)
    assert LearningFilter(np.ones((1, 1, 5)), 1.0).apply(np.ones((8, 1)))[-1, 0] == 0


def test_a_filter_that_rounding_would_change_is_refused():
    for order, cutoff in ((100, 1e-3), (2, 1e-12), (1, 1e-12), (8, 1e-6)):
        with pytest.raises(
            ValueError, match=f"cutoff = {cutoff} rad/s is too low for order"
        ):
            zero_phase_butterworth(order, cutoff)
    assert zero_phase_butterworth(2, 1e-3).frequency_response(0.0) == pytest.approx(1)
    assert zero_phase_butterworth(100, 1.0).frequency_response(1.0) == pytest.approx(
        0.5
    )


def test_numbers_may_come_from_numpy():
    Q = zero_phase_butterworth(np.int64(2), np.float64(0.1), np.int32(1))
    assert zero_phase_butterworth() == Q and isinstance(Q.Ts, float)
    assert isinstance(LearningFilter(np.ones((1, 1, 1)), np.int64(2)).Ts, float)


def test_coefficients_cannot_be_changed_behind_the_filter():
    given_ = np.ones((1, 1, 2))
    L = LearningFilter(given_, 1.0)
    given_[:] = 5
    assert L.coefficients.max() == 1
    with pytest.raises(ValueError, match="read-only"):
        L.coefficients[0, 0, 0] = 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"order": 101}, "order = 101 must be a whole number, from 1 to 100"),
        ({"cutoff": 4.0}, r"cutoff = 4.0 must be in \(0, 3.14159\)"),
        ({"cutoff": 1.6, "Ts": 2.0}, r"cutoff = 1.6 must be in \(0, 1.5708\)"),
    ],
)
def test_bad_q_filters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        zero_phase_butterworth(**arguments)


@pytest.mark.parametrize("shape", [(2, 3, 4), (2, 2, 0)])
def test_bad_learning_filters_are_refused(shape):
    with pytest.raises(ValueError, match=re.escape(f"shape {shape}")):
        LearningFilter(np.ones(shape), 1.0)


def test_bad_signals_are_refused(Q):
    L = LearningFilter(np.ones((2, 2, 3)), 1.0)
    with pytest.raises(
        ValueError, match=r"signal has shape \(5, 3\).* \(..., time, 2\)"
    ):
        L.apply(np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"shape \(5,\)"):
        Q.apply(np.zeros(5))
