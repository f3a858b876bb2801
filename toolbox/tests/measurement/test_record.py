"""Logs as one record, and what is known of the plant beforehand."""

import control
import numpy as np
import pytest
import xarray as xr
from plants import furnace

from ilctools import measured_response
from ilctools.errors import LogError
from ilctools.measurement import estimation
from ilctools.measurement.arx.regression import regression
from ilctools.measurement.record import Record
from ilctools.models import frequency_response
from ilctools.singular_values import largest_singular_values


def log_of(u, y, Ts=1.0):
    """One trial from commands (input, time) to outputs (output, time)."""
    variables, coordinates = {}, {"trial": [1], "time": Ts * np.arange(u.shape[1])}
    roles = ("control", "input", "u", u), ("output", "channel", "y", y)
    for role, dimension, letter, rows in roles:
        variables[letter] = ("trial", "time", dimension), rows.T[None]
        coordinates[role] = dimension, [f"{letter}{i}" for i in range(len(rows))]
        coordinates[f"{role}_unit"] = dimension, [""] * len(rows)
    return xr.Dataset(variables, coordinates, {"Ts": Ts})


def moved(plant, N, seed=0, noise=0.02, held=3):
    """A log of a model under noise that is held, from rest."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((plant.ninputs, N // held + 1)), held, axis=1)[:, :N]
    y = control.forced_response(plant, plant.dt * np.arange(N), u).outputs
    y = y.reshape(plant.noutputs, N)
    y = y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    return log_of(u, y, plant.dt)


def error(estimate, plant):
    return largest_singular_values(estimate.response - frequency_response(plant, estimate.omega))


LAG = control.ss(control.tf([0.1], [1, -0.9], 1.0))


@pytest.mark.parametrize("shape", [(1, 2), (2, 1)])
def test_numbers_of_inputs_and_outputs_may_differ(shape):
    plant = control.ss(np.diag([0.9, 0.6]), [[0.1, 0], [0, 0.4]], np.eye(2), 0, 1.0)
    plant = (np.ones((shape[0], 2)) * plant)[:, : shape[1]]
    estimate = measured_response(moved(control.ss(plant), 300))
    assert estimate.response.shape[1:] == shape
    assert np.all(error(estimate, plant) <= estimate.radius(0.99, jointly=True))


def test_a_known_delay_is_less_to_estimate(monkeypatch):
    plant = control.ss(furnace(60))
    log = moved(plant, 400)
    late, searched = measured_response(log, delay=61), measured_response(log)
    assert np.all(error(late, plant) <= late.radius(0.99, jointly=True))
    assert np.median(late.radius() / searched.radius()) < 1  # which is a few samples short
    model = late.model()  # a delay is states
    assert model.nstates == 1 + 60 and np.all(error(late, model) <= late.radius(0.99, jointly=True))
    monkeypatch.setattr(estimation, "HANKEL_ROWS", 50)
    with pytest.raises(LogError, match="no model of up to 50 states"):
        late.model()
    for delay in (-1, 0.5, [1, 2]):
        with pytest.raises(ValueError, match="delay"):
            measured_response(log, delay=delay)


def test_a_gain_of_one_at_rest_makes_low_frequencies_certain():
    """From w of a loop whose observer integrates: P(0) = I, not of one that is not known to."""
    plant = control.ss(control.tf([0.02], [1, -0.98], 1.0))
    groups = Record.of(moved(plant, 300, noise=0.1)).groups
    known, free = (regression(groups, False, gain=gain) for gain in ([1.0], None))
    variances = [np.trace(fit.covariance(np.array([1e-4])).of_P[0]) for fit in (known, free)]
    assert variances[0] < 0.04 * variances[1]
    assert abs(known.response(np.zeros(1)).item() - 1) < 1e-2
