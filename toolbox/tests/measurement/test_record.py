"""Logs as one record, and what is known of the plant beforehand."""

import control
import numpy as np
import pytest
from plants import furnace
from records import covers, moved

from ilctools import measured_response
from ilctools.errors import LogError
from ilctools.measurement import estimation


@pytest.mark.parametrize("shape", [(1, 2), (2, 1)])
def test_numbers_of_inputs_and_outputs_may_differ(shape):
    plant = control.ss(np.diag([0.9, 0.6]), [[0.1, 0], [0, 0.4]], np.eye(2), 0, 1.0)
    plant = (np.ones((shape[0], 2)) * plant)[:, : shape[1]]
    estimate = measured_response(moved(control.ss(plant), 300))
    assert estimate.response.shape[1:] == shape
    assert covers(estimate, plant)


def test_a_known_delay_is_less_to_estimate(monkeypatch):
    plant = control.ss(furnace(60))
    log = moved(plant, 400)
    late, searched = measured_response(log, delay=61), measured_response(log)
    assert covers(late, plant)
    assert np.median(late.radius() / searched.radius()) < 1  # which is a few samples short
    model = late.model()  # a delay is states
    assert model.nstates == 1 + 60 and covers(late, model)
    monkeypatch.setattr(estimation, "HANKEL_ROWS", 50)
    with pytest.raises(LogError, match="no model of up to 50 states"):
        late.model()
    for delay in (-1, 0.5, [1, 2]):
        with pytest.raises(ValueError, match="delay"):
            measured_response(log, delay=delay)
