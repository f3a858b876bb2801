from dataclasses import replace

import numpy as np
import pytest
from rods import readings_of

from rodlib import RestartingPeltierRig, Rod, exact_response
from rodlib.rigs import RestartingRig, RigParameters, VirtualRig

IDEAL = RigParameters(noise=0, quantum=0, lag=0, limit=np.inf, ambient_rate=0)


@pytest.mark.parametrize(
    ("omega", "lag", "element"), [(0.002, 0.0, 0), (0.1, 4.0, 0), (0.03, 4.0, 2)]
)
def test_sinusoids_pass_as_in_the_exact_response(omega, lag, element):
    """The exact response times those of hold and lag, once the start has died away."""
    periods = round(2 * np.pi / omega)
    omega = 2 * np.pi / periods
    time = np.arange(3000 + 3 * periods)
    commands = np.sin(omega * time)[:, None] * np.eye(4)[element]
    device = VirtualRig(Rod(), replace(IDEAL, lag=lag))
    readings = readings_of(device, commands)[-3 * periods :]
    phase = np.exp(-1j * omega * time[-3 * periods :])
    measured = 2j * (phase @ readings) / len(phase)
    hold = (1 - np.exp(-1j * omega)) / (1j * omega)
    expected = exact_response(Rod(), [1j * omega])[0][:, element] * hold
    expected = expected / (1 + 1j * omega * lag)
    np.testing.assert_allclose(measured, expected, atol=2e-3 * np.abs(expected).max())


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
