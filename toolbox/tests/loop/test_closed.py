"""Our loop around other plants, and loops whose controller is not ours, such as a PID in a PLC."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import RestartingModel, axes, bump, lags, random_plant, tanks
from written_out import another, mixed, simulated

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    record,
    run_trials,
    zero_phase_butterworth,
)
from ilctools.law.notes import loop_of
from ilctools.logs.replay import replay
from ilctools.models import frequency_response


@given(st.integers(0, 2**32 - 1))
def test_the_controller_around_another_plant(seed):
    """Of another order, with feedthrough, and with its signals in another order."""
    rng, Ts = np.random.default_rng(seed), 0.5
    design = random_plant(rng)
    design.dt = Ts
    loop = current_trial_loop(design, ["u1", "u2"])
    design, grid = loop.plant, np.append(0.0, np.geomspace(1e-3, np.pi, 20)) / Ts
    by_control = np.moveaxis(loop.closed[:, :2](np.exp(1j * grid * Ts)), 2, 0)
    own = frequency_response(design[:, ["u1", "u2"]], grid)
    for plant in (None, design, own):  # around its own the observer drops out
        P = loop.frequency_response(grid, plant)
        assert_allclose(P, by_control, rtol=0, atol=1e-9 * np.abs(P).max())
    other = another(design, rng)
    try:
        closed = loop.around(mixed(other, rng))
    except ValueError as error:
        assert "unstable" in str(error)
        w, d = np.tile(rng.standard_normal(2), (3000, 1)), np.zeros((3000, 1))
        y, _, _ = simulated(loop, other, w, d)
        assert np.abs(y[-100:] - w[-100:]).max() > 1e-6  # a stable one has settled
        return
    w, d = rng.standard_normal((40, 2)), rng.standard_normal((40, 1))
    expected, _, _ = simulated(loop, other, w, d)
    response = control.forced_response(closed, inputs=np.hstack([w, d]).T).outputs.T
    scale = np.abs(expected).max()
    assert_allclose(response, expected, rtol=0, atol=1e-9 * scale)
    samples = frequency_response(other[:, ["u1", "u2"]], grid)
    expected = frequency_response(closed[:, :2], grid)
    scale = np.abs(expected).max()
    for plant in (other, samples):
        P = loop.frequency_response(grid, plant)
        assert_allclose(P, expected, rtol=0, atol=1e-9 * scale)


NAMES = {"inputs": ["a", "b"], "outputs": ["p", "q"]}
COUPLED = control.ss(lags(), **NAMES)
REFUSALS = [  # a plant, and what the error names
    (
        control.ss(-1, [[1, 1]], [[1], [1]], 0, **NAMES),
        "plant.dt = 0 is continuous time: pass .*sample",
    ),
    (control.ss(lags().A, lags().B, np.eye(2), 0, 2.0, **NAMES), "plant.Ts = 2.0"),
    (tanks(1.0), r"also needs \['a', 'b', 'p', 'q'\]"),
    (np.ones((3, 2, 1)), "plant has shape"),
    (control.ss(lags().A, -lags().B, np.eye(2), 0, 1.0, **NAMES), "makes the loop unstable"),
]


@pytest.mark.parametrize(("plant", "message"), REFUSALS)
def test_other_plants_that_do_not_fit_are_refused(plant, message):
    with pytest.raises(ValueError, match=message):
        current_trial_loop(COUPLED).frequency_response([0.1, 0.2, 0.3], plant=plant)


P, REFERENCE = axes(), bump(150, [2.0, -1.0])
LAW = Law(zero_phase_butterworth(2, 3.0, 0.1), LearningFilter(0.1 * np.eye(2)[..., None], 0.1))
KNOWN = ClosedLoop(P)
UNNAMED = control.ss(P, inputs=["w1", "w2"])


def test_a_loop_that_is_known_by_p_is_simulated_from_any_state_with_noise():
    """Trials from rest without noise: `test_channels`."""
    x, noise = np.array([1.0, -1.0]), np.random.default_rng(0).random((1, 150, 2))
    start = run_trials(KNOWN, LAW, REFERENCE, None, 1, initial_state=x, noise=noise)
    assert_allclose(start.y[0, 0], P.C @ x + noise[0, 0])


def test_it_learns_on_its_rig_as_in_the_simulation(tmp_path):
    """And its commands are recorded, because the rig reports them."""
    motors, path = {"motor x": 1 / 3, "motor y": 2.0}, tmp_path / "log.csv"
    loop, rig = ClosedLoop(Ts=0.1, outputs=["x", "y"], controls=[*motors]), RestartingModel(UNNAMED)
    with pytest.raises(ValueError, match=r"rig\.measured must contain the controls"):
        record(rig, loop, LAW, REFERENCE)
    rig.measured = motors
    log = record(rig, loop, LAW, REFERENCE, trials=3, decimals={"u": 2}, path=path)
    run = run_trials(KNOWN, LAW, REFERENCE, trials=3)
    for name in ("v", "y", "e"):
        assert_allclose(log[name], run[name], atol=1e-12)
    assert np.all(log.u == [0.33, 2.0])
    assert load_log(path).identical(log)
    noted, replayed = loop_of(log), replay(log)
    assert (noted.Ts, noted.outputs) == (loop.Ts, loop.outputs)
    assert not replayed.departure.values.any() and replayed.simulated is replayed.fit is None
