"""The file of an experiment: its log, to which each trial is added when it ends."""

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path

import xarray as xr

from ilctools import arguments
from ilctools.files import alone, append, regular
from ilctools.logs.format import columns_of, rows_as_text, signals_of, write_log
from ilctools.trials.learn import Part


def log_path(path) -> Path:
    """Where a log is, or will be: the file itself, in a folder that exists."""
    # absolute, because a driver may change the working directory
    path = regular(arguments.path("path", path)).absolute()
    if not path.parent.is_dir():
        raise ValueError(f"path = '{path}' must be in a folder that exists")
    return path


def without_others(path: Path) -> AbstractContextManager:
    """Keep other processes from the log at `path`."""
    busy = f"path = '{path}' is recorded to by another process: wait, or give another"
    return alone(path.with_name(f".{path.name}.lock"), busy)


class TrialLog:
    """The log of one experiment as a file; what others write there meanwhile is left alone.

    A thread writes it, so that a rig that never rests need not wait; without a path nothing does.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self.size = None  # of the file, in bytes, as this experiment left it
        self.thread = ThreadPoolExecutor(1)
        self.last: Future | None = None  # what is written, or was

    def replace(self, log: xr.Dataset) -> None:
        """Write all trials, whatever is there."""
        write_log(log, self.path)
        self.size = self.path.stat().st_size

    def add(self, log: xr.Dataset, trial: Part) -> None:
        """Add the last trial of a log; first the error of the one before, if there was one."""
        self.finish()
        if self.path:
            self.last = self.thread.submit(self.write, log, trial)

    def finish(self) -> None:
        """Wait until all is written; raises the error of what was not."""
        if self.last:
            self.last.result()

    def write(self, log: xr.Dataset, trial: Part) -> None:
        """Add the last trial of a log to the file, or write all where there is none.

        By rows, because meanwhile the next trial may run.
        """
        if not self.path.exists():
            self.replace(log)
            return
        if self.path.stat().st_size != self.size:
            raise FileExistsError(
                f"path = '{self.path}' was changed by another program during a trial, and is left "
                "as it is: save the attribute trials of this error by save_log, at another path"
            )
        signals = [trial[name] for name in columns_of(signals_of(log), log)]
        append(self.path, rows_as_text(len(log.trial), log.time.values, signals))
        self.size = self.path.stat().st_size
