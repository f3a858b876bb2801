"""A sign of life: what runs for long says so."""

import sys
from io import StringIO
from time import sleep

import pytest

from ilctools import progress
from ilctools.threads import on_one_thread


@on_one_thread
def slow(seconds):
    sleep(seconds)


@pytest.mark.parametrize(
    ("home", "seconds", "off", "said"),
    [("ipykernel.iostream", 1.0, False, True), ("ipykernel.iostream", 0.4, True, False),
     ("io", 0.4, False, False)],
)  # fmt: skip
def test_what_takes_long_says_so(monkeypatch, home, seconds, off, said):
    """In a notebook, where it is not switched off."""
    shown = type("Stream", (StringIO,), {"__module__": home})()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(progress, "PATIENCE", 0.1)
    monkeypatch.setattr(progress.os, "environ", {"TQDM_DISABLE": "1"} if off else {})
    slow(seconds)
    assert ("\rslow, 00:0" in shown.getvalue()) == said
