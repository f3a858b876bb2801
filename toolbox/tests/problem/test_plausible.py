"""Tables in Hz, with another sign, or of the sensitivity or the inverse: no others are doubted."""

import warnings

import control
import numpy as np
import pytest
from plants import LOOPS, STAGE_WITH_MODES, axes, complex_normal, furnace, lag, lags, random_stable

from ilctools import frequency_response, measured_response, synthesise, zero_phase_butterworth
from ilctools.problem.plausible import at_rest_in_words, doubts
from ilctools.response.door import response_of
from ilctools.response.measured import Measured

PLANTS = {name: make().P for name, make in LOOPS.items()}
PLANTS |= {"modes": STAGE_WITH_MODES, "lag": lag(), "lags": lags(), "axes": axes()}
PLANTS |= {"pipe": control.ss(furnace())} | {f"random {k}": random_stable(k) for k in range(1, 6)}
TRACKING = ["stage", "tanks", "furnace", "lag", "modes"]  # one at rest
TS = 0.01
MODEL = control.sample_system(control.ss(control.tf([400], [1, 20, 400])), TS)
Q = zero_phase_butterworth(2, 40.0, TS)


def table(name, end, grid=np.linspace, noise=0.0):
    """Frequencies up to a share of the Nyquist frequency, rad/s, and a plant there."""
    model, rng = PLANTS[name], np.random.default_rng(0)
    nyquist = np.pi / model.dt
    first = 300 if grid is np.linspace else 3000
    omega = grid(end * nyquist / first, end * nyquist, 200)
    P = frequency_response(model, omega)
    return P * (1 + noise * complex_normal(rng, *P.shape)), omega, model.dt


def codes(P, omega, Ts):
    return [found.code for found in doubts(response_of(P, omega, Ts))]


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("name", PLANTS)
def test_a_table_in_rad_per_s_is_not_doubted(name, noise):
    for end in (1.0, 0.9, 0.5, 0.3, 0.2, 0.12, 0.05, 0.02):
        for grid in (np.linspace, np.geomspace):
            assert codes(*table(name, end, grid, noise)) == []


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("end", [0.995, 0.95, 0.9])
def test_a_table_in_hertz_that_ends_near_its_nyquist_frequency_is_doubted(name, end):
    P, omega, Ts = table(name, end, noise=0.01)
    assert "hertz" in codes(P, omega / (2 * np.pi), Ts)
    data = control.frd(np.moveaxis(P, 0, -1), omega / (2 * np.pi), Ts)
    tabulated = response_of(measured_response(data), omega / (2 * np.pi), Ts)
    assert "hertz" in [found.code for found in doubts(tabulated)]


def test_a_table_that_turns_where_one_in_hertz_is_real_is_not_doubted():
    """It ends at 1 / (2 Ts), which is the Nyquist frequency in Hz, where P is real."""
    P, omega, Ts = table("pipe", 1 / np.pi)  # 0.5 rad/s at Ts = 1 s, behind a delay of 31 samples
    assert abs(omega[-1] * Ts - 1) < 1e-12
    omega, P = omega / 2, frequency_response(PLANTS["pipe"], omega / 2)
    assert abs(P[-1].imag) > 0.3 * abs(P[-1]) > 0.3 * 0.05 * abs(P).max()
    assert codes(P, omega, Ts) == []
    # one in Hz whose last line is noisy is doubted, though P is not real enough to be refused
    P, omega, Ts = table("lag", 1.0, noise=0.01)
    assert codes(P, omega / (2 * np.pi), Ts) == ["hertz"]


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("name", TRACKING)
def test_a_sign_the_sensitivity_and_the_inverse_of_a_loop_are_doubted(name, noise):
    P, omega, Ts = table(name, 0.9, np.geomspace, noise)
    assert codes(-P, omega, Ts) == ["sign"]
    assert codes(np.eye(P.shape[1]) - P, omega, Ts) == ["sensitivity"]
    assert codes(np.linalg.inv(P), omega, Ts) == ["inverse"]


