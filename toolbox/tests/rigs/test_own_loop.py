"""Loops whose controller is not ours: a PID in a PLC, a target that runs a trial by itself."""

import control
import numpy as np
import pytest
from plants import RestartingModel, axes, bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    load_log,
    measured_response,
    multisine,
    record,
    run_trials,
    shake,
    zero_phase_butterworth,
)
from ilctools.law.notes import loop_of
from ilctools.logs.replay import replay

P, REFERENCE = axes(), bump(150, [2.0, -1.0])
LAW = Law(zero_phase_butterworth(2, 3.0, 0.1), LearningFilter(0.1 * np.eye(2)[..., None], 0.1))
KNOWN = ClosedLoop(P)
UNNAMED = control.ss(P, inputs=["w1", "w2"])
NAMED = ClosedLoop(Ts=0.1, outputs=["x", "y"], units={"x": "mm", "y": "mm"})


def response(w):
    return control.forced_response(P, inputs=w.T).outputs.T


def test_a_loop_that_is_known_by_p_is_simulated():
    run = run_trials(KNOWN, LAW, REFERENCE, trials=3)
    v = np.zeros_like(REFERENCE)
    for k in range(3):
        y = response(REFERENCE + v)
        np.testing.assert_allclose(run.y[k], y, atol=1e-12)
        v = LAW.next(v, REFERENCE - y)
    x, noise = np.array([1.0, -1.0]), np.random.default_rng(0).random((1, 150, 2))
    start = run_trials(KNOWN, LAW, REFERENCE, None, 1, initial_state=x, noise=noise)
    np.testing.assert_allclose(start.y[0, 0], P.C @ x + noise[0, 0])


def test_it_learns_on_its_rig_as_in_the_simulation(tmp_path):
    path = tmp_path / "log.csv"
    log = record(RestartingModel(UNNAMED), NAMED, LAW, REFERENCE, trials=3, path=path)
    run = run_trials(KNOWN, LAW, REFERENCE, trials=3)
    for name in ("v", "y", "e"):
        np.testing.assert_allclose(log[name], run[name], atol=1e-12)
    assert "u" not in log and "control" not in log.coords
    assert load_log(path).identical(log)
    noted, replayed = loop_of(log), replay(log)
    assert (noted.Ts, noted.outputs, noted.units) == (NAMED.Ts, NAMED.outputs, NAMED.units)
    assert not replayed.departure.values.any() and replayed.simulated is replayed.fit is None


def test_its_commands_are_recorded_if_the_rig_reports_them(tmp_path):
    loop = ClosedLoop(Ts=0.1, outputs=["x", "y"], controls=["motor x", "motor y"])
    rig, path = RestartingModel(UNNAMED), tmp_path / "log.csv"
    trials = loop, LAW, REFERENCE
    with pytest.raises(ValueError, match=r"rig\.measured must have the controls"):
        record(rig, *trials)
    rig.measured = {"motor x": 1 / 3, "motor y": 2.0}
    log = record(rig, *trials, trials=2, decimals={"u": 2}, path=path)
    assert np.all(log.u == [0.33, 2.0]) and load_log(path).identical(log)


@pytest.mark.parametrize(("loop", "model", "noise"), [(NAMED, UNNAMED, 0.001), (KNOWN, P, 0.0)])
def test_it_is_shaken_and_nothing_is_assumed_of_it_at_frequency_zero(loop, model, noise):
    """Without noise rounding is no sign of a loop that is not linear."""
    excitation = multisine(loop, 0.3, 20.0, 1.0, 0.1, 20)
    measured = measured_response(shake(RestartingModel(model, noise=noise), loop, excitation))
    assert measured.distortion.max() <= 3 * measured.noise.max()
    omega = np.append([0.0, 0.1, 1.0], measured.omega)
    response, radius = measured.on(omega)
    truth = KNOWN.frequency_response(omega)
    assert np.linalg.norm(truth[0] - np.eye(2), 2) > 1
    off = np.linalg.norm(response - truth, 2, axis=(1, 2))
    assert np.all(off <= radius + 1e-9) and radius[:3].max() < 0.2 and off[3:].max() < 0.01
