import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ilctools import current_trial_loop, frequency_response, minimal_realisation
from rodlib import Rod, Spread, draw, midr, paper_loop, responses, sampled_response
from rodlib.specimens import MATERIAL


def test_deviations_name_the_parameters_in_order():
    spread = Spread(0.1, 0.2, 0.3, 0.4, gains=0.5, sensors=0.01)
    heavy, rod = spread.specimen([1, -1, 0.5, 0, 0, 1, 0, 0, -1, 1]), Rod()
    ratios = [getattr(heavy.rod, name) / getattr(rod, name) for name in MATERIAL]
    np.testing.assert_allclose(ratios, [1.1, 0.8, 1.15, 1], rtol=1e-14)
    assert heavy.gains == (1, 1.5, 1, 1)
    np.testing.assert_allclose(heavy.rod.sensors, [0.11, 0.29], rtol=1e-14)
    every = Spread.of_all(0.3)
    assert every.sensors == pytest.approx(0.012)  # of a section of 8 cm
    deviations = np.random.default_rng([7, 1]).uniform(-1, 1, 10)
    assert draw(every, 7, root=1) == every.specimen(deviations)


def two_sections():
    """A loop around a rod with two sections and one sensor, and that rod."""
    rod = Rod(sections=2, sensors=(0.1,))
    model = minimal_realisation(midr(rod), ["Q2"])
    return current_trial_loop(control.sample_system(model, 2.0, method="zoh"), ["Q2"]), rod


@pytest.mark.parametrize(("loop", "rod"), [(paper_loop(), Rod()), two_sections()])
@given(number=st.integers(0, 10**6))
def test_responses_are_those_of_the_loop_around_the_sampled_rod(loop, rod, number):
    omega = np.array([0.0, 1e-4, 0.02, 0.5, np.pi]) / loop.Ts
    specimen = draw(Spread.of_all(0.3, rod), number, nominal=rod)
    columns = [rod.inputs.index(name) for name in loop.controls]
    G = sampled_response(specimen.rod, omega, loop.Ts)[:, :, columns]
    expected = loop.frequency_response(omega, G * np.array(specimen.gains)[columns])
    found = responses(loop, [specimen], omega)[0]
    np.testing.assert_allclose(found, expected, atol=1e-11)


@given(number=st.integers(0, 10**6))
def test_a_model_is_the_sampled_rod_with_its_gains(number):
    specimen = draw(Spread.of_all(0.3), number)
    omega = np.array([1e-3, 0.02, 0.1])
    expected = sampled_response(specimen.rod, omega, 2.0) * [*specimen.gains, 1]
    found = frequency_response(specimen.model(2.0), omega)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_draws_do_not_depend_on_the_number_of_workers():
    """More specimens than a batch, here and in another process."""
    loop, omega, spread = paper_loop(), np.array([0.001, 0.02, 0.3]), Spread.of_all(0.2)
    specimens = [draw(spread, number) for number in range(130)]
    here = responses(loop, specimens, omega)
    apart = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(1, mp_context=apart) as pool:
        there = responses(loop, specimens, omega, executor=pool)
        drawn = [*pool.map(draw, [spread] * 130, range(130))]
    np.testing.assert_array_equal(there, here)
    assert drawn == specimens
    one_by_one = [responses(loop, [specimen], omega)[0] for specimen in specimens[95:105]]
    np.testing.assert_allclose(here[95:105], one_by_one, rtol=1e-12, atol=1e-14)  # rounding
