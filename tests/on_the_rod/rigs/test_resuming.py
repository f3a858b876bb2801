"""A log is gone on with, by the same experiment only, from a first signal and for references."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plants import RestartingModel, boiler, bump
from rods import Failing

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    record,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.logs.replay import replay
from rodlib import paper_loop
from rodlib.rigs import VirtualRig

LAW = Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter(0.4 * np.eye(2)[..., None], 1.0))
SHORT = {"reference": bump(25, [0.5, 0.2]), "trials": 3, "pause": 2}
BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])
BOILER_LAW = Law(zero_phase_butterworth(2, 0.5, 0.5), replace(LAW.L, Ts=0.5), rest=4)
R = bump(80, [2.0, 1.0])


def test_an_interrupted_experiment_goes_on_as_if_nothing_had_been(loop, tmp_path):
    """What is on disk are the trials that had ended; the rest comes out the same, bit for bit."""
    whole = record(Failing(), loop, LAW, **SHORT, path=tmp_path / "whole.csv")
    for samples in (3, 26, 52, 78):  # a trial has 25, the pause before it 2
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


def test_the_first_trial_begins_with_what_was_learned_elsewhere(tmp_path):
    v, path = 0.1 * R + 1e-9 / 3, tmp_path / "log.csv"
    trials = {"loop": BOILER, "law": BOILER_LAW, "reference": R, "v": v, "path": path}
    trials["decimals"] = {"v": 6}
    log = record(RestartingModel(boiler()), trials=2, **trials)
    run = run_trials(BOILER, BOILER_LAW, R, trials=2, v=v)
    np.testing.assert_allclose(log.y, run.y, atol=1e-5)
    more = record(RestartingModel(boiler()), trials=3, **trials)
    assert more.isel(trial=slice(2)).identical(log)
    replayed = replay(load_log(path))
    assert replayed.departure.loc[1].isna().all()
    assert replayed.departure.loc[2:].to_numpy().max() < 1e-6
    np.testing.assert_allclose(replayed.simulated.y, more.y, atol=1e-5)
