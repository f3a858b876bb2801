from dataclasses import replace

import control
import numpy as np
import pytest
from rods import readings_of

from rodlib import RestartingPeltierRig, Rod, midr
from rodlib.rigs import RestartingRig, RigParameters, VirtualRig

IDEAL = RigParameters(noise=0, quantum=0, lag=0, limit=np.inf, ambient_rate=0)


@pytest.mark.parametrize("lag", [0.0, 4.0])
def test_readings_are_those_of_the_rod_behind_a_hold_and_a_lag(lag):
    rod, element = Rod(), control.ss(control.tf(1, [lag, 1]))
    commands = np.random.default_rng(0).uniform(-50, 50, (40, 4)).repeat(5, axis=0)
    model = midr(rod, 12)[:, rod.inputs[:-1]] * control.append(*[element] * 4)
    expected = control.forced_response(control.sample_system(model, 1.0), inputs=commands.T).outputs
    readings = readings_of(VirtualRig(rod, replace(IDEAL, lag=lag)), commands)
    np.testing.assert_allclose(readings, expected.T, atol=2e-3 * np.abs(expected).max())


def test_saturation_noise_and_quantisation():
    base = VirtualRig(Rod(), IDEAL)
    clipped = VirtualRig(Rod(), replace(IDEAL, limit=5.0))
    commands = np.tile([20.0, 0, 0, 0], (60, 1))
    whole = readings_of(base, commands)
    np.testing.assert_allclose(readings_of(clipped, commands), whole / 4, atol=1e-12)
    noisy = VirtualRig(Rod(), replace(IDEAL, noise=0.05, quantum=0.01), seed=3)
    readings = np.array([noisy.read() for _ in range(4000)])
    assert readings.std() == pytest.approx(0.05, rel=0.05)
    np.testing.assert_allclose(readings * 100, np.round(readings * 100), atol=1e-6)


def test_room_warms_up_and_the_rod_follows():
    device = VirtualRig(Rod(), replace(IDEAL, ambient_rate=1e-4))
    readings_of(device, np.zeros((5000, 4)))
    assert device.ambient == pytest.approx(0.5)
    behind = 262e-4  # by its time constant
    assert np.all(np.abs(device.read() - 0.5 + behind) < 2e-3)


@pytest.mark.parametrize("rig", [RestartingRig, RestartingPeltierRig])
def test_every_trial_of_a_restarting_rig_depends_on_seed_and_number_alone(rig):
    commands = np.tile([20.0, 0, 3, 0], (30, 1))
    device, later = rig(seed=3), rig(seed=3)
    trials = []
    for trial in (1, 2):
        device.begin(trial)
        trials.append(readings_of(device, commands))
        assert device.clock() == 30.0
    later.begin(2)
    np.testing.assert_array_equal(readings_of(later, commands), trials[1])
    assert np.any(trials[0] != trials[1])
    np.testing.assert_allclose(trials[0], trials[1], atol=0.2)  # noise only
