"""A log is gone on with, by the same experiment only, from a first signal and for references."""

import subprocess
import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest
from plants import RestartingModel, boiler, bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    record,
    rms,
    run_trials,
    save_log,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.logs.replay import replay
from rodlib import paper_loop
from rodlib.paper.repository import ROOT
from rodlib.rigs import RestartingRig, RigParameters, VirtualRig

LAW = Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter(0.4 * np.eye(2)[..., None], 1.0))
SHORT = {"reference": bump(25, [0.5, 0.2]), "trials": 3, "pause": 2}
BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])
BOILER_LAW = Law(zero_phase_butterworth(2, 0.5, 0.5), replace(LAW.L, Ts=0.5), rest=4)
R = bump(80, [2.0, 1.0])


class Interrupted(RestartingRig):
    """Somebody stops it after so many samples; noise depends on the trial alone."""

    def __init__(self, samples=np.inf):
        super().__init__(parameters=RigParameters(modes=10))
        self.samples = samples

    def read(self):
        self.samples -= 1
        if self.samples < 0:
            raise KeyboardInterrupt
        return super().read()


def test_an_interrupted_experiment_goes_on_as_if_nothing_had_been(loop, tmp_path):
    """What is on disk are the trials that had ended; the rest comes out the same, bit for bit."""
    whole = record(Interrupted(), loop, LAW, **SHORT, path=tmp_path / "whole.csv")
    for samples in (3, 26, 52, 78):  # a trial has 25, the pause before it 2
        path, ended = tmp_path / f"{samples}.csv", (samples + 2) // 27
        with pytest.raises(KeyboardInterrupt):
            record(Interrupted(samples), loop, LAW, **SHORT, path=path)
        assert path.exists() == (ended > 0)
        if ended:
            log = load_log(path)
            assert log.identical(whole.isel(trial=slice(ended)))
            save_log(log.assign_attrs(operator="Ada"), path)
        finished = record(Interrupted(), loop, LAW, **SHORT, path=path)
        assert finished.attrs.pop("operator", "Ada") == "Ada"
        assert finished.identical(whole)


def test_an_experiment_that_has_ended_leaves_rig_and_log_alone(loop, tmp_path):
    path, device = tmp_path / "log.csv", VirtualRig()
    log = record(device, loop, LAW, **SHORT, path=path)
    content, time = path.read_bytes(), device.time
    assert record(device, loop, LAW, **SHORT, path=path).identical(log)
    with pytest.warns(UserWarning, match="has 3 trials, more than trials = 2"):
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


WAITING = """
import sys
from ilctools import Law, record, zero_phase_butterworth
from rodlib import paper_loop
from rodlib.rigs import RestartingRig
import numpy as np

class Waiting(RestartingRig):
    def begin(self, trial):
        print("began", flush=True)
        sys.stdin.read()

law = Law(zero_phase_butterworth(2, 0.1, 1.0), None)
record(Waiting(), paper_loop(), law, np.ones((9, 2)), path=sys.argv[1])
"""


def test_two_processes_do_not_record_to_one_log(loop, tmp_path):
    """The second is refused before anything is applied; not so after the first was killed."""
    path, device = tmp_path / "log.csv", VirtualRig()
    first, pipe = [sys.executable, "-c", WAITING, path], subprocess.PIPE
    with subprocess.Popen(first, stdin=pipe, stdout=pipe, cwd=ROOT) as process:
        assert process.stdout.readline() == b"began\n"
        with pytest.raises(RuntimeError, match=r"path = .*recorded to by another"):
            record(device, loop, LAW, **SHORT, path=path)
        process.kill()
    assert device.time == 0 and not path.exists()
    record(device, loop, LAW, **SHORT | {"trials": 1}, path=path)
    assert path.exists()


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
    unlearned = Law(BOILER_LAW.Q, None)
    log = record(RestartingModel(boiler()), BOILER, unlearned, R, trials=2, v=v)
    np.testing.assert_array_equal(log.v, [v, v])


def test_each_trial_follows_a_reference_of_its_own(tmp_path):
    references, path = np.array([R, 2 * R, -R]), tmp_path / "log.csv"
    run = run_trials(BOILER, BOILER_LAW, references, trials=3)
    trials = RestartingModel(boiler()), BOILER, BOILER_LAW
    record(*trials, references[:2], trials=2, path=path)
    log = record(*trials, references, trials=3, path=path)
    for name in ("reference", "v", "y", "e"):
        np.testing.assert_allclose(log[name], run[name], atol=1e-9)
    np.testing.assert_allclose(replay(load_log(path)).simulated.y, run.y, atol=1e-9)


def stronger(gain):
    model = boiler()
    names = {"inputs": model.input_labels, "outputs": model.output_labels}
    return control.ss(model.A, gain * model.B, model.C, model.D, model.dt, **names)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("loop", [BOILER, ClosedLoop(BOILER.P)], ids=["ours", "not"])
def test_a_log_that_goes_on_with_another_plant_is_noticed(loop, noise, tmp_path):
    """The notes of the log are the same; its last trials are what the next one contradicts."""
    law = Law(BOILER_LAW.Q, synthesise(loop, BOILER_LAW.Q).filter)

    def rig(gain):
        own = loop is BOILER
        other = BOILER.around(stronger(gain))[:, :2] if not own else stronger(gain)
        inputs = None if own else loop.commands
        return RestartingModel(other, inputs, noise=noise)

    for gain in (1.0, 1.5):
        case = loop, law, R
        path = tmp_path / f"{gain}.csv"
        with warnings.catch_warnings(action="error"):
            record(rig(1.0), *case, trials=3, path=path)
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            log = record(rig(gain), *case, trials=4, path=path)
        size = rms(log.e).values
        messages = [str(warning.message) for warning in seen]
        if gain == 1:
            assert not messages
        else:
            assert size[-1] > 1.5 * size[-2]
            assert "after trial 4: its error is off by" in messages[0]
            assert "from what follows from the last trial of the log" in messages[0]
