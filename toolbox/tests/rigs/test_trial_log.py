"""The log is whole, whatever happens: to its disk, by other programs, or where its path leads."""

import os
import threading
from functools import partial
from pathlib import Path

import pytest
from plants import TASK, Axis

from ilctools import load_law, load_log, read_table, record, save_log
from ilctools.files import write_whole


@pytest.mark.parametrize(("reset", "name"), [(True, "linked.csv"), (False, "log.csv")])
def test_trials_are_added_to_the_log_as_if_it_were_written_whole(
    tmp_path, monkeypatch, reset, name
):
    """The file, also one to which a link leads, is replaced once, wherever the driver goes."""
    file, whole, other = tmp_path / name, tmp_path / "whole.csv", tmp_path / "other"
    other.mkdir()
    monkeypatch.chdir(tmp_path)
    if name != "log.csv":
        Path("log.csv").symlink_to(file)
    files = set()

    class Wandering(Axis):
        def begin(self, trial):
            os.chdir(other)

        def read(self):
            files.update(path.stat().st_ino for path in tmp_path.glob(name))
            return super().read()

    log = record(Wandering(), **TASK, trials=5, reset=reset, path="log.csv")
    save_log(log, whole)
    assert len(files) == 1 and not os.listdir(other) and file.read_bytes() == whole.read_bytes()
    assert (tmp_path / "log.csv").is_symlink() == (name != "log.csv")


@pytest.fixture
def room():
    """A function that leaves so many bytes of room in any file, as a disk that gets full."""
    resource = pytest.importorskip("resource", reason="no limits of files here")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("trials", [3, 5])
def test_a_full_disk_costs_the_trial_that_it_has_no_room_for(trials, tmp_path, room):
    path, whole, axis = tmp_path / "log.csv", tmp_path / "whole.csv", Axis()
    two = record(Axis(), **TASK, trials=2, reset=False, path=whole)
    axis.safe = lambda: setattr(axis, "x", -1.0)
    room(whole.stat().st_size + 1000)  # bytes, in which there is room for a part of a trial
    with pytest.raises(OSError, match="File too large") as error:
        record(axis, **TASK, trials=trials, reset=False, path=path)
    assert axis.x == -1 and load_log(path).identical(two)
    assert path.read_bytes() == whole.read_bytes()
    assert error.value.trials.sizes["trial"] > 2


def test_a_log_that_another_program_writes_during_a_trial_is_left_alone(tmp_path):
    path, axis = tmp_path / "log.csv", Axis()
    axis.begin = lambda trial: path.write_text("theirs") if trial == 3 else None
    with pytest.raises(FileExistsError, match="another program changed") as error:
        record(axis, **TASK, path=path)
    assert path.read_text() == "theirs" and error.value.trials.sizes["trial"] == 3


def test_what_is_no_regular_file_is_refused_before_anything_waits_for_its_end(tmp_path):
    log, pipe = tmp_path / "log.csv", tmp_path / "pipe"
    record(Axis(), **TASK, trials=1, path=log)
    os.mkfifo(pipe)
    # a writer, so that who does read it is not left waiting
    file = os.open(pipe, os.O_RDWR)
    os.write(file, b"a")
    threading.Timer(5, os.close, [file]).start()
    axis, link, names = Axis(), tmp_path / "link", {*os.listdir(tmp_path), "link"}
    link.symlink_to("/dev/full")
    for path in (pipe, tmp_path, link):
        for read in (load_log, load_law, partial(read_table, Ts=1.0, outputs={"y": 0})):
            with pytest.raises(ValueError, match="not a regular file"):
                read(path)
        for write in (partial(record, axis, **TASK), partial(write_whole, text="")):
            with pytest.raises(FileExistsError, match="is not a regular file"):
                write(path=path)
    assert {*os.listdir(tmp_path)} == names and axis.x == 0


def test_raw_data_are_not_written_over(tmp_path):
    raw, log = tmp_path / "raw.csv", tmp_path / "log.csv"
    raw.write_text("t,u,y\n0,1,0\n1,1,0.5\n2,1,0.75\n")
    table = read_table(raw, time="t", inputs={"u": "u"}, outputs={"y": "y"})
    with pytest.raises(ValueError, match=r"path = .*raw\.csv' is a file of another kind"):
        save_log(table, raw)
    log.touch()
    for _ in range(2):  # what is empty, or a log, is
        save_log(table, log)
    assert raw.read_text().startswith("t,u,y") and load_log(log).identical(table)
