import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rods import modal_model

from ilctools import current_trial_loop, minimal_realisation
from ilctools.loop.closed import controller
from rodlib import Rod, Specimen, Spread, draw, midr, paper_loop, responses, sampled_response


def pole_moduli(loop, model):
    """Moduli of the poles of the loop around a model, stable or not."""
    A, B, K = controller(loop)
    plant = model[:, loop.controls]
    closed = np.block([[plant.A, -plant.B @ K], [loop.KL @ plant.C, A - B @ K]])  # (19)
    return np.abs(np.linalg.eigvals(closed))


def test_deviations_name_the_parameters_in_order():
    spread = Spread(0.1, 0.2, 0.3, 0.4, gains=0.5, sensors=0.01)
    heavy = spread.specimen([1, -1, 0.5, 0, 0, 1, 0, 0, -1, 1])
    rod = Rod()
    assert heavy.rod.density == pytest.approx(1.1 * rod.density)
    assert heavy.rod.heat_capacity == pytest.approx(0.8 * rod.heat_capacity)
    assert heavy.rod.heat_transfer == pytest.approx(1.15 * rod.heat_transfer)
    assert heavy.rod.conductivity == rod.conductivity
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


def test_a_model_is_stable_in_the_loop_where_that_of_hundreds_of_modes_is(loop):
    """Among rods so far off, and with elements so strong, that many a loop is unstable."""
    pairs = [(3, 3), (30, 1), (30, 30), (-1, 1), (-1, -1)]
    specimens = [draw(Spread.of_all(0.9), number) for number in range(3)]
    specimens += [Specimen(Rod(), (first, 1.0, third, 1.0)) for first, third in pairs]
    outcomes = set()
    for specimen in specimens:
        radius = pole_moduli(loop, modal_model(specimen, 1.0, 200)).max()
        outcomes.add(radius < 1)
        if radius < 1:
            poles = loop.around(specimen.model(1.0)).poles()
            assert np.abs(poles).max() == pytest.approx(radius, abs=1e-6)
        else:
            with pytest.raises(ValueError, match="unstable"):
                loop.around(specimen.model(1.0))
    assert outcomes == {True, False}
