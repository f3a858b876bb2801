"""What samples show to be likely mistakes, and that right ones of any plant show none."""

import control
import numpy as np
import pytest
from plants import furnace, stage, tanks

from rodlib import current_trial_loop, paper_loop, zero_phase_butterworth
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.plausible import doubts_about_P, doubts_about_Q

ANGLES = {
    "all": np.geomspace(1e-4, np.pi, 200),
    "from zero": np.linspace(0, np.pi, 300),
    "low": np.geomspace(1e-4, 0.3, 100),
    "middle": np.geomspace(0.05, 1, 60),
    "few": np.geomspace(1e-3, np.pi, 30),
    "up to 0.5": np.linspace(0, 0.5, 100),
}


def closed_loops():
    pumps = ["pump A", "pump B", "pump C"]
    sizes = {"x": 1.0, "F": 10.0}
    loops = paper_loop(), current_trial_loop(stage(), ["F"], sizes=sizes)
    return [loop.P for loop in (*loops, current_trial_loop(tanks(), pumps))]


def random_plants(count=100):
    """Stable ones, of any number of states and with zeros anywhere."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        m = rng.integers(1, 4)
        n = rng.integers(m, 7)
        A = rng.standard_normal((n, n))
        A *= rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(A)).max()
        B, C = rng.standard_normal((n, m)), rng.standard_normal((m, n))
        yield control.ss(A, B, C, 0, 1.0)


def flexible_plants():
    """Lags with an antiresonance, whose phase rises by pi, before or behind a resonance."""
    for low, high in ((0.1, 0.2), (0.2, 0.1), (0.05, 0.5)):
        for damping in (0.002, 0.02, 0.2):
            pair = [[1 / a**2, 2 * damping / a, 1] for a in (low, high)]
            G = control.tf(*pair) * control.tf(1, [20, 1])
            yield control.ss(control.sample_system(G, 1.0, method="zoh"))


@pytest.mark.parametrize("angles", ANGLES.values(), ids=ANGLES)
def test_of_a_causal_plant_there_is_no_doubt(angles):
    plants = [
        *closed_loops(),
        *random_plants(),
        *flexible_plants(),
        control.ss(furnace()),
    ]
    for P in plants:
        omega = angles / P.dt
        assert not [*doubts_about_P("P", frequency_response(P, omega), omega, P.dt)]


@pytest.mark.parametrize(
    "grid", ["all", "few"]
)  # on which the phase turns by less than pi / 2
def test_a_conjugated_or_real_response_of_a_loop_is_told(grid):
    for P in closed_loops():
        omega = ANGLES[grid] / P.dt
        response = frequency_response(P, omega)
        for wrong, words in (
            (response.conj(), "likely it is conjugated"),
            (np.abs(response), "likely its magnitude"),
            (response.real, "likely its magnitude"),
        ):
            (doubt,) = doubts_about_P("P", wrong + 0j, omega, P.dt)
            assert words in doubt


def test_noise_hides_no_conjugate_and_makes_none():
    P, omega = closed_loops()[0], ANGLES["all"]
    response, rng = frequency_response(P, omega), np.random.default_rng(0)
    noise = 0.01 * (rng.standard_normal((2, *response.shape)).T @ [1, 1j]).T
    assert not [*doubts_about_P("P", response + noise, omega, 1.0)]
    assert [*doubts_about_P("P", (response + noise).conj(), omega, 1.0)]


def test_a_constant_response_may_be_real():
    omega = ANGLES["all"]
    assert not [*doubts_about_P("P", np.full((200, 1, 1), 0.5 + 0j), omega, 1.0)]


def test_of_frequencies_in_hertz_the_last_tells():
    (P, *_), angles = closed_loops(), np.linspace(0, np.pi, 101)
    response = frequency_response(P, angles)
    (doubt,) = doubts_about_P("P", response, angles / (2 * np.pi), 1.0)
    assert "likely omega is in Hz" in doubt
    assert not [*doubts_about_P("P", response, angles, 1.0)]


def test_a_zero_phase_filter_whose_cut_off_is_in_the_band_is_none():
    omega, Q = ANGLES["all"], zero_phase_butterworth()
    band = (omega >= 0.001) & (omega <= 0.1)
    assert not [*doubts_about_Q(Q.frequency_response(omega), omega, band, 1.0)]
    low = zero_phase_butterworth(2, 0.001).frequency_response(omega)
    assert not [*doubts_about_Q(low, omega, None, 1.0)]
    (doubt,) = doubts_about_Q(low, omega, (omega >= 0.003) & (omega <= 0.1), 1.0)
    assert "the cut-off, in rad/s, is too low" in doubt
