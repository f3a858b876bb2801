import json
from dataclasses import asdict, replace

import control
import numpy as np
import pytest

from rodlib import (
    LearningFilter,
    Rod,
    current_trial_loop,
    exact_response,
    published,
    rig,
    run_trials,
    update,
    zero_phase_butterworth,
)
from rodlib.logs import load_log, rest_of
from rodlib.published import ROOT
from rodlib.rig import Controller, RigParameters, VirtualRig, record
from rodlib.trials import assumed_disturbance, assumed_reference, rms

IDEAL = RigParameters(noise=0, quantum=0, lag=0, limit=np.inf, ambient_rate=0)


def run_rig(device, commands):
    readings = []
    for command in commands:
        readings.append(device.read())
        device.apply(command)
    return np.array(readings)


def test_step_response_settles_at_the_exact_gain():
    device = VirtualRig(Rod(), IDEAL)
    for element in range(4):
        device = VirtualRig(Rod(), IDEAL)
        readings = run_rig(device, np.tile(np.eye(4)[element], (4000, 1)))
        np.testing.assert_allclose(
            readings[-1], exact_response(Rod(), [0.0])[0].real[:, element], rtol=1e-4
        )


@pytest.mark.parametrize("omega", [0.002, 0.02, 0.1])
def test_sinusoids_pass_as_in_the_exact_response(omega):
    """Held inputs: the exact response times that of the hold, once the start has died away."""
    periods = round(2 * np.pi / omega)
    omega = 2 * np.pi / periods
    time = np.arange(3000 + 3 * periods)
    commands = np.sin(omega * time)[:, None] * np.eye(4)[0]
    readings = run_rig(VirtualRig(Rod(), IDEAL), commands)[-3 * periods :]
    phase = np.exp(-1j * omega * time[-3 * periods :])
    measured = 2j * (phase @ readings) / len(phase)
    hold = (1 - np.exp(-1j * omega)) / (1j * omega)
    expected = exact_response(Rod(), [1j * omega])[0][:, 0] * hold
    np.testing.assert_allclose(measured, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("lag", [0.0, 4.0])
def test_heat_is_conserved(lag):
    """With hardly any loss to the air, what the elements supply is what the rod stores."""
    rod = Rod(heat_transfer=1e-9)
    device = VirtualRig(rod, replace(IDEAL, lag=lag))
    commands = np.random.default_rng(0).uniform(-20, 20, (200, 4))
    commands[100:] = 0  # lets the lag run out
    run_rig(device, commands)
    mean = np.mean(device.profile((np.arange(4000) + 0.5) / 4000 * rod.length))
    stored = rod.kappa_1 * rod.length * rod.width * rod.height * mean
    assert stored == pytest.approx(commands.sum(), rel=1e-6)


def test_at_rest_the_air_takes_what_the_elements_give():
    rod = Rod()
    device = VirtualRig(rod, IDEAL)
    run_rig(device, np.tile([3.0, 0, 5.0, -1.0], (4000, 1)))
    mean = np.mean(device.profile((np.arange(4000) + 0.5) / 4000 * rod.length))
    assert rod.heat_transfer * rod.width * rod.length * mean == pytest.approx(7.0, rel=1e-5)


def test_lag_saturation_noise_and_quantisation():
    base = VirtualRig(Rod(), IDEAL)
    slow = VirtualRig(Rod(), replace(IDEAL, lag=10.0))
    clipped = VirtualRig(Rod(), replace(IDEAL, limit=5.0))
    commands = np.tile([20.0, 0, 0, 0], (60, 1))
    fast = run_rig(base, commands)
    late = run_rig(slow, commands)
    assert 0 < late[-1, 0] < fast[-1, 0]
    np.testing.assert_allclose(run_rig(clipped, commands), fast / 4, atol=1e-12)
    noisy = VirtualRig(Rod(), replace(IDEAL, noise=0.05, quantum=0.01), seed=3)
    readings = np.array([noisy.read() for _ in range(4000)])
    assert readings.std() == pytest.approx(0.05, rel=0.05)
    np.testing.assert_allclose(readings * 100, np.round(readings * 100), atol=1e-6)
    again = VirtualRig(Rod(), replace(IDEAL, noise=0.05, quantum=0.01), seed=3)
    np.testing.assert_array_equal(readings[:50], [again.read() for _ in range(50)])


def test_room_warms_up_and_the_rod_follows():
    device = VirtualRig(Rod(), replace(IDEAL, ambient_rate=1e-4))
    run_rig(device, np.zeros((5000, 4)))
    assert device.ambient == pytest.approx(0.5)
    assert np.all(np.abs(device.read() - 0.5 + 262e-4) < 2e-3)  # behind by its time constant


def test_controller_on_the_design_model_gives_the_simulated_trial(loop, Q):
    """Sample by sample as on hardware, and all at once: the same trial."""
    reference = assumed_reference(300) * 5
    x, controller = np.zeros(10), Controller(loop)
    outputs = []
    for w in reference:
        outputs.append(loop.plant.C @ x)
        x = loop.plant.A @ x + loop.plant.B[:, :2] @ controller.step(outputs[-1], w)
    run = run_trials(loop, Q, None, reference, None, 1)
    np.testing.assert_allclose(outputs, run.y[0], atol=2e-4)  # u is rounded to 0.1 mW


def test_ideal_rig_with_nominal_rod_agrees_with_the_simulation(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    reference, disturbance = assumed_reference(1200), assumed_disturbance(1200, 3, 2)
    log = record(VirtualRig(Rod(), IDEAL), loop, Q, L, reference, disturbance, 3)
    run = run_trials(loop, Q, L, reference, disturbance, 3)
    np.testing.assert_allclose(log.y, run.y, atol=0.02 * np.abs(reference).max())
    np.testing.assert_allclose(rms(log.e), rms(run.e), rtol=0.1)


def test_v_rests_on_the_rig_too_and_the_log_says_so(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    reference, d = assumed_reference(60), np.zeros((3, 60, 3))
    log = record(VirtualRig(), loop, Q, L, reference, d, 3, pause=5, rest=15)
    assert not log.v.values[:, -15:].any() and log.v.values[1:, -16].any()
    assert rest_of(log) == 15
    for k in range(2):
        law = update(log.v.values[k], log.e.values[k], Q, L, 15)
        np.testing.assert_allclose(log.v[k + 1], law, atol=1e-6)


def test_the_controller_runs_on_for_ten_minutes_between_two_trials(loop, Q):
    device = VirtualRig()
    record(device, loop, Q, None, np.zeros((7, 2)), np.zeros((3, 7, 3)), 3)
    assert device.time == 3 * 7 + 2 * 600


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rig": VirtualRig(Ts=2.0)}, r"rig.Ts = 2.0 s"),
        ({"Q": zero_phase_butterworth(Ts=2.0)}, r"loop.Ts = 1.0 s, Q.Ts = 2.0 s, rig.Ts = 1.0 s"),
        ({"L": LearningFilter(np.ones((2, 2, 1)), 0.5)}, r"rig.Ts = 1.0 s, L.Ts = 0.5 s"),
        ({"rig": "the red one"}, "rig = 'the red one' has no read, apply, ambient"),
        ({"trials": 3}, "disturbance has 2 trials, but trials = 3"),
        ({"disturbance": np.zeros((2, 9, 3))}, r"disturbance has shape \(2, 9, 3\).*trial, 10, 3"),
        ({"pause": -1}, "pause = -1"),
        ({"rest": 10}, "rest = 10 must be a whole number, from 0 to 9"),
        ({"loop": current_trial_loop(control.ss(0.5, 1, 1, 0, 1.0))}, "loop has the inputs"),
    ],
)
def test_an_experiment_that_cannot_work_is_not_begun(loop, Q, changes, message):
    experiment = {"rig": VirtualRig(), "loop": loop, "Q": Q, "L": None}
    experiment |= {"reference": np.zeros((10, 2)), "disturbance": np.zeros((2, 10, 3)), "trials": 2}
    with pytest.raises(ValueError, match=message):
        record(**experiment | changes)
    assert experiment["rig"].time == 0


def test_first_trial_of_the_tracked_log_is_recorded_again_alike(loop, Q):
    tracked = load_log(ROOT / "data" / "rig" / "no-learning.csv")
    log = record(VirtualRig(seed=2), loop, Q, None, assumed_reference(), assumed_disturbance(), 1)
    for name in ("reference", "v", "u", "y", "delta", "disturbance"):
        np.testing.assert_array_equal(log[name][0], tracked[name][0])


def test_the_tracked_logs_are_of_the_assumed_experiment():
    for name, seed in (("learning", 1), ("no-learning", 2)):
        tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv")
        device = {"modes": 300, "noise": 0.02, "quantum": 0.01, "lag": 4.0, "limit": 60.0}
        device |= {"ambient_rate": 5e-5}
        assert device == asdict(VirtualRig().parameters)
        device |= {"seed": seed, "rod": json.loads(json.dumps(asdict(VirtualRig().rod)))}
        assert json.loads(tracked.attrs["rig"]) == device
        assert tracked.sizes["trial"] == 10
        for k in range(10):
            np.testing.assert_array_equal(tracked.reference[k], np.round(assumed_reference(), 6))
        flows = np.round(assumed_disturbance(), 6)[:, :, 1:]
        np.testing.assert_array_equal(tracked.disturbance[:, :, 1:], flows)


def test_bad_commands_are_refused():
    with pytest.raises(ValueError, match="must be 4 finite numbers"):
        VirtualRig().apply([1.0, 2.0])
    with pytest.raises(ValueError, match="finite"):
        VirtualRig().apply([1.0, 2.0, np.nan, 0])


def test_the_logs_are_recorded_in_data_rig(monkeypatch):
    saved = []
    monkeypatch.setattr(rig, "record", lambda *_: load_log(ROOT / "data/rig/no-learning.csv"))
    monkeypatch.setattr(rig, "save_log", lambda log, path: saved.append(path))
    rig.main()
    assert saved == [ROOT / "data/rig/learning.csv", ROOT / "data/rig/no-learning.csv"]
