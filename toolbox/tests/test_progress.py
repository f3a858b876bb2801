"""A sign of life: what runs for long says so, and where it is."""

import sys
import time
from io import StringIO

from ilctools import progress
from ilctools.threads import on_one_thread


def wait(seconds):
    time.sleep(seconds)


@on_one_thread
def slow(seconds=0.3):
    wait(seconds)


def test_what_takes_long_says_where_it_is_in_a_notebook(monkeypatch, capfd):
    """And in no other file."""
    monkeypatch.delenv("TQDM_DISABLE", raising=False)
    monkeypatch.setattr(progress, "PATIENCE", 0.1)
    monkeypatch.setattr(progress, "PACKAGE", __name__)
    slow()
    assert capfd.readouterr() == ("", "")
    shown = type("OutStream", (StringIO,), {"__module__": "ipykernel.iostream"})()
    monkeypatch.setattr(sys, "stderr", shown)
    slow(0.01)
    assert not shown.getvalue()
    slow()
    assert "\rslow, 0.1 s: wait" in shown.getvalue() and shown.getvalue().endswith(" \r")
    monkeypatch.setenv("TQDM_DISABLE", "1")
    assert progress.progress().disable
