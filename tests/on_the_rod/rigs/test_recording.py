"""A log is gone on with, by the same experiment only."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plants import bump
from rods import Failing

from ilctools import Law, LearningFilter, load_log, record, save_log, zero_phase_butterworth
from rodlib import paper_loop
from rodlib.rigs import VirtualRig

LAW = Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter(0.4 * np.eye(2)[..., None], 1.0))
SHORT = {"reference": bump(25, [0.5, 0.2]), "trials": 3, "pause": 2}


def test_an_interrupted_experiment_goes_on_as_if_nothing_had_been(loop, tmp_path):
    """What is on disk are the trials that had ended; the rest comes out the same, bit for bit."""
    whole = record(Failing(), loop, LAW, **SHORT, path=tmp_path / "whole.csv")
    for samples in (3, 26, 52):  # a trial has 25, the pause before it 2
        path, ended = tmp_path / f"{samples}.csv", (samples + 2) // 27
        with pytest.raises(KeyboardInterrupt):
            record(Failing(samples, KeyboardInterrupt()), loop, LAW, **SHORT, path=path)
        assert path.exists() == (ended > 0)
        if ended:
            log = load_log(path)
            assert log.identical(whole.isel(trial=slice(ended)))
            save_log(log.assign_attrs(operator="Ada"), path)
        finished = record(Failing(), loop, LAW, **SHORT, path=path)
        assert finished.attrs.pop("operator", "Ada") == "Ada"
        assert finished.identical(whole)


def test_an_experiment_that_has_ended_leaves_rig_and_log_alone(loop, tmp_path):
    path, device = tmp_path / "log.csv", VirtualRig()
    log = record(device, loop, LAW, **SHORT, path=path)
    content, time = path.read_bytes(), device.time
    assert record(device, loop, LAW, **SHORT, path=path).identical(log)
    fewer = record(device, loop, LAW, **SHORT | {"trials": 2}, path=path)
    assert fewer.identical(log)
    assert path.read_bytes() == content and device.time == time
    assert load_log(path).identical(log)
    more = record(device, loop, LAW, **SHORT | {"trials": 4}, path=path)
    assert more.isel(trial=slice(3)).identical(log) and load_log(path).identical(more)
    save_log(log.isel(trial=[0, 2]), path)
    with pytest.raises(ValueError, match="numbers"):
        record(device, loop, LAW, **SHORT, path=path)


@pytest.mark.parametrize(
    ("changes", "differing"),
    [
        ({"reference": SHORT["reference"] + 1}, "reference"),
        ({"law": replace(LAW, L=None)}, "L"),
        ({"law": replace(LAW, gain=0.5)}, "step"),
        ({"law": replace(LAW, limits={})}, "actuators"),
        ({"rig": SimpleNamespace(read=len, apply=len)}, "actuators, disturbances"),
        ({"loop": paper_loop(degree=4)}, "loop"),
        ({"v": SHORT["reference"]}, "v of trial 1"),
    ],
)
def test_another_experiment_does_not_go_on_with_the_log(loop, tmp_path, changes, differing):
    path, rig = tmp_path / "log.csv", VirtualRig()
    valid = {"rig": rig, "loop": loop, "law": LAW, "path": path} | SHORT
    record(**valid | {"trials": 1})
    content, time = path.read_bytes(), rig.time
    with pytest.raises(ValueError, match=f"another experiment, see its {differing}:"):
        record(**valid | changes)
    assert path.read_bytes() == content and rig.time == time


def test_two_do_not_record_to_one_log(loop, tmp_path):
    """The second is refused before anything is applied."""
    path, other = tmp_path / "log.csv", VirtualRig()

    class Shared(Failing):
        def begin(self, trial):
            with pytest.raises(RuntimeError, match=r"path = .*recorded to by another"):
                record(other, loop, LAW, **SHORT, path=path)

    assert record(Shared(), loop, LAW, **SHORT, path=path).sizes["trial"] == 3
    assert other.time == 0
