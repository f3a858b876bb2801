"""Trials are kept when they end; an experiment goes on with its log, and no other one does."""

import os
from dataclasses import replace
from functools import partial
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from plants import TASK, Axis, HomedAxis

from ilctools import load_log, record, save_log
from ilctools.errors import RigError, StoppedError

THREE = TASK | {"trials": 3}
SAMPLES = len(TASK["reference"])


def failing(sample, shown, **more):
    """An axis that shows something else in one sample, counted from 0, or raises it."""
    axis, number = HomedAxis(sent=[], **more), count()

    def read():
        if next(number) != sample:
            return [axis.x]
        if isinstance(shown, BaseException):
            raise shown
        return shown

    def apply(w):
        axis.sent.append(w[0])
        HomedAxis.apply(axis, w)

    axis.read, axis.apply = read, apply
    return axis


@pytest.mark.parametrize("shown", [[1e6], OSError("unplugged"), KeyboardInterrupt()])
def test_after_a_failure_the_rig_is_safe_its_trials_are_kept_and_the_next_call_goes_on(
    shown, tmp_path
):
    """What is shown then reaches no actuator. What somebody adds to the notes of the log stays."""
    path, whole = tmp_path / "log.csv", record(HomedAxis(), **THREE)
    for sample in (3, SAMPLES + 12, 2 * SAMPLES):
        ended = sample // SAMPLES
        kind = type(shown) if isinstance(shown, BaseException) else RigError
        axis = failing(sample, shown)
        with pytest.raises(kind) as error:
            record(axis, **THREE, path=path)
        assert len(axis.sent) == sample + 1 and axis.sent[-1] == 0
        assert np.isfinite(axis.sent).all() and path.exists() == (ended > 0)
        if kind is not KeyboardInterrupt:
            place = f"in trial {ended + 1}, sample {sample % SAMPLES + 1}. After it, only"
            note = error.value.__notes__[-1]
            assert place in note and str(path) in note
        if ended:
            log = load_log(path)
            assert log.identical(whole.isel(trial=slice(ended)))
            assert kind is KeyboardInterrupt or error.value.trials.identical(log)
            save_log(log.assign_attrs(operator="Ada"), path)
        finished = record(HomedAxis(), **THREE, path=path)
        assert finished.attrs.pop("operator", "") == ("Ada" if ended else "")
        assert finished.identical(whole)
        path.unlink()


def test_limits_of_stop_may_be_wider_or_narrower():
    knocked = partial(failing, SAMPLES + 7, [9.0])
    with pytest.raises(StoppedError, match=r"(?s)x = 9 .*in trial 2, sample 8"):
        record(knocked(), **THREE)
    with pytest.warns(UserWarning, match="after trial 2: the error grows"):
        assert record(knocked(), **THREE, stop={"x": None}).sizes["trial"] == 3
    with pytest.raises(StoppedError, match=r"(?s)x = .* is not from -1 to 0.5, .*in trial 1, "):
        record(HomedAxis(), **THREE, stop={"x": (-1.0, 0.5)})


def test_an_experiment_that_has_ended_leaves_rig_and_log_alone(tmp_path):
    path, axis = tmp_path / "log.csv", HomedAxis()
    log = record(axis, **THREE, path=path)
    content, x = path.read_bytes(), axis.x
    for trials in (2, 3):
        assert record(axis, **THREE | {"trials": trials}, path=path).identical(log)
        assert path.read_bytes() == content and axis.x == x
    more = record(axis, **THREE | {"trials": 4}, path=path)
    assert more.isel(trial=slice(3)).identical(log) and load_log(path).identical(more)
    save_log(log.isel(trial=[0, 2]), path)
    with pytest.raises(ValueError, match="numbers"):
        record(axis, **THREE, path=path)


def test_a_complete_log_in_a_folder_that_is_read_only_is_returned(tmp_path, monkeypatch):
    path, axis = tmp_path / "log.csv", Axis()
    log = record(axis, **TASK, trials=2, path=path)
    (tmp_path / ".log.csv.lock").unlink()
    begun, x = partial(record, axis, **TASK, path=path), axis.x
    monkeypatch.setattr(os, "access", lambda folder, mode: (folder, mode) != (tmp_path, os.W_OK))
    assert begun(trials=2).identical(log)
    with pytest.raises(PermissionError, match=r"log\.csv' cannot be .* but 3 of 5 trials are"):
        begun(trials=5)
    assert axis.x == x and os.listdir(tmp_path) == ["log.csv"]


def test_a_torn_trial_is_left_out_and_the_experiment_goes_on(tmp_path):
    path = tmp_path / "log.csv"
    complete = record(HomedAxis(), **THREE, path=path)
    text = path.read_bytes()
    for cut in (1, 2000):  # the line feed alone; many rows
        path.write_bytes(text[:-cut])
        with pytest.warns(UserWarning, match=r"log.csv: the last trial is shorter"):
            assert load_log(path).identical(complete.isel(trial=slice(2)))
        with pytest.warns(UserWarning, match=r"log.csv: the last trial is shorter"):
            record(HomedAxis(), **THREE, path=path)
        assert path.read_bytes() == text


LAW = TASK["law"]


@pytest.mark.parametrize(
    ("changes", "differing"),
    [
        ({"reference": TASK["reference"] + 1}, "reference"),
        ({"law": replace(LAW, L=None)}, "L"),
        ({"law": replace(LAW, limits={})}, "actuators"),
        ({"rig": SimpleNamespace(read=len, apply=len)}, "actuators, disturbances"),
        ({"loop": replace(TASK["loop"], units={"x": "m"})}, "loop, disturbances"),
        ({"v": TASK["reference"]}, "v of trial 1"),
    ],
)
def test_another_experiment_does_not_go_on_with_the_log(changes, differing, tmp_path):
    path = tmp_path / "log.csv"
    axis = HomedAxis(limits={"w1": (-9, 9)}, measured={"wind": 0.0})
    task = THREE | {"rig": axis, "path": path}
    task["loop"] = replace(TASK["loop"], disturbances=["wind"])
    record(**task | {"trials": 1})
    content, x = path.read_bytes(), axis.x
    with pytest.raises(ValueError, match=f"another experiment, which differs in {differing}:"):
        record(**task | changes)
    assert path.read_bytes() == content and axis.x == x


def test_two_do_not_record_to_one_log(tmp_path):
    """The second is refused before anything is applied, in each trial of the first."""
    path, other = tmp_path / "log.csv", Axis()

    def begin(trial):
        with pytest.raises(RuntimeError, match=r"another process records to path"):
            record(other, **THREE, path=path)

    assert record(Axis(begin=begin), **THREE, path=path).sizes["trial"] == 3
    assert other.x == 0
