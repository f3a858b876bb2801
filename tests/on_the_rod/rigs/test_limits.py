"""Experiments that go wrong while somebody watches: what is said of them, and what is kept."""

import numpy as np
import pytest
from plants import RestartingModel, boiler, bump
from rods import Failing

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    multisine,
    record,
    shake,
    zero_phase_butterworth,
)
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


def test_what_was_learned_before_a_stop_is_kept(loop, Q, tmp_path):
    """Somebody knocks in the third trial. With a path in the log, in any case with the error.

    The same call goes on.
    """
    law, path = Law(Q, LearningFilter(np.eye(2)[..., None], 1.0)), tmp_path / "log.csv"
    trials, knock = (loop, law, bump(25, [0.5, 0.2]), None, 3), (2 * 25 + 7, [100.0, 100.0])
    whole = record(Failing(), *trials)
    with pytest.raises(StoppedError, match=r"(?s)y1 = .*in trial 3, sample 8") as stop:
        record(Failing(*knock), *trials, path=path)
    assert str(path) in stop.value.__notes__[0]
    assert load_log(path).identical(stop.value.trials)
    assert stop.value.trials.identical(whole.isel(trial=slice(2)))
    assert record(Failing(), *trials, path=path).identical(whole)
    wider = {"y1": (-200.0, 200.0), "y2": None, "Q1": (-60.0, 60.0)}
    with pytest.raises(StoppedError, match=r"(?s)Q1 = .*in trial 3, sample 9"):
        record(Failing(*knock), *trials, stop=wider)
