"""Each recipe of the Makefile begins: what it calls is there, and its Python imports all it needs.

`make -n` prints what a recipe would run. A module or a script among it is imported with the path of
the recipe, without its main part; other programs must be installed.
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

TARGETS = re.findall(r"^(\w+):.*##", (ROOT / "Makefile").read_text(), re.MULTILINE)
WORDS = {"measure": "WHAT=regions", "machines": "SEED=2"}  # that a recipe needs
COMMAND = re.compile(
    r"(?:^|[;&]) *(?:PYTHONPATH=(?P<path>\S+) |\w+=\S+ )?\S*\.venv/bin/"
    r"(?P<program>[\w-]+) (?P<module>-m )?(?P<first>\S+)",
    re.MULTILINE,
)
IMPORT = {
    True: "import importlib, sys; importlib.import_module(sys.argv[1])",
    False: "import runpy, sys; runpy.run_path(sys.argv[1], run_name='begun')",
}


def make(*words):
    own = {name: value for name, value in os.environ.items() if "MAKE" not in name}
    call = ["make", "--no-print-directory", "PYTHON=true", *words]
    return subprocess.run(call, cwd=ROOT, env=own, capture_output=True, text=True)


@pytest.mark.parametrize("target", TARGETS)
def test_a_recipe_begins(target):
    planned = make("-n", target, *filter(None, [WORDS.get(target)]))
    commands = [*COMMAND.finditer(planned.stdout)]
    assert planned.returncode == 0 and (commands or target in ("help", "clean"))
    for command in commands:
        program = Path(sys.executable).with_name(command["program"])
        assert program.exists(), program
        if command["program"] == "python":
            folder = ROOT / Path(command["first"]).parent  # of a script, which it imports from
            path = os.pathsep.join(map(str, filter(None, [folder, command["path"]])))
            call = [program, "-c", IMPORT[bool(command["module"])], command["first"]]
            subprocess.run(call, cwd=ROOT, env=os.environ | {"PYTHONPATH": path}, check=True)


@pytest.mark.parametrize("name", ["nope", "runner"])
def test_a_measurement_that_is_not_there_is_said_with_those_that_are(name):
    outcome = make("measure", f"WHAT={name}")
    assert outcome.returncode
    assert outcome.stderr.startswith(f"WHAT={name} is not there; these are:\nmake: ***")
    listed = re.findall(r"^make measure WHAT=(\w+) +\S", outcome.stdout, re.MULTILINE)
    having = {path.stem for path in ROOT.glob("benchmarks/*.py") if "__main__" in path.read_text()}
    assert {*listed} == having and len(listed) > 1
    alone = make("measure")
    assert alone.stdout == outcome.stdout and "is not there" not in alone.stderr


@pytest.mark.parametrize("seed", ["x", "-1", "1.5", "1 2"])
def test_a_seed_that_is_none_is_said_in_a_sentence(seed):
    call = [sys.executable, ROOT / "tools" / "machines.py", *seed.split()]
    outcome = subprocess.run(call, capture_output=True, text=True)
    assert outcome.returncode == 1 and not outcome.stdout
    assert outcome.stderr.startswith(f"SEED={seed} must be a whole number")
    assert outcome.stderr.count("\n") == 1
