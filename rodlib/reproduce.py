"""All notebooks end to end, and their results published: what ``make reproduce`` runs.

Three notebooks run at a time, each in a kernel of its own. The executed notebooks, their figures
and their parts of the ledger go to build/; only when all have succeeded, they go to figures/ and
the README.
"""

import shutil
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from rodlib.ledger import publish
from rodlib.published import ROOT

AT_A_TIME = 3  # two processors stay busy while a kernel starts or ends


def run(notebook: Path, executed: Path) -> float:
    """Execute a notebook in its own folder, in a new kernel.

    Parameters
    ----------
    notebook : Path
        Stays as it is.
    executed : Path
        Where to write the notebook with its outputs, also if a cell fails.

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
    try:
        papermill.execute_notebook(
            notebook,
            executed,
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
        raise RuntimeError(f"{notebook.stem} failed: {error}") from error
    return time.perf_counter() - start


def reproduce(root: Path = ROOT) -> None:
    """Run all notebooks and publish the figures and the ledger; on an error, publish nothing.

    Parameters
    ----------
    root : Path
        Folder with notebooks/ and README.md. Its build/ is cleared, its figures/ is rewritten.

    Raises
    ------
    RuntimeError
        If a notebook fails.
    ValueError
        If the notebooks' rows do not make a complete ledger.
    """
    build = root / "build"
    shutil.rmtree(build, ignore_errors=True)
    build.mkdir()
    # the later ones take longer and go first, so that the last to end are short
    notebooks = sorted((root / "notebooks").glob("*.ipynb"), reverse=True)
    print(f"running {len(notebooks)} notebooks, {AT_A_TIME} at a time ...", flush=True)
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        running = {pool.submit(run, path, build / path.name): path.stem for path in notebooks}
        for done in as_completed(running):
            if done.exception():
                pool.shutdown(cancel_futures=True)
            print(f"{running[done]} ... done, {done.result():.0f} s", flush=True)
    publish(build, root)


def main(root: Path = ROOT) -> None:
    """Reproduce, and leave with a message if that fails."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends at once; the kernels follow
    try:
        reproduce(root)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
