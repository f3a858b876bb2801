import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import as_matrix

from ilctools import LearningFilter, zero_phase_butterworth


@given(st.integers(1, 6), st.floats(0.01, 1.5), st.floats(0.1, 2.0))
def test_q_is_the_squared_magnitude_of_the_analytic_butterworth(order, cutoff, Ts):
    omega = np.linspace(0, np.pi / Ts * 0.99, 50)
    warped = np.tan(omega * Ts / 2) / np.tan(cutoff * Ts / 2)
    Q = zero_phase_butterworth(order, cutoff, Ts)
    expected = 1 / (1 + warped ** (2 * order))
    assert_allclose(Q.frequency_response(omega), expected, atol=1e-9)
    assert Q.frequency_response([cutoff])[0] == pytest.approx(0.5)


def test_q_on_a_trial_is_the_toeplitz_matrix_of_its_frequency_response(Q):
    matrix = as_matrix(Q.apply, 300, 1)
    grid = 2 * np.pi * np.arange(4096) / 4096
    grid[grid > np.pi] -= 2 * np.pi
    impulse = np.fft.ifft(Q.frequency_response(np.abs(grid))).real
    lags = np.abs(np.subtract.outer(np.arange(300), np.arange(300)))
    assert_allclose(matrix, impulse[lags], atol=1e-12)
    assert np.linalg.norm(matrix, 2) <= 1


def test_q_that_holds_the_ends_passes_a_constant():
    constant = np.full((40, 2), 3.0)
    Q = zero_phase_butterworth(2, 0.1, 1.0, ends="hold")
    assert_allclose(Q.apply(constant), constant, rtol=1e-12)


def test_q_that_holds_the_last_sample_takes_what_was_before_the_trial_as_zero():
    signal = np.random.default_rng(5).standard_normal((200, 2))
    held = zero_phase_butterworth(2, 0.1, 1.0, ends="hold-last").apply(signal)
    begun = np.vstack([np.zeros((700, 2)), signal])
    hold = zero_phase_butterworth(2, 0.1, 1.0, ends="hold")
    expected = hold.apply(begun)[700:]
    assert_allclose(held, expected, rtol=0, atol=1e-12)


def test_q_at_z_is_the_same_inside_and_outside_the_circle(Q):
    z = np.full((2, 1), 0.9j)
    assert_allclose(Q(z), Q(1 / z), rtol=1e-9)


def test_coefficients_cannot_be_changed_behind_the_filter():
    given_ = np.ones((1, 1, 2))
    L = LearningFilter(given_, 1.0)
    given_[:] = 5
    assert L.coefficients.max() == 1
    with pytest.raises(ValueError, match="read-only"):
        L.coefficients[0, 0, 0] = 2


def test_filters_at_the_limits_of_rounding():
    assert zero_phase_butterworth(2, 1e-3, 1.0).frequency_response(0.0) == pytest.approx(1)
    steep = zero_phase_butterworth(20, np.float64(1.0), np.int32(1))
    assert steep.frequency_response(1.0) == pytest.approx(0.5)
    assert isinstance(steep.Ts, float)
    assert zero_phase_butterworth(1, 1e-5, 1.0).decay < 1e7


@pytest.mark.parametrize(
    ("order", "cutoff", "Ts", "words"),
    [
        (20, 3e-5, 1.0, "too low"),
        (1, 1e-12, 1.0, "too low"),
        (20, 3.14155, 1.0, "too high"),
        (1, 1e-7, 1.0, "too low for order = 1 .* more than 1e7 samples"),
        (1, 0.1, 1e-99, "too low for order = 1 .* more than 1e7 samples"),
    ],
)
def test_a_filter_that_rounding_would_change_or_that_does_not_end_is_refused(
    order, cutoff, Ts, words
):
    """Of order 1 its coefficients are exact; a signal of ten samples took 10 GB."""
    with pytest.raises(ValueError, match=f"^cutoff = {cutoff} rad/s is {words}"):
        zero_phase_butterworth(order, cutoff, Ts)
