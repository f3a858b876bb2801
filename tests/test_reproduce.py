import subprocess
import sys

import nbformat
import pytest

from rodlib import ledger, published
from rodlib.ledger import Ledger


def write(path, *cells):
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    notebook.cells = [nbformat.v4.new_code_cell(cell) for cell in cells]
    nbformat.write(notebook, path)


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A repository whose one notebook copies a complete ledger and a figure made beforehand."""
    monkeypatch.setattr(ledger, "BUILD", tmp_path / "made")
    book = Ledger("01-model")
    for key, claim in published.claims().items():
        book.record(key, None if claim.criterion == ledger.UNCHECKED else 1.0)
    book.save()
    (tmp_path / "made" / "figures").mkdir()
    (tmp_path / "made" / "figures" / "fig01.png").write_bytes(b"picture")
    (tmp_path / "README.md").write_text("<!-- ledger -->\nold\n<!-- end of ledger -->\n")
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "stale.ipynb").write_text("")
    (tmp_path / "notebooks").mkdir()
    write(
        tmp_path / "notebooks" / "01-model.ipynb",
        "import shutil",
        'shutil.copytree("../made", "../build", dirs_exist_ok=True)',
    )
    return tmp_path


def run(root):
    """In a process of its own, as make does: the kernels' event loops end with it."""
    call = "import pathlib, sys, rodlib.reproduce as r; r.main(pathlib.Path(sys.argv[1]))"
    return subprocess.run([sys.executable, "-c", call, root], capture_output=True, text=True)


def test_notebooks_run_in_their_folder_and_their_results_are_published(root):
    outcome = run(root)
    assert outcome.returncode == 0, outcome.stderr
    assert "01-model ... done, " in outcome.stdout
    assert (root / "figures" / "fig01.png").read_bytes() == b"picture"
    assert "| 01-model " in (root / "README.md").read_text()
    assert not (root / "build" / "stale.ipynb").exists()
    executed = nbformat.read(root / "build" / "01-model.ipynb", as_version=4)
    assert [cell.execution_count for cell in executed.cells] == [1, 2]


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("1 / x", "02-fails failed in cell [2]: ZeroDivisionError: division by zero\n"),
        ("import os; os._exit(1)", "02-fails failed: Kernel died\n"),
    ],
)
def test_a_notebook_that_fails_is_named_and_nothing_is_published(root, cell, message):
    write(root / "notebooks" / "02-fails.ipynb", "x = 0", cell)
    outcome = run(root)
    assert outcome.returncode == 1
    assert message in outcome.stderr
    assert "Traceback (" not in outcome.stderr
    assert not (root / "figures").exists()
    assert "old" in (root / "README.md").read_text()
