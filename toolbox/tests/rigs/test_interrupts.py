"""The rig is left safe, whatever signal comes and whenever."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from plants import TASK, Axis, HomedAxis

import ilctools
from ilctools import record
from ilctools.errors import RigError


@pytest.fixture(autouse=True, scope="module")
def foreground():
    """Whoever runs tests in the background may have them ignore signals."""
    usual = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}
    numbers = {getattr(signal, name): usual[name] for name in usual if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) for number, handler in numbers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


UNSAFE = "THE RIG MAY NOT BE SAFE: the call that should leave it safe has failed"
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


@pytest.mark.parametrize(
    ("call", "safe_time", "takes", "noted"),
    [*((call, 10.0, 0.0, 2) for call in (1, 2, 3, 404)), (2, 0.2, 0.3, 1)],
)
def test_no_command_follows_a_signal_and_a_safe_that_hangs_is_ended(
    call, safe_time, takes, noted, capfd
):
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
            time.sleep(takes)
        calls.append("safe")

    async def run():
        rig = {"read": deaf, "apply": deaf, "begin": deaf, "safe": safe, "safe_time": safe_time}
        record(SimpleNamespace(**rig), **TASK)

    with pytest.raises(KeyboardInterrupt) as error:
        asyncio.run(run())
    assert capfd.readouterr().err.count("wait: the rig is being left safe") == noted
    assert [command for command in calls[call:] if command] == ["safe"] * (noted - 1)
    assert getattr(error.value, "__notes__", []) == [UNSAFE] * (2 - noted)


def in_thread(rig):
    """The trials that are recorded in a thread, or the error that is raised there."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(record, rig, **TASK).result()


def test_another_thread_than_the_main_one_has_the_same_trials_and_the_same_errors():
    """Where no handler of signals can be set, none was replaced."""
    assert in_thread(HomedAxis()).identical(record(HomedAxis(), **TASK))
    broken = Axis(apply=lambda w: os.stat("usb gone"))
    broken.safe = partial(setattr, broken, "x", -1.0)
    with pytest.raises(OSError, match="usb gone") as error:
        in_thread(broken)
    assert error.value.__context__ is None and broken.x == -1


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("fails", [False, True])
def test_handlers_are_back_after_a_run_and_those_of_others_are_not_touched(fails, monkeypatch):
    """`getsignal` gives a handler that C code has installed as None."""
    numbers, known, during = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], signal.getsignal, []
    own, shown = lambda *arguments: None, [np.nan if fails else 0.0]
    axis = Axis(read=lambda: shown, safe=lambda: during.extend(map(known, numbers)))
    monkeypatch.setattr(signal, "getsignal", lambda n: None if n == signal.SIGHUP else known(n))
    usual = signal.signal(signal.SIGTERM, own)
    try:
        before = [*map(known, numbers)]
        with suppress(RigError):
            record(axis, **TASK, trials=1)
        assert [*map(known, numbers)] == before
        assert during[1:] == before[1:] and during[0] != before[0]
    finally:
        signal.signal(signal.SIGTERM, usual)
