"""Experiments on rigs: as simulated, by names, refused before they begin, safe in the end."""

from types import SimpleNamespace

import control
import numpy as np
import pytest
from plants import RestartingModel, boiler
from rods import PRINTED as L
from rods import Failing

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
from ilctools.errors import RigError
from rodlib.case import assumed_reference
from rodlib.rigs import VirtualRig


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


def test_only_known_disturbances_are_recorded(loop, Q):
    device, law, zeros = VirtualRig(), Law(Q, None), np.zeros((5, 2))
    driver = SimpleNamespace(read=device.read, inputs=["Q3", "Q1"])
    driver.apply = lambda flows: device.apply([flows[1], 0, flows[0], 0])
    log = record(driver, loop, law, zeros, None, 1)
    assert "disturbance" not in log and "source" not in log.coords
    driver.measured = {"theta_a": 0.5, "lights": 1.0}
    log = record(driver, loop, law, zeros, np.ones((5, 3)) * [1, 0, 0], 1)
    assert list(log.source.values) == ["theta_a"] and np.all(log.disturbance == 0.5)
    with pytest.raises(ValueError, match=r"disturbance is not zero for \['Q4'\]"):
        record(driver, loop, law, zeros, np.ones((5, 3)) * [0, 0, 1], 1)


Q10 = zero_phase_butterworth(2, 0.1, 1.0)
REFUSED = [  # what is wrong, and what the error says
    ({"rig": VirtualRig(Ts=2.0)}, "rig.Ts = 2.0"),
    ({"rig": VirtualRig}, "rig = .* is a class"),
    (
        {"loop": current_trial_loop(control.ss(0.5, 1, 1, 0, 1.0))} | {"reference": np.zeros(10)},
        "rig.inputs",
    ),
    ({"pause": -1}, "pause = -1"),
    ({"law": Law(Q10, None, 10)}, "rest = 10"),
    ({"decimals": {"y": 3}}, "decimals is about"),
    ({"decimals": {"u": 0.5}}, "decimals.*u.* = 0.5"),
    ({"stop": {"z": (0, 1)}}, "stop is about"),
    ({"stop": {"y1": (1, 0)}}, "stop.*lower and a"),
    ({"path": "\x1b"}, r"path = '.x1b' must be the path"),
    ({"path": "nowhere/log.csv"}, "path = .*nowhere.log.csv"),
    ({"path": "x", "law": Law(Q10, NormOptimal(control.ss(0.5, 1, 1, 0, 1.0), 1, 9))}, "L"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_an_experiment_that_cannot_work_is_not_begun(loop, changes, message):
    rig = VirtualRig()
    valid = {"rig": rig, "loop": loop, "law": Law(Q10, None), "trials": 2}
    signals = {"reference": np.zeros((10, 2)), "disturbance": np.zeros((2, 10, 3))}
    with pytest.raises(ValueError, match=message):
        record(**valid | signals | changes)
    assert rig.time == 0


@pytest.mark.parametrize(
    "shown", [[np.nan, 0.0], [0.0], ["1", "2"], OSError("unplugged"), KeyboardInterrupt()]
)
def test_what_goes_wrong_ends_the_trial_and_the_rig_is_made_safe(loop, Q, tmp_path, shown):
    """What is no reading does not reach the actuators; the trials before it stay."""
    device = Failing(20 + 3 + 12, shown)
    trials = loop, Law(Q, L), assumed_reference(20), None, 3
    with pytest.raises(RigError if isinstance(shown, list) else type(shown)) as error:
        record(device, *trials, pause=3, path=tmp_path / "log.csv")
    said = "\n".join([str(error.value), *getattr(error.value, "__notes__", [])])
    assert "in trial 2, sample 13; nothing was" in said or not isinstance(error.value, Exception)
    assert len(device.commands) == 20 + 3 + 12 + 1
    assert np.isfinite(device.commands).all() and not device.commands[-1].any()
    assert load_log(tmp_path / "log.csv").sizes["trial"] == 1


def test_a_thermometer_in_the_room_that_fails_ends_the_trial(loop, Q):
    class Unplugged(VirtualRig):
        ambient = np.nan

    with pytest.raises(RigError, match=r"(?s)theta_a .*in trial 1, sample 1;"):
        record(Unplugged(), loop, Law(Q, None), np.zeros((5, 2)), None, 1)


def test_samples_that_are_not_on_time_are_reported(loop, Q):
    class Late(VirtualRig):
        def clock(self):
            return self.time + (1.5 if 7 <= self.time < 9 else 0.05)

    with pytest.warns(UserWarning, match="trial 1: 2 samples .* by up to 1.45 s"):
        record(Late(), loop, Law(Q, None), np.zeros((20, 2)), None, 1)
