"""The rig is left safe and the log whole, whatever happens."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import ilctools
from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    load_law,
    load_log,
    multisine,
    read_table,
    record,
    save_log,
    shake,
    zero_phase_butterworth,
)
from ilctools.errors import RigError
from ilctools.files import write_whole

LOOP = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
LAW = Law(zero_phase_butterworth(2, 60.0, 0.01), LearningFilter([[[0.5]]], 0.01))
REFERENCE = np.sin(np.pi * np.arange(200) / 200) ** 2


@pytest.fixture(autouse=True, scope="module")
def foreground():
    """Whoever runs tests in the background may have them ignore signals."""
    usual = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}
    numbers = {getattr(signal, name): usual[name] for name in usual if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) for number, handler in numbers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Axis:
    """Follows slowly."""

    x = 0.0

    def read(self):
        return [self.x]

    def apply(self, w):
        self.x += 0.2 * (w[0] - self.x)


UNSAFE = "THE RIG MAY NOT BE SAFE: what should leave it safe has failed"
HEATED = """
import gc, os, sys, threading, time
import numpy as np
from ilctools import ClosedLoop, Law, record, zero_phase_butterworth

LAW = Law(zero_phase_butterworth(2, 9.0, 0.01), None)

class Heater:
    def read(self):
        if way == "fork":
            if not os.fork():
                sys.exit()
            os.wait()
        return [0.0]
    def apply(self, w):
        print(*w, flush=True)
        time.sleep(0.01)
    def safe(self):
        print("leaving", flush=True)
        time.sleep(0.5)
        print("safe", flush=True)

def run():
    record(Heater(), ClosedLoop(Ts=0.01, outputs=["T"]), LAW, np.ones(1_000), trials=1)

gc.freeze()  # or a child would collect all that was imported when it ends
for way in sys.argv[1:]:  # each in a process of its own, which need not import anything
    if not os.fork():
        break
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
else:
    sys.exit()
print(os.getpid(), flush=True)
if way == "thread":
    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join()
run()
"""
WAYS = {"SIGTERM": 128 + 15, "SIGHUP": 128 + 1, "SIGINT": -2, "thread": -2, "fork": -2}


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_signal_leaves_the_rig_safe_and_a_second_one_does_not_cut_that_short():
    """Also where another thread runs it; and no child that the driver forks leaves the rig safe."""
    call = [sys.executable, "-c", HEATED, *WAYS]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    folder, seen = Path(ilctools.__path__[0]).parent, dict.fromkeys(WAYS, "")
    with subprocess.Popen(call, **options, cwd=folder) as parent:
        line = parent.stdout.readline
        for way in WAYS:
            child = int(line())
            assert line() == "1.0\n"
            os.kill(child, getattr(signal, way, signal.SIGINT))
            while not re.fullmatch(r"-?\d+\n", text := line()):
                seen[way] += text.replace("1.0\n", "")
                if text == "leaving\n" and way != "thread":
                    os.kill(child, signal.SIGTERM)
            seen[way] += text
    assert seen == {way: f"leaving\nsafe\n{code}\n" for way, code in WAYS.items()}


@pytest.mark.parametrize("call", [1, 2, 3, 404])
@pytest.mark.parametrize(("safe_time", "noted"), [(10.0, 2), (0.2, 1)])
def test_no_command_follows_a_signal_and_a_safe_that_hangs_is_ended(call, safe_time, noted, capfd):
    """Whatever the driver swallows, and though asyncio handles Ctrl-C."""
    calls = []

    def deaf(*command):
        calls.append(command)
        with suppress(BaseException):
            if len(calls) == call:
                signal.raise_signal(signal.SIGINT)
        return [0.0]

    def safe():
        for _ in range(2):
            signal.raise_signal(signal.SIGTERM)
            time.sleep(0.3)
        calls.append("safe")

    async def run():
        rig = {"read": deaf, "apply": deaf, "begin": deaf, "safe": safe, "safe_time": safe_time}
        record(SimpleNamespace(**rig), LOOP, LAW, REFERENCE)

    with pytest.raises(KeyboardInterrupt) as error:
        asyncio.run(run())
    assert capfd.readouterr().err.count("wait: the rig is being left safe") == noted
    assert [command for command in calls[call:] if command] == ["safe"] * (noted - 1)
    assert getattr(error.value, "__notes__", []) == [UNSAFE] * (2 - noted)


def in_thread(run):
    """What a call returns in a thread, or the error that it raises there."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(run).result()


