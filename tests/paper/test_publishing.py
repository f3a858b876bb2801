"""The repository as it is written to: only a clone, and never by half."""

import os
import subprocess
import sys

import pytest

from rodlib.ilc.files import write_whole
from rodlib.paper.repository import ROOT, checkout, publishing, results


def test_only_a_clone_is_written_to(tmp_path):
    assert checkout("a test") == ROOT
    with pytest.raises(
        RuntimeError, match=rf"a test writes to a clone .* {tmp_path} is none"
    ):
        checkout("a test", tmp_path)
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "another"\n')
    with (
        pytest.raises(RuntimeError, match="clone it and work there"),
        publishing(tmp_path),
    ):
        pytest.fail("must not come that far")
    assert [path.name for path in tmp_path.iterdir()] == ["pyproject.toml"]


def test_results_go_to_build_or_to_the_folder_of_the_run(tmp_path, monkeypatch):
    monkeypatch.delenv("RODLIB_RESULTS", raising=False)
    assert results("a test") == ROOT / "build"
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path))
    assert results("a test") == tmp_path


OLD = {"README.md": "old", "figures/fig01.png": "old", "figures/fig02.png": "gone"}
NEW = {"README.md": "new", "figures/fig01.png": "new", "figures/fig03.png": "came"}

# Publishes NEW, and at one of its operations on files ends: by a kill, or by a full disk.
STOPPED = """
import errno, os, sys
from pathlib import Path
from rodlib.paper.repository import publishing

root, step, how = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
count = 0

def watch(event, arguments):
    global count
    if event in ("open", "os.rename", "os.remove", "os.mkdir") and str(root) in str(arguments[0]):
        count += 1
        if count == step and how == "kill":
            os._exit(9)
        writing = event == "open" and "w" in str(arguments[1])
        if count == step or (count > step and writing):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

sys.addaudithook(watch)
with publishing(root) as new:
    new["figures/fig02.png"] = None
    for name in ("README.md", "figures/fig01.png"):
        new[name] = b"new"
    new["figures/fig03.png"] = b"came"
"""


def state(root):
    files = [
        path
        for path in root.rglob("*")
        if path.is_file() and path.parent.name != "build"
    ]
    return {
        path.relative_to(root).as_posix(): path.read_text()
        for path in files
        if path.name != "pyproject.toml"
    }


def begun(root):
    (root / "figures").mkdir(parents=True)
    (root / "pyproject.toml").write_text('name = "rodlib"\n')
    for name, text in OLD.items():
        (root / name).write_text(text)
    return root


@pytest.mark.parametrize("how", ["kill", "full"])
def test_wherever_publishing_ends_no_file_is_half_and_the_next_run_mends_it(
    tmp_path, how
):
    """At every single operation, from the first on, until one run gets through."""
    seen = []
    for step in range(1, 100):
        root = begun(tmp_path / str(step))
        call = [sys.executable, "-I", "-c", STOPPED, root, str(step), how]
        stopped = subprocess.run(call, capture_output=True, text=True)
        left = {
            name: text
            for name, text in state(root).items()
            if not name.endswith(".part")
        }
        if stopped.returncode == 0:
            break
        assert stopped.returncode == (9 if how == "kill" else 1), stopped.stderr
        assert how == "kill" or "No space left" in stopped.stderr
        if how == "full":
            assert left == state(root), "an error leaves nothing beside the files"
        assert all(
            left.get(name) in (OLD.get(name), NEW.get(name)) for name in OLD | NEW
        )
        assert left["README.md"] == "old" or left == NEW, "the README is the last"
        seen.append(left)
        again = subprocess.run(
            [*call[:-2], "1000", how], capture_output=True, text=True
        )
        assert again.returncode == 0 and state(root) == NEW, again.stderr
    assert state(root) == left == NEW
    assert seen[0] == OLD and len(seen) > 8
    changed = [
        sum(left.get(name) == NEW.get(name) for name in OLD | NEW) for left in seen
    ]
    assert changed == sorted(changed) and {0, 1, 2, 3} <= {*changed}


def test_a_mistake_while_collecting_changes_nothing(tmp_path):
    (tmp_path / "pyproject.toml").write_text('name = "rodlib"\n')
    write_whole(tmp_path / "README.md", "old")
    with pytest.raises(KeyError), publishing(tmp_path) as new:
        new["README.md"] = b"new"
        raise KeyError("a figure")
    assert state(tmp_path) == {"README.md": "old"}
    assert os.listdir(tmp_path / "build") == ["publishing.lock"]
