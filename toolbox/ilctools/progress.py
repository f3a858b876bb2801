"""Progress bars on stderr: in a terminal and, after a while, in a notebook, but in no other file.

A notebook keeps what it shows, unless the variable TQDM_DISABLE is set. `make test` sets this
variable.
"""

import os
import sys
from contextlib import contextmanager
from threading import Event, Thread

from tqdm import tqdm

PATIENCE = 5  # s, after which a user wonders


def progress(**options) -> tqdm:
    """Make a progress bar."""
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