def test_another_thread_than_the_main_one_has_the_same_trials_and_the_same_errors():
    """Where no handler of signals can be set, none was replaced."""
    trials = partial(record, loop=LOOP, law=LAW, reference=REFERENCE, trials=3)
    shaken = partial(shake, loop=LOOP, excitation=multisine(LOOP, 5.0, 50.0, 1.0, 0.02))
    for run in (trials, shaken):
        there = in_thread(lambda run=run: run(Axis()))
        assert there.identical(run(Axis())) and there.sizes["trial"] > 1
        broken = Axis()
        broken.apply = lambda w: (_ for _ in ()).throw(RuntimeError("usb gone"))
        broken.safe = partial(setattr, broken, "x", -1.0)
        with pytest.raises(RuntimeError, match="usb gone") as error:
            in_thread(lambda run=run, rig=broken: run(rig))
        assert error.value.__context__ is None and broken.x == -1


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("fails", [False, True])
def test_handlers_are_back_after_a_run_and_those_of_others_are_not_touched(fails, monkeypatch):
    """`getsignal` gives a handler that C code has installed as None."""
    numbers, known, during = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], signal.getsignal, []
    axis, own = Axis(), lambda *arguments: None
    axis.read = lambda: [np.nan if fails else 0.0]
    axis.safe = lambda: during.extend(map(known, numbers))
    monkeypatch.setattr(signal, "getsignal", lambda n: None if n == signal.SIGHUP else known(n))
    usual = signal.signal(signal.SIGTERM, own)
    try:
        before = [*map(known, numbers)]
        with suppress(RigError):
            record(axis, LOOP, LAW, REFERENCE, trials=1)
        assert [*map(known, numbers)] == before
        assert during[1:] == before[1:] and during[0] != before[0]
    finally:
        signal.signal(signal.SIGTERM, usual)


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
    axis, files = Axis(), set()

    def read():
        files.update(path.stat().st_ino for path in tmp_path.glob(name))
        return [axis.x]

    axis.read, axis.begin = read, lambda trial: os.chdir(other)
    log = record(axis, LOOP, LAW, REFERENCE, trials=5, reset=reset, path="log.csv")
    save_log(log, whole)
    assert len(files) == 1 and not os.listdir(other) and file.read_bytes() == whole.read_bytes()
    assert (tmp_path / "log.csv").is_symlink() == (name != "log.csv")


def test_a_torn_trial_is_left_out_and_the_experiment_goes_on(tmp_path):
    path, whole = tmp_path / "log.csv", tmp_path / "whole.csv"

    class Homed(Axis):
        def begin(self, trial):
            self.x = 0.0

    complete = record(Homed(), LOOP, LAW, REFERENCE, trials=3, path=whole)
    text = whole.read_bytes()
    for cut in (1, 2, 40, 2000):  # the line feed alone; a digit, too, which nothing shows
        path.write_bytes(text[:-cut])
        with pytest.warns(UserWarning, match=r"log.csv: the last trial is shorter"):
            assert load_log(path).identical(complete.isel(trial=slice(2)))
        with pytest.warns(UserWarning, match=r"log.csv: the last trial is shorter"):
            record(Homed(), LOOP, LAW, REFERENCE, trials=3, path=path)
        assert path.read_bytes() == text


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
    two = record(Axis(), LOOP, LAW, REFERENCE, trials=2, reset=False, path=whole)
    axis.safe = lambda: setattr(axis, "x", -1.0)
    room(whole.stat().st_size + 1000)  # bytes, in which there is room for a part of a trial
    with pytest.raises(OSError, match="File too large") as error:
        record(axis, LOOP, LAW, REFERENCE, trials=trials, reset=False, path=path)
    assert axis.x == -1 and load_log(path).identical(two)
    assert path.read_bytes() == whole.read_bytes()
    assert error.value.trials.sizes["trial"] > 2


