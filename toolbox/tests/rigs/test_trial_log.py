"""The file of an experiment: each trial is added, and what others wrote is left alone."""

from concurrent.futures import Future

import numpy as np
import pytest
from plants import LOOPS, RestartingModel, bump

from ilctools import Law, LearningFilter, load_log, record, save_log, zero_phase_butterworth
from ilctools.rigs.trial_log import TrialLog, Writer
from ilctools.trials.parts import parts_of

TANKS = LOOPS["tanks"]()
LAW = Law(zero_phase_butterworth(2, 0.4, TANKS.Ts), LearningFilter(np.eye(3)[..., None], TANKS.Ts))


@pytest.fixture(scope="module")
def log():
    rig = RestartingModel(TANKS.plant, TANKS.commands)
    return record(rig, TANKS, LAW, bump(30, [1.0, 2.0, 3.0]), trials=4, decimals={"delta": 3})


@pytest.mark.parametrize("there", [0, 2])
def test_trials_that_are_added_make_the_file_that_is_written_whole(log, there, tmp_path):
    path, whole = tmp_path / "log.csv", tmp_path / "whole.csv"
    file, trials = TrialLog(path), parts_of(log)
    if there:
        file.replace(log.isel(trial=slice(there)))
    for k in range(there, 4):
        file.add(log.isel(trial=slice(k + 1)), trials[k])
    save_log(log, whole)
    assert path.read_bytes() == whole.read_bytes() and load_log(path).identical(log)


@pytest.mark.parametrize("change", [b"", b"theirs", None])
def test_what_another_program_wrote_is_left_alone(log, change, tmp_path):
    path = tmp_path / "log.csv"
    file, trials = TrialLog(path), parts_of(log)
    file.add(log.isel(trial=[0]), trials[0])
    path.write_bytes(path.read_bytes() + b"\n" if change is None else change)
    content = path.read_bytes()
    with pytest.raises(FileExistsError, match="was changed by another program during a trial"):
        file.add(log.isel(trial=slice(2)), trials[1])
    assert path.read_bytes() == content


class Later:
    """A thread that does what it is given when it is asked to."""

    def __init__(self):
        self.given = []

    def submit(self, function, *arguments):
        future = Future()
        self.given.append((future, function, arguments))
        return future

    def work(self):
        future, function, arguments = self.given.pop()
        try:
            future.set_result(function(*arguments))
        except OSError as error:
            future.set_exception(error)


def test_an_error_of_a_file_comes_with_the_next_trial_or_at_the_end(log, tmp_path):
    thread, file = Later(), TrialLog(tmp_path / "no folder" / "log.csv")
    writer = Writer(file, thread, waits=False)
    writer.finish()  # of nothing
    writer.add(log.isel(trial=[0]), parts_of(log)[0])
    thread.work()
    for late in (writer.finish, lambda: writer.add(log, parts_of(log)[1])):
        with pytest.raises(FileNotFoundError):
            late()
    assert not thread.given


def test_without_a_file_nothing_is_written(log):
    thread = Later()
    Writer(None, thread, waits=True).add(log, {})
    assert not thread.given
