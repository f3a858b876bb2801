import numpy as np
import pytest

from rodlib import Rod, assumed_disturbance, assumed_reference, paper_loop


def test_paper_loop_takes_another_rod_degree_and_period():
    loop = paper_loop(Rod(conductivity=100.0), degree=2, Ts=2.0)
    assert (loop.Ts, loop.plant.nstates, loop.closed.nstates) == (2.0, 7, 16)
    assert loop.plant.input_labels == ["Q1", "Q3", "theta_a", "Q2", "Q4"]
    assert paper_loop(Ts=np.int64(2)).Ts == 2
    assert [paper_loop(Ts=Ts).Ts for Ts in (1.05e-5, 9.9e3)] == [1.05e-5, 9.9e3]


def test_a_steeper_reference_has_the_same_plateaus_and_a_steeper_slope():
    """A quintic step of height h and duration T has a largest slope of 1.875 h / T, in its middle.

    Output 1 is steepest where it rises by 10 K in 600 s, output 2 where it falls by 10 K in 650 s.
    The difference of neighbours misses the slope by some 1 / T^2, relative: less than 1e-4.
    """
    for steepness in (0.7, 1.0, 1.5, 2.0):
        y = assumed_reference(steepness=steepness)
        largest = np.abs(np.diff(y, axis=0)).max(axis=0)
        np.testing.assert_allclose(
            largest, 1.875 * steepness * 10 / np.array([600, 650]), rtol=1e-4
        )
        np.testing.assert_allclose(y[[0, -1]], 0, atol=1e-3)
        plateaus = y[870, 0], y[1570, 0], y[1560, 1]  # between two moves, at 0.7 as well
        np.testing.assert_allclose(plateaus, [10, 6, 10], atol=0.05)


def test_a_reference_moves_between_the_plateaus_that_are_given():
    y = assumed_reference(plateaus=[(3, -2), (1, 7)])
    np.testing.assert_array_equal(y[[850, 1550], 0], [3, -2])
    np.testing.assert_array_equal(y[[1050, 1600], 1], [1, 7])
    ours = assumed_reference()
    doubled = assumed_reference(plateaus=[(20, 12), (16, 20)])
    np.testing.assert_array_equal(doubled, 2 * ours)


def test_a_pulse_has_the_energy_and_the_length_that_are_given():
    """The mean of sin^4 over a pulse is 3/8; the sum over equidistant samples has it exactly."""
    for duration in (0.2, 0.5, 0.7):
        d = assumed_disturbance(2500, 3, 2, flows=(2.0, -6.0), duration=duration)
        assert not d[0].any() and not d[..., 0].any()
        np.testing.assert_array_equal(d[1], d[2])
        energy = 3 / 8 * duration * np.array([4, 36])
        np.testing.assert_allclose((d[1, :, 1:] ** 2).mean(axis=0), energy, rtol=1e-12)
        assert d[1].max() == pytest.approx(2, rel=1e-5) and d[1].min() == pytest.approx(
            -6, rel=1e-5
        )


@pytest.mark.parametrize(
    ("function", "argument", "said"),
    [
        (
            assumed_reference,
            {"steepness": 0.6},
            "steepness = 0.6 must be 0.7 or more, since slower",
        ),
        (assumed_reference, {"plateaus": [(1, 2, 3)]}, "plateaus has shape"),
        (assumed_disturbance, {"duration": 0.8}, "duration = 0.8 must be above 0 and at most 0.7"),
        (assumed_disturbance, {"flows": (1.0,)}, "flows has shape"),
    ],
)
def test_signals_that_do_not_fit_into_a_trial_are_refused(function, argument, said):
    with pytest.raises(ValueError, match=said):
        function(**argument)
