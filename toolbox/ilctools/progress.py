"""A sign of life, on stderr: in a terminal and, after a while, in a notebook; in no other file.

A notebook keeps what it shows, but where the variable TQDM_DISABLE is set: make test sets it.
"""

import os
import sys
from contextlib import contextmanager
from threading import Event, Thread

from tqdm import tqdm

PATIENCE = 5  # s, from which on one wonders


def progress(**options) -> tqdm:
    """A bar of what is counted."""
    where = {"disable": None}  # unless it is a terminal
    if type(sys.stderr).__module__.startswith("ipykernel"):
        off = "TQDM_DISABLE" in os.environ
        where = {"delay": PATIENCE, "leave": False, "disable": off}
    return tqdm(**where | options)


@contextmanager
def watched(name: str):
    """Show for how long the function of this name has been running."""
    ended = Event()

    def watch():
        with progress(
            bar_format="{desc}, {elapsed}", desc=name, delay=PATIENCE, leave=False
        ) as bar:
            wait = PATIENCE
            while not ended.wait(wait):
                bar.refresh()
                wait = 1

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
