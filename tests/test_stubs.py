"""An editor completes and checks what `rodlib` gives: stubs and annotations of its doors."""

import doctest
import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import stubs
from documented import DOORS, door, examples

import ilctools
import rodlib

FOLDER, TOOLS = (Path(package.__file__).parent for package in (rodlib, ilctools))
TYPED = """
from ilctools import Law, synthesise, zero_phase_butterworth
from rodlib import Rod, paper_loop

law: Law = synthesise(paper_loop(Rod()), zero_phase_butterworth(2, 0.1, 1.0)).law()
"""
WRONG = {  # what a checker must name
    "`synthesize`": "from ilctools import synthesize\n",
    "`str`": TYPED + "wrong: str = law\n",
    "`ordr`": TYPED + "synthesise(paper_loop(), None, ordr=3)\n",
    "`Mute`": "import ilctools, rodlib\n\n\nclass Mute:\n    def read(self):\n"
    "        return [0.0]\n\n\nilctools.shake(Mute(), rodlib.paper_loop(), None)\n",
}


def test_stubs_are_those_of_the_registry():
    for path, text in stubs.stubs().items():
        assert path.read_text(encoding="utf-8") == text, "make stubs"
    assert all(path.with_name("py.typed").exists() for path in stubs.stubs())


@pytest.fixture(scope="module")
def check(tmp_path_factory):
    """What the type checker ty finds in a text, by its rules."""
    beside = os.path.dirname(sys.executable)
    ty = shutil.which("ty", path=os.pathsep.join([beside, os.environ.get("PATH", "")]))
    if ty is None:
        pytest.skip("there is no type checker ty")
    folder = tmp_path_factory.mktemp("typed")

    def run(text):
        (folder / "snippet.py").write_text(text, encoding="utf-8")
        call = [ty, "check", "--output-format", "concise", "--python", sys.prefix]
        call += ["--extra-search-path", FOLDER.parent, "--extra-search-path", TOOLS.parent]
        call += ["snippet.py"]
        return subprocess.run(call, cwd=folder, capture_output=True, text=True).stdout

    return run


def test_what_is_documented_is_typed(check):
    """The examples of the documents and of each door."""
    paths = ("README.md", "docs/guide.md", "docs/questions.md")
    documents = [block for path in paths for block in examples(path)]
    of_doors = [doctest.script_from_examples(inspect.getdoc(door(name))) for name in DOORS]
    assert "All checks passed" in check("\n".join([TYPED, *documents, *of_doors]))


@pytest.mark.parametrize("name", WRONG)
def test_the_type_checker_sees_what_is_wrong(check, name):
    said = check(WRONG[name])
    assert "error[" in said and name in said
