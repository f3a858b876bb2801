"""Below the first sample of a table: how far P moves to the real axis, held by models."""

import control
import numpy as np
import pytest
from plants import LOOPS, STAGE_WITH_MODES, furnace, lag, lags

from ilctools import measured_response
from ilctools.models import frequency_response
from ilctools.response.door import response_of
from ilctools.response.samples import Samples

S = control.tf("s")


def sampled(G, Ts=0.01):
    return control.sample_system(control.ss(G), Ts)


def loop(G, Ts=0.01):
    """Under unit feedback."""
    return sampled(control.feedback(control.ss(G), 1), Ts)


def resonance(w, damping):
    return w**2 / (S**2 + 2 * damping * w * S + w**2)


DELAY = control.tf(1, [1] + [0] * 40, 0.01)
UNEQUAL = control.ss(np.diag([-2, -3]), np.diag([2, 300]), np.eye(2), 0)
TWO = control.ss(
    [[-1, 0.3, 0], [0.2, -3, 1], [0, 0, -8]], [[1, 0], [0, 0], [0, 8]], np.eye(2, 3), 0
)
PLANTS = {  # with the cut-off of a Q, rad/s
    "lag": (lag(), 0.1),
    "two lags": (lags(), 0.1),
    "three lags": (sampled(1 / (S / 3 + 1) ** 3), 3.0),
    "drive": (sampled(400 / (S**2 + 20 * S + 400)), 40.0),
    "well damped": (sampled(resonance(10, 0.7)), 10.0),
    "hardly damped": (sampled(resonance(10, 0.02)), 20.0),
    "two resonances": (sampled(resonance(10, 0.4) * resonance(30, 0.03)), 20.0),
    "antiresonance": (sampled(resonance(40, 0.05) / resonance(30, 0.05) * 60 / (S + 60)), 40.0),
    "stage with modes": (STAGE_WITH_MODES, 100.0),
    "delay": (control.ss(control.tf(sampled(1 / (S / 5 + 1))) * DELAY), 4.0),
    "furnace": (control.ss(furnace(12)), 0.05),
    "unstable zero": (sampled((1 - S / 8) * resonance(5, 0.5)), 5.0),
    "integrator in a loop": (loop(5 / S), 5.0),
    "double integrator in a loop": (loop(9 * (S / 1.5 + 1) / S**2), 5.0),
    "PI and lag": (loop((S + 2) / S * 3 / (S + 1)), 4.0),
    "elastic shaft in a loop": (loop((S**2 + S + 900) / (S * (S**2 + S + 2000)) * 20), 15.0),
    "coupled": (sampled(TWO), 3.0),
    "gains of 1 and 100": (sampled(UNEQUAL), 2.0),
    "slow zero and pole": (sampled((S / 0.2 + 1) / (S / 0.25 + 1) / (S / 10 + 1)), 8.0),
    "stage under a controller": (LOOPS["stage"](), 50.0),
    "tanks": (LOOPS["tanks"](), 0.03),
}  # fmt: skip


def table(P, first):
    """Samples of a model from this frequency to Nyquist's."""
    omega = np.geomspace(first, np.pi / P.Ts if hasattr(P, "Ts") else np.pi / P.dt, 300)
    return omega, response_at(P, omega)


def response_at(P, omega):
    return P.frequency_response(omega) if hasattr(P, "Ts") else frequency_response(P, omega)


def within(P, first):
    """Whether a model is within what its table is taken to say below its first sample."""
    omega, below = table(P, first)[0], np.linspace(0, first, 101)[:-1]
    region = Samples(omega, response_at(P, omega), np.zeros(300)).below(below)
    off = (response_at(P, below) - region.P) @ np.linalg.inv(region.W)
    return np.linalg.norm(off, 2, axis=(1, 2)).max() <= region.moves * (1 + 1e-9)


@pytest.mark.parametrize(("share", "outside"), [(50, 1), (20, 2), (10, 2)])
def test_most_plants_are_within_what_their_tables_say_below(share, outside):
    missed = [name for name, (P, cutoff) in PLANTS.items() if not within(P, cutoff / share)]
    assert len(missed) <= outside, missed


def test_what_moves_is_that_of_a_lag_and_of_an_even_real_part():
    """1 / (1 + j x): t is x, and (Re P(0) - Re P(1)) / Re P(1) is x^2, whatever the frequency."""
    for x in (0.01, 0.1, 0.5):
        omega = x * 2.0 ** np.linspace(0, 7, 71)
        samples = Samples(omega, (1 / (1 + 1j * omega))[:, None, None], 0 * omega)
        s = abs((1 + x**2) / (1 + 4 * x**2) - 1)
        assert samples.moves == pytest.approx(min(s + x**2, x), rel=1e-9)
        assert samples.known_below
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
        assert ("where P is not known" in samples.below_in_words) != known
    region = samples.below(np.linspace(0, 0.9, 5))
    size = np.abs(P[0, 0, 0])
    for turned in size * np.exp(1j * np.linspace(0, 2 * np.pi, 24)):
        assert np.all(np.abs(region.P[:, 0, 0] - turned) <= region.widest)


def test_units_of_outputs_do_not_count():
    P, cutoff = PLANTS["gains of 1 and 100"]
    omega, response = table(P, cutoff / 20)
    own = Samples(omega, response, 0 * omega)
    scaled = Samples(omega, response / np.array([1.0, 100.0])[:, None], 0 * omega)
    assert own.moves == pytest.approx(scaled.moves, rel=1e-9) and own.moves < 0.05


def test_a_table_that_begins_at_rest_and_a_model_assume_nothing_below():
    P, _ = PLANTS["drive"]
    omega = np.linspace(0, 314, 500)
    assert response_of(frequency_response(P, omega), omega, 0.01).below_in_words is None
    response = response_of(P, omega[10:], 0.01)
    assert response.below_in_words is None and not response.unsampled(0, omega).any()


def test_a_table_as_a_measured_response_says_the_same_below_its_lowest_line():
    P, cutoff = PLANTS["drive"]
    omega, response = table(P, cutoff / 10)
    measured = measured_response(control.frd(np.moveaxis(response, 0, -1), omega, 0.01))
    below = np.linspace(0.1, 3.9, 20)
    region = Samples(omega, response, 0 * omega).below(below)
    at, radius = measured.on(below)
    np.testing.assert_allclose(at, region.P, rtol=1e-12)
    np.testing.assert_allclose(radius, region.widest, rtol=1e-12)
    assert np.all(np.abs(at - frequency_response(P, below))[:, 0, 0] <= radius)
    assert "below 4 rad/s P is within" in "\n".join(measured.basis(below))


def test_a_table_too_coarse_to_show_the_real_part_counts_the_phase():
    """Five samples of a lag, from a phase of 0.2 rad on: no other one is within three times it."""
    omega = 0.2 * 4.0 ** np.arange(5)
    samples = Samples(omega, (1 / (1 + 1j * omega))[:, None, None], 0 * omega)
    assert samples.moves == pytest.approx(0.2, rel=1e-12)
