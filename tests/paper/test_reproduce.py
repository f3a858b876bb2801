import multiprocessing
import re
import shutil
import time
from types import SimpleNamespace

import nbformat
import pytest
from apart import to_files

from rodlib.paper import ROOT, ledger, published
from rodlib.paper.ledger import Ledger


def write(path, *cells):
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    notebook.cells = [nbformat.v4.new_code_cell(cell) for cell in cells]
    nbformat.write(notebook, path)


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A repository whose one notebook copies a complete ledger and a figure made beforehand."""
    folder = tmp_path / "a rod"
    folder.mkdir()
    (folder / "pyproject.toml").write_text('name = "rodlib"\n')
    (folder / "README.md").write_text("<!-- ledger -->\nold\n<!-- end of ledger -->\n")
    (folder / "notebooks").mkdir()
    with monkeypatch.context() as patch:
        patch.setenv("RODLIB_RESULTS", str(folder / "made"))
        book = Ledger("01-model")
        for key, claim in published.claims().items():
            book.record(key, None if claim.criterion == ledger.UNCHECKED else 1.0)
        book.save()
    shutil.copytree(ROOT / "figures", folder / "figures", ignore=shutil.ignore_patterns("*.p*"))
    (folder / "made" / "figures").mkdir()
    (folder / "made" / "figures" / "fig01.png").write_bytes(b"picture")
    write(
        folder / "notebooks" / "01-model.ipynb",
        "import shutil; from rodlib.paper.repository import results",
        'shutil.copytree("../made", results("this notebook"), dirs_exist_ok=True); print("done")',
    )
    return folder


# It has imported once what all need.
APART = multiprocessing.get_context("forkserver")
APART.set_forkserver_preload(["rodlib.paper.reproduce", "papermill"])


def begin(root):
    """A process of its own, as make starts it: the kernels' event loops end with it."""
    process = APART.Process(target=to_files, args=(root,))
    process.start()
    return process


def run(root):
    process = begin(root)
    process.join()
    said = {name: (root / name).read_text() for name in ("stdout", "stderr")}
    return SimpleNamespace(returncode=process.exitcode, **said)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("1 / x", "02-fails failed: division by zero\nSee "),
        ("import os; os._exit(1)", "02-fails failed: Kernel died"),
    ],
)
def test_a_notebook_that_fails_is_named_and_nothing_is_published(root, cell, message):
    write(root / "notebooks" / "02-fails.ipynb", "x = 0", cell)
    outcome = run(root)
    assert outcome.returncode == 1
    assert message in outcome.stderr
    # a thread of the kernel may fail as it is ended, which is none of ours
    ours = outcome.stderr.replace("Exception in thread Heartbeat:\nTraceback (", "")
    assert "Traceback (" not in ours
    assert not list(root.glob("figures/*.png"))
    assert "old" in (root / "README.md").read_text()


def test_a_second_run_is_refused_and_after_a_kill_results_are_published(root, gate):
    """The first run waits in its notebook until it is killed.

    After it notebooks run in their folder, and nothing else is published than they made: neither an
    earlier run's results, nor those saved by hand.
    """
    wait = "from pathlib import Path; Path('started').touch(); Path('../../gate').read_bytes()"
    write(root / "notebooks" / "02-waits.ipynb", wait)
    first = begin(root)
    try:
        while not (root / "notebooks" / "started").exists():
            assert first.is_alive(), (root / "stderr").read_text()
            time.sleep(0.05)
        second = run(root)
        assert second.returncode == 1
        assert second.stderr == (
            f"make reproduce is already running in {root}: wait until it has ended\n"
        )
    finally:
        first.kill()
        first.join()
    assert not list(root.glob("figures/*.png"))
    (root / "notebooks" / "02-waits.ipynb").unlink()
    for stale in ("build/reproduce/figures", "build/figures"):
        (root / stale).mkdir(parents=True, exist_ok=True)
        (root / stale / "fig02.png").write_bytes(b"stale")
    outcome = run(root)
    assert outcome.returncode == 0
    of_the_killed = r"\[IPKernelApp\] WARNING \| Parent appears to have exited, shutting down.\n"
    assert re.fullmatch(f"({of_the_killed})*", outcome.stderr)
    assert "01-model ... done" in outcome.stdout
    changed = "figures/fig01.png, figures/ledger.csv, figures/ledger.md, README.md"
    assert outcome.stdout.splitlines()[-1] == f"different: {changed}"
    assert (root / "figures" / "fig01.png").read_bytes() == b"picture"
    assert not (root / "figures" / "fig02.png").exists()
    assert " printed numbers agree" in (root / "README.md").read_text()
    executed = nbformat.read(root / "build" / "reproduce" / "01-model.ipynb", 4)
    assert [cell.execution_count for cell in executed.cells] == [1, 2]
