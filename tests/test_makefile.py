"""Each recipe of the Makefile begins: what it calls is there, and its Python imports all it needs.

`make -n` prints what a recipe would run. A module or a script among it is imported with the path of
the recipe, without its main part; other programs must be installed.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from books import text

from rodlib.paper.repository import ROOT

pytestmark = pytest.mark.skipif(not shutil.which("make"), reason="there is no make")

TARGETS = re.findall(r"^(\w+):.*##", text("Makefile"), re.MULTILINE)
WORDS = {"measure": "WHAT=regions", "machines": "SEED=2"}  # that a recipe needs
COMMAND = re.compile(
    r"(?:^|[;&]) *(?:PYTHONPATH=(?P<path>\S+) |\w+=\S+ )?\S*\.venv/bin/"
    r"(?P<program>[\w-]+) (?P<module>-m )?(?P<first>\S+)",
    re.MULTILINE,
)
# Each import in a process of its own, which has the packages that most of them need.
IMPORT = """
import importlib, json, os, runpy, sys
import control, matplotlib.pyplot, pandas, scipy.ndimage, scipy.optimize, xarray

for folders, module, first in json.loads(sys.argv[1]):
    if os.fork() == 0:
        sys.path[:0] = folders
        importlib.import_module(first) if module else runpy.run_path(first, run_name="begun")
        break
    _, status = os.wait()
    if status:
        sys.exit(f"{first} does not begin")
"""


def make(*words):
    own = {name: value for name, value in os.environ.items() if "MAKE" not in name}
    call = ["make", "--no-print-directory", "PYTHON=true", *words]
    return subprocess.run(call, cwd=ROOT, env=own, capture_output=True, text=True)


def test_recipes_begin():
    imports = []
    for target in TARGETS:
        planned = make("-n", target, *filter(None, [WORDS.get(target)]))
        commands = [*COMMAND.finditer(planned.stdout)]
        assert planned.returncode == 0 and (commands or target in ("help", "clean")), target
        for command in commands:
            program = Path(sys.executable).with_name(command["program"])
            assert program.exists(), program
            if command["program"] == "python":
                folder = Path(command["first"]).parent  # of a script, which it imports from
                folders = [str(ROOT / path) for path in (folder, command["path"]) if path]
                imports.append([folders, command["module"], command["first"]])
    assert len(imports) > 7
    subprocess.run([sys.executable, "-c", IMPORT, json.dumps(imports)], cwd=ROOT, check=True)


@pytest.mark.parametrize("name", ["nope", "runner"])
def test_a_measurement_that_is_not_there_is_said_with_those_that_are(name):
    outcome = make("measure", f"WHAT={name}")
    assert outcome.returncode
    assert outcome.stderr.startswith(f"WHAT={name} is not there; these are:\nmake: ***")
    listed = re.findall(r"^make measure WHAT=(\w+) +\S", outcome.stdout, re.MULTILINE)
    having = {path.stem for path in ROOT.glob("benchmarks/*.py") if "__main__" in text(path)}
    assert {*listed} == having and len(listed) > 1
    alone = make("measure")
    assert alone.stdout == outcome.stdout and "is not there" not in alone.stderr
