"""Limits at which a rig is stopped."""

import numpy as np
import pytest
from plants import RestartingModel, boiler, bump

from ilctools import Law, current_trial_loop, multisine, record, shake, zero_phase_butterworth
from ilctools.errors import StoppedError

BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])


def test_an_actuator_of_the_wrong_sign_does_not_run_away():
    """Without limits it did, to 1e50, and not a word."""
    device = RestartingModel(boiler(), signs=[-1.0, 1.0, 1.0])
    law = Law(zero_phase_butterworth(2, 0.1, 0.5), None)
    with pytest.raises(StoppedError, match=r"(?s)depth = .* from -25 to 30, .*in trial 1") as stop:
        record(device, BOILER, law, bump(200, [5.0, 3.0]), trials=2)
    assert np.abs(device.sent).max() < 1e3 and device.ends == 1
    assert stop.value.trials is None
    excitation = multisine(BOILER, 0.1, 3.0, 1.0, 0.22, 5)
    with pytest.raises(StoppedError, match=r"heat = .* is not from -5.99743 to 5.99743"):
        shake(RestartingModel(boiler(), signs=[1.0, -1.0, 1.0]), BOILER, excitation)
