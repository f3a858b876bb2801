"""All notebooks end to end, and their results published: what ``make reproduce`` runs.

Notebooks, figures and parts of the ledger go to build/reproduce; only when all have succeeded, to
figures/ and the README. ``make replay`` runs a notebook of its own on another log, in build/replay.
"""

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

import ilctools
from ilctools.files import alone, folder
from rodlib.paper.ledger import publish
from rodlib.paper.repository import ROOT, checkout

REPORT = Path(__file__).with_name("replay.ipynb")
AT_A_TIME = 2  # with three, two processors take 5 % more CPU, and 4 % less time


@contextmanager
def folder_of_run(command: str, root: Path) -> Iterator[Path]:
    """An empty folder in build/ that the kernels of this process save to, and no other run."""
    build = folder(checkout(f"make {command}", root) / "build")
    refusal = f"make {command} is already running in {root}: wait until it has ended"
    with alone(build / f"{command}.lock", refusal):
        results = build / command
        shutil.rmtree(results, ignore_errors=True)
        # see rodlib.paper.repository.results
        os.environ["RODLIB_RESULTS"] = str(folder(results))
        yield results


def execute(notebook: Path, executed: Path, **parameters) -> float:
    """Execute a notebook in its own folder, in a new kernel, and say how many seconds it took.

    papermill replaces what stands in braces in a path, so that neither may have any.
    """
    import papermill

    start = time.perf_counter()
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
        )
    except papermill.PapermillExecutionError as error:
        raise RuntimeError(
            f"{notebook.stem} failed in cell [{error.exec_count}]: {error.ename}: {error.evalue}\n"
            f"The traceback is in {executed}"
        ) from None
    except Exception as error:
        text = f"{notebook.stem} failed: {error} (as far as it came: {executed})"
        raise RuntimeError(text) from None
    return time.perf_counter() - start


def longest_first(root: Path) -> list[Path]:
    """The notebooks, the last first: the long ones are among them, and must not start late."""
    return sorted((root / "notebooks").glob("*.ipynb"), reverse=True)


def reproduce(root: Path = ROOT) -> None:
    """Run all notebooks and publish the figures and the ledger; on an error, publish nothing."""
    notebooks = longest_first(root)
    with folder_of_run("reproduce", root) as build, ThreadPoolExecutor(AT_A_TIME) as pool:
        print(f"running {len(notebooks)} notebooks, {AT_A_TIME} at a time ...", flush=True)
        running = {pool.submit(execute, path, build / path.name): path.stem for path in notebooks}
        for done in as_completed(running):
            if done.exception():
                pool.shutdown(cancel_futures=True)
            print(f"{running[done]} ... done, {done.result():.0f} s", flush=True)
        publish(build, root)


def replay_log(log: str, root: Path = ROOT) -> None:
    """Print what a log shows; a report with pictures and the next trial's v go to build/replay."""
    checkout("make replay", root)
    path = Path(log).expanduser().absolute()
    replayed = ilctools.replay(ilctools.load_log(path))
    with folder_of_run("replay", root) as build:
        report, table = build / REPORT.name, build / "next-trial.csv"
        print(replayed)
        if replayed.law is not None:
            replayed.following_table.to_csv(table)
            print(f"v of trial {replayed.numbers[-1] + 1}: {table.relative_to(root)}")
        print(f"pictures and explanations: {report.relative_to(root)} ...", flush=True)
        shutil.copy(REPORT, report)
        execute(report, report, log=str(path))


def main(root: Path = ROOT, log: str | None = None) -> None:
    """Reproduce, or replay a log, and leave with a message if that fails."""
    # Ctrl-C ends at once; the kernels follow
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        if log is None:
            reproduce(root)
        else:
            replay_log(log, root)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main(ROOT, *sys.argv[1:])
