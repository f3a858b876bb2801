"""A sign of life, on stderr: in a terminal and, after a while, in a notebook; in no other file.

A notebook keeps what it shows, but where the variable TQDM_DISABLE is set: make test sets it.
"""

import os
import sys
from contextlib import contextmanager
from itertools import count
from threading import Event, Thread, get_ident
from traceback import walk_stack

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
    """Show for how long the function of this name has been running, and where it is."""
    ended, thread = Event(), get_ident()

    def watch():
        if ended.wait(PATIENCE):
            return
        with progress(bar_format="{desc}", delay=0, leave=False) as shown:
            for seconds in count(PATIENCE):
                frames = walk_stack(sys._current_frames()[thread])
                names = " > ".join([frame.f_code.co_name for frame, _ in frames][::-1])
                where = names.partition(f"{name} > ")[2]  # nowhere, if it just ended
                shown.set_description_str(f"{name}, {seconds} s: {where}")
                if ended.wait(1):
                    return

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
