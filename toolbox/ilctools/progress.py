"""Progress bars on stderr: at once in a terminal, after a few seconds in a notebook.

If stderr is a file, no bar is shown. A saved notebook keeps the bars that it has shown, unless the
environment variable TQDM_DISABLE is set. `make test` sets this variable.
"""

import os
import sys
from contextlib import contextmanager
from threading import Event, Thread

from tqdm import tqdm

PATIENCE = 5  # s, after which a user wonders whether the call still runs


def progress(**options) -> tqdm:
    """Make a progress bar with the options of tqdm."""
    where = {"disable": None}  # a bar is shown only in a terminal
    if type(sys.stderr).__module__.startswith("ipykernel"):
        off = "TQDM_DISABLE" in os.environ
        where = {"delay": PATIENCE, "leave": False, "disable": off}
    return tqdm(**where | options)


@contextmanager
def watched(name: str):
    """If the function `name` takes more than some seconds, show how long it has been running."""
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
