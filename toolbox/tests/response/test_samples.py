"""Below the first sample of a table: how far P moves to the real axis, held by models."""

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import LOOPS, furnace, lags

from ilctools import measured_response
from ilctools.models import frequency_response
from ilctools.response.door import response_of
from ilctools.response.samples import Samples

S = control.tf("s")


def sampled(G):
    return control.sample_system(control.ss(G), 0.01)


DRIVE = sampled(400 / (S**2 + 20 * S + 400))
UNEQUAL = sampled(control.ss(np.diag([-2, -3]), np.diag([2, 300]), np.eye(2), 0))  # 1 and 100
PLANTS = {  # with a frequency from which on they are tabulated, rad/s
    "coupled lags": (lags(), 0.01),
    "drive": (DRIVE, 4.0),
    "delay": (control.ss(furnace(12)), 0.005),
    "unstable zero": (sampled((1 - S / 8) * 25 / (S**2 + 5 * S + 25)), 0.5),
    "unequal gains": (UNEQUAL, 0.2),
    "stage under a controller": (LOOPS["stage"]().P, 5.0),
}


def table(P, first):
    """Samples of a model from this frequency to Nyquist's."""
    omega = np.geomspace(first, np.pi / P.dt, 300)
    return omega, frequency_response(P, omega)


@pytest.mark.parametrize("name", PLANTS)
def test_below_a_tenth_of_the_cutoff_plants_are_within_what_their_tables_say(name):
    P, first = PLANTS[name]
    omega, response = table(P, first)
    below = np.linspace(0, first, 101)[:-1]
    region = Samples(omega, response, np.zeros(300)).below(below)
    off = (frequency_response(P, below) - region.P) @ np.linalg.inv(region.W)
    assert np.linalg.norm(off, 2, axis=(1, 2)).max() <= region.moves * (1 + 1e-9)


def test_what_moves_is_that_of_a_lag_and_of_an_even_real_part():
    """1 / (1 + j x): t is x, and (Re P(0) - Re P(1)) / Re P(1) is x^2, whatever the frequency."""
    for x in (0.01, 0.1, 0.5):
        omega = x * 2.0 ** np.linspace(0, 7, 71)
        samples = Samples(omega, (1 / (1 + 1j * omega))[:, None, None], 0 * omega)
        s = abs((1 + x**2) / (1 + 4 * x**2) - 1)
        assert samples.moves == pytest.approx(min(s + x**2, x), rel=1e-9)
    omega = np.linspace(1, 3, 41)
    even = Samples(omega, (1 - 0.01 * omega**2 + 0.001j * omega)[:, None, None], 0 * omega)
    assert even.moves == pytest.approx(0.03 / 0.99 + (0.001 / 0.99) ** 2, rel=1e-9)


def test_from_45_degrees_on_P_is_not_known():
    """Of 1 / (1 + j x) from x = 1 on; and the region then holds all that is not larger."""
    omega = 0.99 * np.geomspace(1, 100, 4000)
    for factor, known in ((1.0, True), (1.02, False)):
        P = (1 / (1 + 1j * factor * omega))[:, None, None]
        samples = Samples(omega, P, 0 * omega)
        assert samples.known_below == known
        assert ("where P is not known" in str(samples.below_in_words)) != known
    region = samples.below(np.linspace(0, 0.9, 5))
    size = np.abs(P[0, 0, 0])
    for turned in size * np.exp(1j * np.linspace(0, 2 * np.pi, 24)):
        assert np.all(np.abs(region.P[:, 0, 0] - turned) <= region.widest)


def test_units_of_outputs_do_not_count():
    omega, response = table(*PLANTS["unequal gains"])
    own = Samples(omega, response, 0 * omega)
    scaled = Samples(omega, response / np.array([1.0, 100.0])[:, None], 0 * omega)
    assert own.moves == pytest.approx(scaled.moves, rel=1e-9) and own.moves < 0.05


def test_a_table_that_begins_at_rest_and_a_model_assume_nothing_below():
    omega = np.linspace(0, 314, 500)
    assert response_of(frequency_response(DRIVE, omega), omega, 0.01).below_in_words is None
    response = response_of(DRIVE, omega[10:], 0.01)
    assert response.below_in_words is None and not response.unsampled(0, omega).any()


def test_a_table_as_a_measured_response_says_the_same_below_its_lowest_line():
    omega, response = table(DRIVE, 4.0)
    measured = measured_response(control.frd(np.moveaxis(response, 0, -1), omega, 0.01))
    below = np.linspace(0.1, 3.9, 20)
    region = Samples(omega, response, 0 * omega).below(below)
    at, radius = measured.on(below)
    assert_allclose(at, region.P, rtol=1e-12)
    assert_allclose(radius, region.widest, rtol=1e-12)
    assert "below 4 rad/s, P is within" in "\n".join(measured.basis(below))


def test_a_table_too_coarse_to_show_the_real_part_counts_the_phase():
    """Five samples of a lag, from a phase of 0.2 rad on: no other one is within three times it."""
    omega = 0.2 * 4.0 ** np.arange(5)
    samples = Samples(omega, (1 / (1 + 1j * omega))[:, None, None], 0 * omega)
    assert samples.moves == pytest.approx(0.2, rel=1e-12)
