"""The environment: made for one folder, by one process at a time."""

import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from rodlib.files import ROOT, alone

spec = importlib.util.spec_from_file_location("environment", ROOT / "environment.py")
environment = importlib.util.module_from_spec(spec)
spec.loader.exec_module(environment)


@pytest.fixture
def clone(tmp_path):
    """A repository of two empty sources, with an environment in which its rodlib is installed."""
    root = tmp_path / "Gałkowski's clone"
    (root / "rodlib").mkdir(parents=True)
    (root / "rodlib" / "__init__.py").touch()
    for name in ("environment.lock", "pyproject.toml"):
        (root / name).touch()
    venv = [sys.executable, "-m", "venv", "--without-pip", root / ".venv"]
    subprocess.run(venv, check=True)
    (packages,) = root.glob(".venv/lib/*/site-packages")
    (packages / "rodlib.pth").write_text(f"{root}\n", encoding="utf-8")
    (root / ".venv" / "bin" / "ready").touch()
    return root


def test_an_environment_is_kept_while_it_is_newer_than_the_lock(clone):
    assert environment.is_ready(clone)
    later = os.stat(clone / ".venv" / "bin" / "ready").st_mtime + 1
    os.utime(clone / "environment.lock", (later, later))
    assert not environment.is_ready(clone)


def test_half_an_environment_is_none(clone):
    (clone / ".venv" / "bin" / "ready").unlink()
    assert not environment.is_ready(clone)


def test_a_copy_does_not_use_the_environment_of_the_original(clone):
    copy = shutil.copytree(clone, clone.with_name("copy"), symlinks=True)
    assert environment.is_ready(clone)
    assert not environment.is_ready(copy)
    shutil.rmtree(clone)
    assert not environment.is_ready(copy)


def test_an_environment_whose_python_has_gone_is_none(clone):
    python = clone / ".venv" / "bin" / "python"
    python.unlink()
    python.symlink_to(clone / "nowhere")
    assert not environment.is_ready(clone)


def test_nobody_else_creates_it_at_the_same_time(tmp_path):
    (tmp_path / "build").mkdir()
    with (
        alone(tmp_path / "build" / "environment.lock", ""),
        pytest.raises(SystemExit, match="another make is creating the environment"),
    ):
        environment.main(tmp_path)
    assert os.listdir(tmp_path) == ["build"]
