"""The gains of the loop: against python-control, and the plant in other units."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import PUMPS, furnace, random_plant, stage, tanks
from scipy.linalg import block_diag

from ilctools import current_trial_loop
from ilctools.models import frequency_response

SIZES = {"x": 5.0, "F": 20.0}
SKEW = [[0, 1], [-1, 0]]  # of which no weight takes notice


@pytest.mark.parametrize("sizes", [None, SIZES])
def test_gains_agree_with_python_control(sizes):
    """With the weights by default, which are those of the docstring, and with these as given."""
    plant = stage()
    A, B, C = plant.A, plant.B[:, :1], plant.C
    y, u, spread = (1, 1, np.eye(2)) if sizes is None else (5, 20, 400 * B @ B.T)
    Qs, Rs = C.T @ C / y**2, np.array([[0.05 / u**2]])
    Qo, Ro = block_diag(spread, 2 * u**2), np.array([[y**2]])
    Aa, Ca = np.block([[A, B], [0, 0, 1]]), np.hstack([C, [[0]]])
    Ks, _, _ = control.dlqr(A, B, Qs, Rs)
    KL, _, _ = control.dlqe(Aa, np.eye(3), Ca, Qo, Ro)
    for asked in ({"sizes": sizes}, {"Qs": Qs + SKEW, "Rs": Rs, "Qo": Qo, "Ro": Ro}):
        loop = current_trial_loop(plant, ["F"], **asked)
        assert_allclose(loop.Ks, Ks, rtol=1e-5)
        assert_allclose(loop.KL, KL, rtol=1e-5)


@given(st.integers(0, 2**32 - 1))
def test_any_plant_gets_a_stable_loop_without_steady_state_error(seed):
    loop = current_trial_loop(random_plant(np.random.default_rng(seed)), ["u1", "u2"])
    assert np.abs(loop.closed.poles()).max() < 1
    at_rest = frequency_response(loop.closed, [0.0])[0]
    assert_allclose(at_rest, np.eye(2, 3), atol=1e-6)


@pytest.mark.parametrize(
    ("plant", "unit"),
    [
        (control.ss2tf(stage(length=1.0, force=1e3)), 1e-3),  # in m and kN
        (control.similarity_transform(stage(), [[1.0, 3.0], [-20.0, 0.1]]), 1.0),
    ],
    ids=["units", "coordinates"],
)
def test_with_sizes_the_loop_depends_on_neither_units_nor_coordinates(plant, unit):
    """Against the stage in mm and N: the same loop from w and friction to x, physically."""
    sizes = {name: size * unit for name, size in SIZES.items()}
    grid = np.append(0.0, np.geomspace(1e-2, np.pi / 1e-3, 40))
    expected, response = (
        frequency_response(loop.closed, grid)
        for loop in (
            current_trial_loop(stage(), ["F"], SIZES),
            current_trial_loop(plant, ["F"], sizes),
        )
    )
    scale = np.abs(expected).max(axis=0)
    assert_allclose(response / scale, expected / scale, rtol=0, atol=1e-9)


def test_slow_tanks_have_a_loop_without_sizes():
    """Four of 100 s, as a transfer function, in whose own coordinates rounding refused it."""
    tanks = control.tf([1], np.poly([-0.01] * 4) * 1e8)
    loop = current_trial_loop(control.sample_system(tanks, 1.0))
    assert np.abs(loop.closed.poles()).max() < 0.995 and loop.P(1.0) == pytest.approx(1)


def test_a_long_delay_is_thirty_states_more():
    loop = current_trial_loop(furnace(30), sizes={"valve": 0.1})
    assert loop.plant.nstates == 31 and not np.any(loop.plant.D)
    for samples in (29, 31):
        assert np.abs(loop.around(furnace(samples)).poles()).max() < 0.97
    with pytest.raises(ValueError, match="plant makes the loop unstable"):
        loop.around(furnace(40))


def lag(**system):
    matrices = {"A": 0.5, "B": 1, "C": 1, "D": 0, "dt": 1.0} | system
    return control.ss(*matrices.values())


REFUSALS = [  # a plant, arguments, and what the error names
    (lag(D=1), {}, "plant.D"),
    (control.tf([1, 0, 0], [1, 0.5], 1.0), {}, "more zeros than poles"),
    (control.ss(0.5, 1, 1, 0, 1.0, inputs="a", outputs="a"), {}, "its own name"),
    (tanks(), {}, "4 inputs, but the plant has 3 outputs.* learn from all"),
    (tanks(), {"controls": PUMPS, "sizes": {"leak": 1}}, "sizes has the keys"),
    (lag(), {"Qs": [[-1.0]]}, "Qs must be positive semi"),
    (lag(), {"Qo": np.zeros((2, 2))}, "Qo and Ro leave .* a weight is zero"),
    (stage(), {"controls": ["F"], "Qs": np.diag([1e60, 1e-60])}, "Qs and Rs leave the Riccati"),
    # The input that reaches the unstable mode is a disturbance.
    (
        control.ss(np.diag([0.5, 1.2]), np.eye(2), [[1.0, 1.0]], 0, 1.0),
        {"controls": ["u[0]"]},
        "Qs and Rs leave .* cannot reach",
    ),
    # A mode at 1, which rounding puts inside the unit circle.
    (
        lag(A=[[1.9, 1.0], [-0.9, 0.0]], B=[[1.0], [-1.0]], C=[[1.0, 0.0]]),
        {},
        "Qs and Rs leave .* cannot reach",
    ),
    (
        lag(A=[[0, 1.0], [0, 0.5]], B=[[0.0], [1.0]], C=[[-1.0, 1.0]]),
        {},
        "Qo and Ro leave .* zero at z = 1",
    ),
]


@pytest.mark.parametrize(("plant", "asked", "message"), REFUSALS)
def test_bad_plants_and_weights_are_refused(plant, asked, message):
    with pytest.raises(ValueError, match=message):
        current_trial_loop(plant, **asked)
