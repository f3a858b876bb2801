"""The environment: made for one folder, by one process at a time."""

import importlib.util
import os
import shutil
import subprocess
import sys

import pytest

from ilctools.files import alone
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


def test_an_environment_is_ready_while_it_is_complete_and_newer_than_the_lock(clone):
    assert environment.is_ready(clone)
    ready = clone / ".venv" / "bin" / "ready"
    later = ready.stat().st_mtime + 1
    os.utime(clone / "environment.lock", (later, later))
    assert not environment.is_ready(clone)
    ready.unlink()
    assert not environment.is_ready(clone)


def test_a_copy_does_not_use_the_environment_of_the_original(clone):
    copy = shutil.copytree(clone, clone.with_name("copy"), symlinks=True)
    assert not environment.is_ready(copy)
    (packages,) = copy.glob(".venv/lib/*/site-packages")
    (packages / "both.pth").write_text(f"{copy}\n{clone / 'toolbox'}\n", encoding="utf-8")
    assert not environment.is_ready(copy)  # the toolbox, too, must be its own
    shutil.rmtree(clone)
    assert not environment.is_ready(copy)


def test_nobody_else_creates_it_at_the_same_time(tmp_path):
    (tmp_path / "build").mkdir()
    with (
        alone(tmp_path / "build" / "environment.lock", ""),
        pytest.raises(SystemExit, match="another make is creating the environment"),
    ):
        environment.main(tmp_path)
    assert os.listdir(tmp_path) == ["build"]


@pytest.fixture
def created(tmp_path, monkeypatch):
    """Commands by which an environment is made, where nothing is installed; uv's ends as asked."""
    (tmp_path / "environment.lock").write_text("uv==1 \\\n    --hash=sha256:0\n")
    (tmp_path / ".venv" / "bin").mkdir(parents=True)

    def create(uv=0):
        commands = []

        def keep(command):
            commands.append([str(part) for part in command])
            failed = uv if commands[-1][0].endswith("uv") else 0
            return subprocess.CompletedProcess(command, failed)

        monkeypatch.setattr(environment.subprocess, "run", keep)
        environment.create(tmp_path)
        return commands

    return create


@pytest.mark.parametrize("uv", [0, 1])
def test_where_uv_cannot_install_pip_does(tmp_path, created, uv):
    commands, folder = created(uv), tmp_path / ".venv" / "bin"
    by_pip = [str(folder / "python"), *environment.PIP, "--require-hashes", "-r"]
    by_pip.append(str(tmp_path / "environment.lock"))
    assert (by_pip in commands) == bool(uv)
    assert (folder / "ready").exists() and len(commands) == 4 + uv


@pytest.mark.parametrize("target", ["gone", ".", None])
def test_what_stands_in_the_way_is_named(tmp_path, target):
    way = tmp_path / ".venv"
    way.symlink_to(target) if target else way.touch()
    with pytest.raises(SystemExit, match=r"\.venv is no folder, or a link to one: remove it"):
        environment.create(tmp_path)
    assert os.path.lexists(way)


def test_where_no_home_can_be_written_uv_keeps_its_files_in_build(tmp_path, created, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "none"))
    [by_uv] = [command for command in created() if command[0].endswith("uv")]
    assert by_uv[by_uv.index("--cache-dir") + 1] == str(tmp_path / "build" / "uv")


def test_a_users_dry_run_does_not_reach_the_installer(tmp_path):
    """It would leave an environment without uv, and a traceback."""
    if not shutil.which("make"):
        pytest.skip("there is no make")
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\necho "<$PIP_DRY_RUN$UV_DRY_RUN>"\n')
    python.chmod(0o755)
    call = ["make", "-s", f"PYTHON={python}", f"BIN={tmp_path}", f"{tmp_path}/ready"]
    options = {"cwd": ROOT, "capture_output": True, "text": True}
    wishes = os.environ | {"PIP_DRY_RUN": "1", "UV_DRY_RUN": "1"}
    assert subprocess.run(call, env=wishes, **options).stdout == "<>\n"
