"""Experiments on the rod's rigs: what they measure of the room, and safe in the end."""

from types import SimpleNamespace

import numpy as np
import pytest
from rods import PRINTED as L
from rods import Failing

from ilctools import Law, load_log, record
from ilctools.errors import RigError
from rodlib.case import assumed_reference
from rodlib.rigs import VirtualRig


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


@pytest.mark.parametrize("shown", [[np.nan, 0.0], OSError("unplugged"), KeyboardInterrupt()])
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
