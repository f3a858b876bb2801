"""Run all notebooks end to end and publish their results, as ``make reproduce`` does.

Notebooks, figures and parts of the ledger go to build/reproduce. Only when all notebooks have
succeeded, the results go to figures/ and the README.
"""

import os
import shutil
import signal
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from ilctools.files import alone, folder
from rodlib.paper.ledger import publish
from rodlib.paper.repository import ROOT, checkout

AT_A_TIME = 2  # with three, two processors take 5 % more CPU, and 4 % less time


def execute(notebook: Path, executed: Path) -> None:
    """Execute a notebook in its own folder, in a new kernel.

    papermill replaces any text in braces in a path. Neither of the two paths may contain braces.
    """
    import papermill

    papermill.execute_notebook(
        notebook,
        executed,
        progress_bar=False,
        request_save_on_cell_execute=False,
        # papermill's own `cwd` applies to the whole process, not to one thread
        resources={"metadata": {"path": str(notebook.parent)}},
        shutdown_kernel="immediate",  # everything is written by then
    )


def longest_first(root: Path) -> list[Path]:
    """Return the notebooks in reverse order, because the last ones take longest."""
    return sorted((root / "notebooks").glob("*.ipynb"), reverse=True)


def reproduce(root: Path = ROOT) -> None:
    """Run all notebooks, and publish the figures and the ledger.

    After an error, nothing is published.

    Only one run may be active. A run begins with an empty folder, in which the notebooks of this
    run save their results.
    """
    build = folder(checkout("make reproduce", root) / "build")
    refusal = f"make reproduce is already running in {root}: wait until it has ended"
    with alone(build / "reproduce.lock", refusal), ThreadPoolExecutor(AT_A_TIME) as pool:
        results = build / "reproduce"
        shutil.rmtree(results, ignore_errors=True)
        # see rodlib.paper.repository.results
        os.environ["RODLIB_RESULTS"] = str(folder(results))
        notebooks = longest_first(root)
        print(f"running {len(notebooks)} notebooks, {AT_A_TIME} at a time ...", flush=True)
        running = {pool.submit(execute, path, results / path.name): path for path in notebooks}
        for done in as_completed(running):
            path = running[done]
            if error := done.exception():
                pool.shutdown(cancel_futures=True)
                said = getattr(error, "evalue", error)  # papermill's text has the whole cell
                raise RuntimeError(f"{path.stem} failed: {said}\nSee {results / path.name}")
            print(f"{path.stem} ... done", flush=True)
        publish(results, root)


def main(root: Path = ROOT) -> None:
    """Reproduce, and exit with a message if this fails."""
    # Ctrl-C ends at once; the kernels follow
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        reproduce(root)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