def test_a_log_that_another_program_writes_during_a_trial_is_left_alone(tmp_path):
    path, axis = tmp_path / "log.csv", Axis()
    axis.begin = lambda trial: path.write_text("theirs") if trial == 3 else None
    with pytest.raises(FileExistsError, match="changed by another program") as error:
        record(axis, LOOP, LAW, REFERENCE, path=path)
    assert path.read_text() == "theirs" and error.value.trials.sizes["trial"] == 3


def test_a_complete_log_in_a_folder_that_is_read_only_is_returned(tmp_path, monkeypatch):
    path, axis = tmp_path / "log.csv", Axis()
    log = record(axis, LOOP, LAW, REFERENCE, trials=2, path=path)
    (tmp_path / ".log.csv.lock").unlink()
    begun, x = partial(record, axis, LOOP, LAW, REFERENCE, path=path), axis.x
    monkeypatch.setattr(os, "access", lambda folder, mode: (folder, mode) != (tmp_path, os.W_OK))
    for trials in (1, 2):
        assert begun(trials=trials).identical(log)
    with pytest.raises(PermissionError, match=r"log\.csv' cannot be .* but 3 of 5 trials are"):
        begun(trials=5)
    assert axis.x == x and os.listdir(tmp_path) == ["log.csv"]


def test_a_reading_of_one_output_may_be_a_number_and_of_several_may_not():
    """As `law.next` takes signals of one channel without an axis for it, but not of several."""
    plain, listed = Axis(), record(Axis(), LOOP, LAW, REFERENCE, trials=3)
    for number in (float, np.float64, lambda x: np.array([x])[0], np.array):
        plain.x, plain.read = 0.0, lambda number=number: number(plain.x)
        assert record(plain, LOOP, LAW, REFERENCE, trials=3).identical(listed)
    v, e = (listed[name].values[0] for name in ("v", "e"))
    assert np.array_equal(LAW.next(v[:, 0], e[:, 0]), LAW.next(v, e)[:, 0])
    two = ClosedLoop(Ts=0.01, outputs=["x", "y"])
    law = Law(LAW.Q, LearningFilter(0.5 * np.eye(2)[..., None], 0.01))
    with pytest.raises(RigError, match=r"reading of x, y has shape \(\), but must have shape \(2,"):
        record(plain, two, law, np.ones((200, 2)))
    with pytest.raises(ValueError, match=r"v has shape \(200,\), but must have shape"):
        law.next(v[:, 0], e[:, 0])


NO_READINGS = [[np.nan], np.nan, [0.0, 0.0], None, "0.0"]


@pytest.mark.parametrize(
    ("method", "bad", "name"),
    [*(("read", bad, "reading of x") for bad in NO_READINGS), ("clock", np.nan, "clock")],
)
def test_an_error_of_a_reading_says_in_which_trial_and_sample(method, bad, name):
    """In its text, which a log of a service has without notes."""
    axis, good = Axis(), iter([[0.0]] * 206 if method == "read" else np.arange(206) * 0.01)
    setattr(axis, method, lambda: next(good, bad))
    with pytest.raises(RigError) as error:
        record(axis, LOOP, LAW, REFERENCE, pause=0)
    assert str(error.value).startswith(f"trial 2, sample 7: {name} ")


def test_what_is_no_regular_file_is_refused_before_anything_waits_for_its_end(tmp_path):
    log, pipe = tmp_path / "log.csv", tmp_path / "pipe"
    record(Axis(), LOOP, LAW, REFERENCE, trials=1, path=log)
    os.mkfifo(pipe)
    # a writer, so that who does read it is not left waiting
    file = os.open(pipe, os.O_RDWR)
    os.write(file, b"a")
    threading.Timer(5, os.close, [file]).start()
    axis, link, names = Axis(), tmp_path / "link", {*os.listdir(tmp_path), "link"}
    link.symlink_to("/dev/full")
    for path in (pipe, tmp_path, link):
        for read in (load_log, load_law, partial(read_table, Ts=1.0, outputs={"y": 0})):
            with pytest.raises(ValueError, match="no regular file"):
                read(path)
        for write in (partial(record, axis, LOOP, LAW, REFERENCE), partial(write_whole, text="")):
            with pytest.raises(FileExistsError, match="is no regular file"):
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
