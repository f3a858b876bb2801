"""Exercises of the notebooks: as many as a reader expects, and answers that print what they say."""

import re

import matplotlib.pyplot as plt
import pytest
from books import BOOKS, code, prose

from rodlib.paper import ROOT

TAUGHT = [name for name in BOOKS if name < "06"]  # these have exercises of several levels
LEVELS = {"easy", "pencil and paper", "harder"}
ANSWER = re.compile(r"<details><summary>Answer</summary>(.*?)</details>", re.DOTALL)
RUN = re.compile(r"```python\n(.*?)```\n+```text\n(.*?)```", re.DOTALL)
CALL = re.compile(r"\b([a-z]\w+)\(")


def exercises(name):
    """The exercises of a notebook, as (level, question, answer)."""
    _, *parts = re.split(r"^\*\*Exercise \d+\*\* \(", prose(name), flags=re.MULTILINE)
    for part in parts:
        level, _, rest = part.partition(")")
        (answer,) = ANSWER.findall(rest)
        assert answer.count("```python") == len(RUN.findall(answer)), f"{name}: {level}"
        yield level, rest.partition("<details>")[0], answer


@pytest.mark.parametrize("name", BOOKS)
def test_a_notebook_has_exercises_with_answers(name):
    levels = [level for level, *_ in exercises(name)]
    assert {*levels} <= LEVELS
    if name in TAUGHT:
        assert len(levels) >= 3 and "pencil and paper" in levels and {*levels} > {"easy"}
    else:
        assert levels


ANSWERS = [
    pytest.param(*run, name, id=f"{name}-{number}")
    for name in BOOKS
    for number, (*_, answer) in enumerate(exercises(name), 1)
    for run in RUN.findall(answer)
]


@pytest.mark.parametrize(("answer", "printed", "name"), ANSWERS)
def test_an_answer_prints_what_it_says(answer, printed, name, monkeypatch, capsys):
    """By itself, as a student runs it."""
    monkeypatch.chdir(ROOT / "notebooks")
    exec(answer, {"__name__": "__main__"})
    plt.close("all")
    assert capsys.readouterr().out == printed


@pytest.mark.parametrize(("answer", "printed", "name"), ANSWERS)
def test_an_answer_calls_what_the_notebook_has_shown(answer, printed, name):
    own = {*re.findall(r"^ *def (\w+)", answer, re.MULTILINE), "print", "range", "len", "abs"}
    shown = "\n".join([*code(name), prose(name).partition("## Exercises")[0]])
    assert not {*CALL.findall(answer)} - own - {*CALL.findall(shown)}
