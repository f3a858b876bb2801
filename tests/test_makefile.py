"""Each recipe of the Makefile begins: what it calls is there, and its Python imports all it needs.

A recipe runs in a folder that has links to what is in the repository. Its Python imports the module
or the script of the recipe under the environment of the recipe, and stops before the main part. Its
other programs are noted, if they are installed.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rodlib.paper.repository import ROOT

pytestmark = pytest.mark.skipif(not shutil.which("make"), reason="there is no make")

PYTHON = """#!/bin/sh
exec "{python}" "{begin}" "$@"
"""
BEGIN = """
import importlib, os, runpy, sys

sys.path.insert(0, os.getcwd())  # as `python -m` does
first, *others = sys.argv[1:]
if first == "-m":
    importlib.import_module(others[0])
else:
    sys.argv = [first, *others]
    sys.path[0] = os.path.dirname(os.path.abspath(first))  # as `python script` does
    runpy.run_path(first, run_name="begun")
print("begun:", others[0] if first == "-m" else first)
"""
PROGRAM = """#!/bin/sh
test -e "{program}" || exit 127
echo "begun: {name}"
"""
# What begins, by the words that make is given; what would run for minutes does not.
BEGUN = {
    "help": [],
    "reproduce": ["rodlib.paper.reproduce"],
    "test": ["tools/suite.py"],
    "lint": ["ruff", "ruff", "tools/rooms.py"],
    "data": ["rodlib.paper.rig_logs"],
    "machines SEED=2": ["tools/machines.py"],
    "mutants": ["mutmut"] * 4,
    "lowest": ["uv"] * 3 + ["build/lowest/bin/pytest"],
    "newest": ["uv"] * 2 + ["build/newest/bin/pytest"],
    "measure WHAT=survey": ["benchmarks/survey.py"],
    "measure WHAT=peers": ["benchmarks/peers.py"],  # which tests/test_benchmarks.py does not run
    "pages": ["sphinx-build"],
    "bench": ["benchmarks/bench_synthesis.py"],
    "lab": ["jupyter"],
    "notebooks": ["jupyter"],
    "stubs": ["tools/stubs.py"],
    "lock": ["uv"] * 2,
    "clean": [],
}


def executable(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path):
    """Links to what is in the repository, and programs that begin and stop."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    for path in ROOT.iterdir():
        if path.name not in ("build", ".venv", "mutants"):  # what recipes remove
            (folder / path.name).symlink_to(path)
    begin, programs = folder / ".begin.py", folder / ".programs"
    begin.write_text(BEGIN)
    executable(programs / "python", PYTHON.format(python=sys.executable, begin=begin))
    for name in ("jupyter", "mutmut", "ruff", "sphinx-build", "uv"):
        installed = Path(sys.executable).with_name(name)
        executable(programs / name, PROGRAM.format(program=installed, name=name))
    for kind in ("lowest", "newest"):  # which uv would install
        path = f"build/{kind}/bin/pytest"
        executable(folder / path, PROGRAM.format(program=sys.executable, name=path))
    return folder


def run(folder, *words):
    call = ["make", "--no-print-directory", "PYTHON=true", "BIN=.programs", *words]
    own = {name: value for name, value in os.environ.items() if "MAKE" not in name}
    return subprocess.run(call, cwd=folder, env=own, capture_output=True, text=True)


def test_each_recipe_is_tried():
    phony = re.search(
        r"^\.PHONY: \$\(BIN\)/ready (.*?)[^\\]\n", (ROOT / "Makefile").read_text(), re.M | re.S
    )
    targets = {*phony[0].replace("\\\n", " ").split()[2:]}
    assert targets == {words.split()[0] for words in BEGUN}


@pytest.mark.parametrize("words", BEGUN)
def test_a_recipe_begins(words, checkout):
    outcome = run(checkout, *words.split())
    assert outcome.returncode == 0, outcome.stderr
    assert re.findall(r"^begun: (.*)$", outcome.stdout, re.MULTILINE) == BEGUN[words]


@pytest.mark.parametrize("name", ["nope", "runner"])
def test_a_measurement_that_is_not_there_is_said_with_those_that_are(name, checkout):
    outcome = run(checkout, "measure", f"WHAT={name}")
    assert outcome.returncode and "begun" not in outcome.stdout
    sentence, *of_make = outcome.stderr.splitlines()
    assert sentence == f"WHAT={name} is not there; these are:"
    assert all(line.startswith("make: ***") for line in of_make)
    listed = re.findall(r"^make measure WHAT=(\w+) +\S", outcome.stdout, re.MULTILINE)
    having = {path.stem for path in ROOT.glob("benchmarks/*.py") if "__main__" in path.read_text()}
    assert {*listed} == having and len(listed) > 3
    alone = run(checkout, "measure")
    assert alone.stdout == outcome.stdout and "is not there" not in alone.stderr


@pytest.mark.parametrize("seed", ["x", "-1", "1.5", "1 2"])
def test_a_seed_that_is_none_is_said_in_a_sentence(seed):
    call = [sys.executable, ROOT / "tools" / "machines.py", *seed.split()]
    outcome = subprocess.run(call, capture_output=True, text=True)
    assert outcome.returncode == 1 and not outcome.stdout
    assert outcome.stderr.startswith(f"SEED={seed} must be a whole number")
    assert outcome.stderr.count("\n") == 1