def test_one_reversed_channel_of_several_is_named():
    P, omega, Ts = table("tanks", 0.9, np.geomspace)
    [found] = doubts(response_of(P * [1, -1, 1], omega, Ts))
    assert "from each of the inputs [2] to its output at" in str(found)


def test_a_design_warns_and_says_what_to_do():
    omega = np.linspace(1.0, 0.9 * np.pi / TS, 200)
    P = frequency_response(MODEL, omega)
    words = r"omega ends at 45, just below 1 / \(2 Ts\) = 50, .* pass 2 pi omega"
    with pytest.warns(UserWarning, match=words):
        design = synthesise(P, zero_phase_butterworth(2, 20.0, TS), omega / (2 * np.pi))
    assert "WARNING: omega ends at 45" in str(design)
    with pytest.warns(UserWarning, match="is the sign of P reversed"):
        synthesise(-P, Q, omega)
    with warnings.catch_warnings(action="error"):
        synthesise(P, Q, omega)


@pytest.mark.parametrize(
    "P, words",
    [
        (MODEL, "P is 1 at rest, "),
        (-0.5 * MODEL, "P is -0.5 at rest, "),
        (LOOPS["tanks"]().P, "P is diag(1, 1, 1) at rest, "),
        # C (I - A)^-1 B by hand: (I - A)^-1 = [[5, 5 / 3], [0, 10 / 3]]
        (axes(), "P is diag(2.5, 3.15), up to 2.1 between channels at rest, "),
    ],
)
def test_the_gain_at_rest_is_in_print(P, words):
    Q = zero_phase_butterworth(2, 0.4 / P.dt, P.dt)
    assert words in f"{synthesise(P, Q, order=3, M_max=0.999)}"


def test_rounding_at_rest_is_zero():
    P = control.ss(0.9, 0.1, [[1.0]], [[-1.0]], TS)  # 0.1 / (1 - 0.9) - 1
    assert frequency_response(P, [0.0]) != 0
    assert at_rest_in_words(response_of(P, np.linspace(1.0, 300.0, 50))) == "P is 0 at rest"


def test_of_a_table_it_is_the_gain_at_its_first_frequency():
    omega = np.linspace(0.5, np.pi / TS, 400)
    P = frequency_response(MODEL, omega)
    # 400 / (400 - w^2 + 20 j w) with the hold, at 0.5 rad/s: 0.9997 at -1.6 degrees
    assert "P is 1 at 0.5 rad/s, " in f"{synthesise(P, Q, omega)}"
    assert "P is -1 at 0.5 rad/s" in at_rest_in_words(response_of(-P, omega, TS))
    late = np.linspace(20.0, np.pi / TS, 400)  # its natural frequency, with a damping of a half
    P = frequency_response(MODEL, late)
    words = (
        f"P is {abs(P[0, 0, 0]):.3g} at {np.degrees(np.angle(P[0, 0, 0])):.0f} degrees at 20 rad/s"
    )
    assert at_rest_in_words(response_of(P, late, TS)) == words


class InOurLoop(Measured):
    """A response that was measured in a loop that integrates, exact."""

    def __init__(self, loop, P, omega):
        self.loop, self.omega, self.response = loop, omega, P

    def _on(self, omega, confidence):
        return self.response, np.zeros(len(omega))

    def _basis(self, omega, confidence):
        return ()


@pytest.mark.parametrize("lowest", [1e-3, 0.3])
def test_a_loop_that_integrates_is_one_at_rest(lowest):
    loop = LOOPS["tanks"]()
    omega = np.geomspace(lowest, np.pi / loop.Ts, 100)
    P = loop.frequency_response(omega)
    assert doubts(response_of(InOurLoop(loop, P, omega), omega)) == []
    found = doubts(response_of(InOurLoop(loop, 0.1 * P, omega), omega))
    # where the loop itself is far from one, nothing is said
    assert [each.code for each in found] == (["rest"] if lowest == 1e-3 else [])
