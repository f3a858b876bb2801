"""Tables in Hz or with another sign are doubted, and no others; print says P at rest."""

import control
import numpy as np
import pytest
from plants import LOOPS, STAGE_WITH_MODES, axes, complex_normal, furnace, random_stable

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.measurement.tabulated import TabulatedResponse
from ilctools.problem.plausible import at_rest_in_words, doubts
from ilctools.response.door import response_of

PLANTS = {name: make().P for name, make in LOOPS.items()}
PLANTS |= {"modes": STAGE_WITH_MODES, "pipe": control.ss(furnace()), "random": random_stable(3)}
HERTZ, GRID = 1 / (2 * np.pi), np.geomspace(1e-3, 1, 200)


def doubted(name, end, unit=1, sign=1):
    """What is doubted of a noisy table up to a share of the Nyquist frequency."""
    model, rng = PLANTS[name], np.random.default_rng(0)
    omega = GRID * end * np.pi / model.dt
    P = sign * frequency_response(model, omega)
    noisy = P * (1 + 0.01 * complex_normal(rng, *P.shape))
    return [found.code for found in doubts(response_of(noisy, omega * unit, model.dt))]


@pytest.mark.parametrize("name", PLANTS)
def test_tables_in_hertz_are_doubted_and_no_others(name):
    for end in (1.0, 0.5, 0.2, 0.05):
        assert doubted(name, end) == []
    for end in (1.0, 0.995, 0.9):
        assert doubted(name, end, HERTZ) == ["hertz"]


def test_a_table_that_turns_where_one_in_hertz_is_real_is_not_doubted():
    """It ends at 1 / (2 Ts) rad/s."""
    assert doubted("pipe", HERTZ) == []


@pytest.mark.parametrize("name", LOOPS)
def test_the_reversed_sign_of_one_channel_is_doubted(name):
    assert doubted(name, 0.9, sign=np.append(np.ones(PLANTS[name].ninputs - 1), -1)) == ["sign"]


def test_a_design_warns_and_its_print_says_P_at_the_first_frequency():
    P, omega = frequency_response(PLANTS["stage"], GRID * 900 * np.pi), GRID * 450
    with pytest.warns(UserWarning, match=r"just below 1 / \(2 Ts\) = 500, .* pass 2 pi omega"):
        design = synthesise(P, zero_phase_butterworth(2, 20.0, 1e-3), omega)
    assert "P is 1 at 0.45 rad/s; " in f"{design}"


@pytest.mark.parametrize(
    "P, words",
    [
        (-0.5 * PLANTS["tanks"], "diag(-0.5, -0.5, -0.5) at zero frequency"),
        # C (I - A)^-1 B by hand: (I - A)^-1 = [[5, 5 / 3], [0, 10 / 3]]
        (axes(), "diag(2.5, 3.15) at zero frequency"),
        (control.ss(0.9, 0.1, 1, -1, 1.0), "0 at zero frequency"),  # 0.1 / (1 - 0.9) - 1
        (control.frd([0.2j, 0.1], [1, 2], 1.0), "0.2 at 90 degrees at 1 rad/s"),
    ],
)
def test_the_gain_at_rest_in_words(P, words):
    assert at_rest_in_words(response_of(P)) == f"P is {words}"


@pytest.mark.parametrize("lowest, codes", [(1e-3, ["rest"]), (0.3, [])])
def test_a_loop_that_integrates_is_one_at_rest(lowest, codes):
    """Where the loop itself is far from one, nothing is said."""
    loop = LOOPS["tanks"]()
    omega = np.geomspace(lowest, np.pi / loop.Ts, 100)
    for gain, expected in ((1, []), (0.1, codes)):
        table = TabulatedResponse(omega, gain * loop.frequency_response(omega), 0 * omega, loop)
        assert [found.code for found in doubts(response_of(table, omega))] == expected
