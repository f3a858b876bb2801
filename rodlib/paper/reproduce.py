"""All notebooks end to end, and their results published: what ``make reproduce`` runs.

Notebooks, figures and parts of the ledger go to build/reproduce; only when all have succeeded, to
figures/ and the README. ``make replay`` runs a notebook of its own on another log, in build/replay.
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
from itertools import zip_longest
from pathlib import Path

from tqdm import tqdm

from ilctools.files import alone, folder
from rodlib.paper.ledger import publish
from rodlib.paper.repository import ROOT, checkout

REPORT = Path(__file__).with_name("replay.ipynb")
AT_A_TIME = 3  # two processors stay busy while a kernel starts or ends
# The first to start, so that no processor waits for the last to end.
LONGEST = ("16", "09", "14", "13", "10", "17", "06", "18", "08")


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


def run(notebook: Path, executed: Path, bar: tqdm | None = None, **parameters) -> float:
    """Execute a notebook in its own folder, in a new kernel, and say how many seconds it took."""
    # jsonschema, which reads notebooks, builds a grammar of web addresses if it finds the package:
    # two seconds for nothing.
    sys.modules.setdefault("rfc3987_syntax", None)
    import papermill

    start = time.perf_counter()
    # papermill replaces what stands in braces in a path
    source, target = (
        str(path).replace("{", "{{").replace("}", "}}") for path in (notebook, executed)
    )
    try:
        papermill.execute_notebook(
            source,
            target,
            parameters,
            progress_bar=False,
            request_save_on_cell_execute=False,
            # papermill's own `cwd` is that of the whole process, not of one thread
            resources={"metadata": {"path": str(notebook.parent)}},
            shutdown_kernel="immediate",  # all is written by then
            on_cell_complete=lambda **cell: bar is None or bar.update(),
        )
    except papermill.PapermillExecutionError as error:
        raise RuntimeError(
            f"{notebook.stem} failed in cell [{error.exec_count}]: {error.ename}: {error.evalue}\n"
            f"The traceback is in {executed}"
        ) from None
    except Exception as error:
        raise RuntimeError(f"{notebook.stem} failed: {error}") from error
    return time.perf_counter() - start


def longest_first(root: Path) -> list[Path]:
    """The notebooks, in the order in which they are started."""
    order = {name: k for k, name in enumerate(LONGEST)}
    notebooks = sorted((root / "notebooks").glob("*.ipynb"))
    return sorted(notebooks, key=lambda path: order.get(path.name[:2], len(order)))


def reproduce(root: Path = ROOT) -> None:
    """Run all notebooks and publish the figures and the ledger; on an error, publish nothing."""
    notebooks = longest_first(root)
    cells = sum(len(json.loads(path.read_text("utf-8"))["cells"]) for path in notebooks)
    with folder_of_run("reproduce", root) as build:
        print(f"running {len(notebooks)} notebooks, {AT_A_TIME} at a time ...", flush=True)
        bar = tqdm(total=cells, unit="cell", leave=False, disable=None)
        with bar, ThreadPoolExecutor(AT_A_TIME) as pool:
            running = {
                pool.submit(run, path, build / path.name, bar): path.stem for path in notebooks
            }
            for done in as_completed(running):
                if done.exception():
                    pool.shutdown(cancel_futures=True)
                tqdm.write(f"{running[done]} ... done, {done.result():.0f} s")
                sys.stdout.flush()
        publish(build, root)
        cells = [name for path in notebooks for name in changed_cells(build / path.name, path)]
        differ = f"these print something else: {', '.join(sorted(cells))}"
        print(f"cells of the notebooks: {differ if cells else 'all print the same as before'}")


def changed_cells(executed: Path, tracked: Path) -> list[str]:
    """The code cells of a notebook that print other texts than as it is tracked, by name."""
    new, old = (_texts(json.loads(path.read_text("utf-8"))) for path in (executed, tracked))
    changed = [k for k, (one, other) in enumerate(zip_longest(new, old), 1) if one != other]
    return [f"{tracked.stem} [{k}]" for k in changed]


def _texts(notebook):
    """What each code cell prints and shows as text, a string for each."""
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            bundles = ({"text/": o.get("text", ""), **o.get("data", {})} for o in cell["outputs"])
            parts = [part for b in bundles for mime, part in b.items() if mime.startswith("text/")]
            yield "".join("".join(part) for part in parts)


def replay(log: str, root: Path = ROOT) -> None:
    """Print what a log shows; a report with pictures and the next trial's v go to build/replay."""
    import ilctools  # here, because it takes long to import

    checkout("make replay", root)
    path = Path(os.path.expanduser(log)).absolute()
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not a file: make replay LOG=path")
    replayed = ilctools.replay(ilctools.load_log(path))
    with folder_of_run("replay", root) as build:
        report, table = build / REPORT.name, build / "next-trial.csv"
        print(replayed)
        if replayed.law is not None:
            replayed.save_following(table)
            print(f"v of trial {replayed.numbers[-1] + 1}: {table.relative_to(root)}")
        print(f"pictures and explanations: {report.relative_to(root)} ...", flush=True)
        shutil.copy(REPORT, report)
        run(report, report, log=str(path))


def main(root: Path = ROOT, log: str | None = None) -> None:
    """Reproduce, or replay a log, and leave with a message if that fails."""
    # Ctrl-C ends at once; the kernels follow
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        if log is None:
            reproduce(root)
        else:
            replay(log, root)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main(ROOT, *sys.argv[1:])
