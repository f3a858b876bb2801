"""All notebooks end to end, and their results published: what ``make reproduce`` runs.

Three notebooks run at a time, each in a kernel of its own; a terminal shows the cell that each is
in and the time left, by what the cells took in the last run if there was one. The executed
notebooks, their figures and their parts of the ledger go to build/reproduce; only when all have
succeeded, they go to figures/ and the README. ``make replay`` runs one notebook on another log, in
build/replay, and publishes nothing.
"""

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from tqdm import tqdm

from rodlib.ilc.files import alone, folder
from rodlib.paper.ledger import publish
from rodlib.paper.repository import ROOT, checkout

AT_A_TIME = 3  # two processors stay busy while a kernel starts or ends


@contextmanager
def folder_of_run(command: str, root: Path) -> Iterator[Path]:
    """An empty folder in build/ that the kernels of this process save to, and no other run.

    Parameters
    ----------
    command : str
        The target of make; its next run clears the folder.
    root : Path
        The repository.

    Raises
    ------
    RuntimeError
        If the same command is running already, or `root` is no clone of the repository.
    """
    build = folder(checkout(f"make {command}", root) / "build")
    refusal = f"make {command} is already running in {root}: wait until it has ended"
    with alone(build / f"{command}.lock", refusal):
        results = folder(build / command)
        for path in results.iterdir():  # and not the folder, which may be a link or a mount point
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        os.environ["RODLIB_RESULTS"] = str(results)  # see rodlib.paper.repository.results
        yield results


def seconds_by_cell(executed: Path, notebook: Path) -> list[float]:
    """How long each cell took in an earlier run; as if they were alike, if that cannot be said.

    Parameters
    ----------
    executed : Path
        What :func:`run` wrote, if it is there.
    notebook : Path
        As it is now.
    """
    count = len(json.loads(notebook.read_text(encoding="utf-8"))["cells"])
    try:
        cells = json.loads(executed.read_text(encoding="utf-8"))["cells"]
        seconds = [float(cell["metadata"]["papermill"]["duration"]) for cell in cells]
    except (OSError, ValueError, KeyError, TypeError):  # no run, or one that did not end
        seconds = []
    return seconds if len(seconds) == count else [1.0] * count


def run(notebook: Path, executed: Path, seconds: list[float] | None = None, **parameters) -> float:
    """Execute a notebook in its own folder, in a new kernel.

    Parameters
    ----------
    notebook : Path
        Stays as it is.
    executed : Path
        Where to write the notebook with its outputs, also if a cell fails.
    seconds : list of float, optional
        What each cell may take, from :func:`seconds_by_cell`, for the time left on a terminal.
    **parameters
        Instead of those in its cell.

    Returns
    -------
    float
        How long it took, in seconds.

    Raises
    ------
    RuntimeError
        If a cell fails or the kernel dies; the message says which and how.
    """
    # jsonschema, which reads notebooks, builds a grammar of web addresses if it finds the package:
    # two seconds for nothing.
    sys.modules.setdefault("rfc3987_syntax", None)
    import papermill

    start = time.perf_counter()
    seconds = seconds or seconds_by_cell(executed, notebook)
    bar = tqdm(
        total=sum(seconds), desc=f"{notebook.stem:<22}", leave=False, disable=None,
        bar_format="{desc} {bar:20} {remaining} left{postfix}",
    )  # fmt: skip
    try:
        papermill.execute_notebook(
            notebook,
            executed,
            parameters,
            progress_bar=False,
            request_save_on_cell_execute=False,
            # papermill's own `cwd` is that of the whole process, not of one thread
            resources={"metadata": {"path": str(notebook.parent)}},
            shutdown_kernel="immediate",  # all is written by then
            on_cell_start=partial(_show, bar, seconds),
        )
    except papermill.PapermillExecutionError as error:
        raise RuntimeError(
            f"{notebook.stem} failed in cell [{error.exec_count}]: {error.ename}: {error.evalue}\n"
            f"The traceback is in {executed}"
        ) from None
    except Exception as error:
        raise RuntimeError(f"{notebook.stem} failed: {error}") from error
    finally:
        bar.close()
    return time.perf_counter() - start


def _show(bar, seconds, cell, cell_index):
    bar.n = sum(seconds[:cell_index])
    bar.set_postfix_str(f"cell {cell_index + 1} of {len(seconds)}")


def reproduce(root: Path = ROOT) -> None:
    """Run all notebooks and publish the figures and the ledger; on an error, publish nothing.

    Parameters
    ----------
    root : Path
        The repository. Its build/reproduce is cleared, what differs in its figures/ replaced.

    Raises
    ------
    RuntimeError
        If a notebook fails, the command is running already, or `root` is no clone.
    ValueError
        If the notebooks' rows do not make a complete ledger.
    """
    notebooks, last = sorted((root / "notebooks").glob("*.ipynb")), root / "build" / "reproduce"
    seconds = {path: seconds_by_cell(last / path.name, path) for path in notebooks}
    # the longest first, so that the last to end are short; as yet unknown, those with most cells
    notebooks.sort(key=lambda path: sum(seconds[path]), reverse=True)
    with folder_of_run("reproduce", root) as build:
        print(f"running {len(notebooks)} notebooks, {AT_A_TIME} at a time ...", flush=True)
        with ThreadPoolExecutor(AT_A_TIME) as pool:
            running = {
                pool.submit(run, path, build / path.name, seconds[path]): path.stem
                for path in notebooks
            }
            for done in as_completed(running):
                if done.exception():
                    pool.shutdown(cancel_futures=True)
                tqdm.write(f"{running[done]} ... done, {done.result():.0f} s")
                sys.stdout.flush()
        publish(build, root)


def replay(log: str, root: Path = ROOT) -> None:
    """Run the notebook of the experiment on a log of one's own, and print what it found.

    Publishes nothing. Beside the executed notebook, the v of the next trial is written as a table.

    Parameters
    ----------
    log : str
        Path of the log, from the present folder.
    root : Path
        The repository. Its build/replay is cleared, unless the log cannot be used.

    Raises
    ------
    FileNotFoundError
        If there is no such log.
    LogError
        If it cannot be used.
    RuntimeError
        As :func:`reproduce`.
    """
    from rodlib.ilc.laboratory import load_log, replay_of  # here, because they take long to import
    from rodlib.paper.rig_logs import papers_loop

    checkout("make replay", root)
    path = Path(log)
    if not path.exists():  # or else a name may well begin with ~
        path = Path(os.path.expanduser(log))
    path = path.absolute()
    if not path.is_file():
        what = "is a folder, not a log" if path.is_dir() else "is not there"
        raise FileNotFoundError(f"{path} {what}: make replay LOG=path")
    replayed = replay_of(load_log(path), papers_loop(path))
    notebook = root / "notebooks" / "05-experiment-replay.ipynb"
    with folder_of_run("replay", root) as build:
        executed, table = build / notebook.name, build / "next-trial.csv"
        print(replayed)
        if replayed.law is not None:
            replayed.save_following(table)
            print(f"v of trial {replayed.numbers[-1] + 1}: {table.relative_to(root)}")
        print(f"pictures and explanations: {executed.relative_to(root)} ...", flush=True)
        run(notebook, executed, log=str(path), no_learning="", untold=[])


def main(root: Path = ROOT, log: str | None = None) -> None:
    """Reproduce, or replay a log, and leave with a message if that fails."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends at once; the kernels follow
    try:
        if log is None:
            reproduce(root)
        else:
            replay(log, root)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main(ROOT, *sys.argv[1:])
