import numpy as np
import pytest

from rodlib import Rod, assumed_disturbance, assumed_reference, paper_loop


def test_paper_loop_takes_another_rod_degree_and_period():
    loop = paper_loop(Rod(conductivity=100.0), degree=2, Ts=2.0)
    assert (loop.Ts, loop.plant.nstates, loop.closed.nstates) == (2.0, 7, 16)
    assert loop.plant.input_labels == ["Q1", "Q3", "theta_a", "Q2", "Q4"]


@pytest.mark.parametrize("steepness", [0.7, 2.0])
def test_a_reference_has_the_plateaus_and_the_slopes_that_are_given(steepness):
    """A quintic step of height h and duration T has a largest slope of 1.875 h / T, in its middle.

    Output 1 is steepest where it rises by 3 K in 600 s, output 2 where it falls by 7 K in 650 s.
    The difference of neighbours misses the slope by some 1 / T^2, relative: less than 1e-4.
    """
    y = assumed_reference(steepness=steepness, plateaus=[(3, 2), (6, 7)])
    largest = 1.875 * steepness * np.array([3 / 600, 7 / 650])
    np.testing.assert_allclose(np.abs(np.diff(y, axis=0)).max(axis=0), largest, rtol=1e-4)
    between = y[0, 0], y[870, 0], y[1550, 0], y[-1, 0], y[1050, 1], y[1600, 1]
    np.testing.assert_allclose(between, [0, 3, 2, 0, 6, 7], atol=0.05)


@pytest.mark.parametrize("duration", [0.2, 0.7])
def test_a_pulse_has_the_energy_and_the_length_that_are_given(duration):
    """The mean of sin^4 over a pulse is 3/8; the sum over equidistant samples has it exactly."""
    d = assumed_disturbance(2500, 3, 2, flows=(2.0, -6.0), duration=duration)
    assert not d[0].any() and not d[..., 0].any()
    np.testing.assert_array_equal(d[1], d[2])
    energy = 3 / 8 * duration * np.array([4, 36])
    np.testing.assert_allclose((d[1, :, 1:] ** 2).mean(axis=0), energy, rtol=1e-12)
    assert d[1].max() > 1.99 and d[1].min() < -5.99
