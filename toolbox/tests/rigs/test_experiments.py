"""Experiments on rigs: as simulated, by names, and refused before they begin."""

from types import SimpleNamespace

import control
import numpy as np
import pytest
from plants import ModelRig, RestartingModel, boiler

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    current_trial_loop,
    load_log,
    record,
    replay,
    run_trials,
    zero_phase_butterworth,
)

BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])


@pytest.mark.filterwarnings("ignore:.*the reference starts")
def test_a_rig_that_is_the_loops_plant_gives_the_simulation_by_names(tmp_path):
    """Each trial with a reference of its own; the third goes on from the log of two."""
    plant, path = boiler(), tmp_path / "log.csv"
    units = {"pump, left": "l/min", "heater": "W", "depth": "mm", "heat": "degC"}
    loop = current_trial_loop(plant, plant.input_labels[:2], units=units)
    law = Law(
        zero_phase_butterworth(2, 0.1, 0.5), LearningFilter(np.ones((2, 2, 4)) / 3, 0.5), 4, 0.3
    )
    rng = np.random.default_rng(0)
    reference, rain = rng.standard_normal((3, 40, 2)), rng.standard_normal((3, 40, 1))
    device = RestartingModel(plant, ("spare", "heater", "rain", "pump, left"))
    for k in (2, 3):
        task = reference[:k], rain[:k], k
        log = record(device, loop, law, *task, path=path, stop={"depth": None})
    run = run_trials(loop, law, reference, rain, 3)
    assert np.abs(log.v[1:, -5]).min() > 0 and not log.v[:, -4:].any()  # it rests
    replayed = replay(load_log(path))  # by the law and the loop that it names
    assert (replayed.law.rest, replayed.law.gain) == (4, 0.3)
    assert replayed.departure.to_numpy().max() < 1e-9
    np.testing.assert_allclose(replayed.simulated.y, run.y, atol=1e-9)
    assert log.sizes == run.sizes and log.attrs["Ts"] == 0.5 and device.ends == 2
    for name in run.data_vars:
        np.testing.assert_allclose(log[name], run[name], atol=1e-9)
        assert log[name].attrs == run[name].attrs
    for name in ("output", "control", "source"):
        assert log[name].equals(run[name])
    assert not np.any(np.array(device.sent)[:, 0])


Q10 = zero_phase_butterworth(2, 0.1, 0.5)
REFUSED = [  # what is wrong, and what the error says
    ({"rig": SimpleNamespace(read=len, apply=len, Ts=2.0)}, "rig.Ts = 2.0"),
    ({"rig": ModelRig}, "rig = .* is a class"),
    (
        {"loop": current_trial_loop(control.ss(0.5, 1, 1, 0, 0.5))} | {"reference": np.zeros(10)},
        "rig.inputs",
    ),
    ({"pause": -1}, "pause = -1"),
    ({"law": Law(Q10, None, 10)}, "rest = 10"),
    ({"decimals": {"z": 3}}, "decimals is about"),
    ({"decimals": {"u": 0.5}}, "decimals.*u.* = 0.5"),
    ({"stop": {"z": (0, 1)}}, "stop is about"),
    ({"stop": {"heat": (1, 0)}}, "stop.*lower and a"),
    ({"path": "\x1b"}, r"path = '.x1b' must be the path"),
    ({"path": "nowhere/log.csv"}, "path = .*nowhere.log.csv"),
    ({"path": "x", "law": Law(Q10, NormOptimal(control.ss(0.5, 1, 1, 0, 0.5), 1, 9))}, "L"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_an_experiment_that_cannot_work_is_not_begun(changes, message):
    rig = ModelRig(boiler())
    valid = {"rig": rig, "loop": BOILER, "law": Law(Q10, None), "trials": 2}
    signals = {"reference": np.zeros((10, 2)), "disturbance": np.zeros((2, 10, 1))}
    with pytest.raises(ValueError, match=message):
        record(**valid | signals | changes)
    assert not rig.sent
