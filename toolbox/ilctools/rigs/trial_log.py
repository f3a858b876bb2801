"""The log file of an experiment, to which each trial is added when it ends."""

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path

import xarray as xr

from ilctools import arguments
from ilctools.files import alone, append, regular
from ilctools.logs.format import columns_of, rows_as_text, signals_of, write_log
from ilctools.trials.learn import Part


def log_path(path) -> Path:
    """Return the absolute path of a log file, in a folder that exists."""
    # absolute, because a driver may change the working directory
    path = regular(arguments.path("path", path)).absolute()
    if not path.parent.is_dir():
        raise ValueError(f"path = '{path}' must be in a folder that exists")
    return path


def without_others(path: Path) -> AbstractContextManager:
    """Lock the log at `path` against other processes that would record to it."""
    busy = (
        f"another process records to path = '{path}': wait until it has ended, or give another path"
    )
    return alone(path.with_name(f".{path.name}.lock"), busy)


class TrialLog:
    """The log of one experiment as a file.

    Changes that other programs make to the file are not overwritten.

    A thread writes the file, so that a rig whose trials follow without a pause need not wait. If no
    path is passed, nothing is written.
    """

    def __init__(self, path: Path | None):
        self.path = path
        self.size = None  # size of the file in bytes, as this experiment left it
        self.thread = ThreadPoolExecutor(1)
        self.last: Future | None = None  # the last write, running or done

    def replace(self, log: xr.Dataset) -> None:
        """Write all trials, whatever the file contains."""
        write_log(log, self.path)
        self.size = self.path.stat().st_size

    def add(self, log: xr.Dataset, trial: Part) -> None:
        """Add the last trial of a log.

        If the previous write failed, its error is raised first.
        """
        self.finish()
        if self.path:
            self.last = self.thread.submit(self.write, log, trial)

    def finish(self) -> None:
        """Wait until everything is written; raise the error of a write that failed."""
        if self.last:
            self.last.result()

    def write(self, log: xr.Dataset, trial: Part) -> None:
        """Add the last trial of a log to the file, or write all trials if there is no file.

        The trial is written row by row, because the next trial may run meanwhile.
        """
        if not self.path.exists():
            self.replace(log)
            return
        if self.path.stat().st_size != self.size:
            raise FileExistsError(
                f"another program changed path = '{self.path}' during a trial, and the file is "
                "left as it is: save the attribute trials of this error by save_log, at another "
                "path"
            )
        signals = [trial[name] for name in columns_of(signals_of(log), log)]
        append(self.path, rows_as_text(len(log.trial), log.time.values, signals))
        self.size = self.path.stat().st_size
