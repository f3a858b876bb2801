"""The environment: made for one folder, and ready while it is newer than the lock."""

import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from rodlib.paper.repository import ROOT

spec = importlib.util.spec_from_file_location("environment", ROOT / "environment.py")
environment = importlib.util.module_from_spec(spec)
spec.loader.exec_module(environment)


@pytest.fixture
def clone(tmp_path):
    """A repository of empty sources, with an environment in which its packages are installed."""
    root = tmp_path / "Gałkowski's clone"
    for package in ("rodlib", "toolbox/ilctools"):
        (root / package).mkdir(parents=True)
        (root / package / "__init__.py").touch()
    for name in ("environment.lock", "pyproject.toml", "toolbox/pyproject.toml"):
        (root / name).touch()
    venv = [sys.executable, "-m", "venv", "--without-pip", root / ".venv"]
    subprocess.run(venv, check=True)
    (packages,) = root.glob(".venv/lib/*/site-packages")
    (packages / "both.pth").write_text(f"{root}\n{root / 'toolbox'}\n", encoding="utf-8")
    (root / ".venv" / "bin" / "ready").touch()
    return root


def test_an_environment_is_ready_while_it_is_complete_its_own_and_newer_than_the_lock(clone):
    assert environment.is_ready(clone)
    copy = shutil.copytree(clone, clone.with_name("copy"), symlinks=True)
    (packages,) = copy.glob(".venv/lib/*/site-packages")
    for toolbox in (clone, copy):  # which must be its own, too
        (packages / "both.pth").write_text(f"{copy}\n{toolbox / 'toolbox'}\n", encoding="utf-8")
        assert environment.is_ready(copy) == (toolbox == copy)
    ready = clone / ".venv" / "bin" / "ready"
    later = ready.stat().st_mtime + 1
    os.utime(clone / "environment.lock", (later, later))
    assert not environment.is_ready(clone)
    ready.unlink()
    assert not environment.is_ready(clone)
