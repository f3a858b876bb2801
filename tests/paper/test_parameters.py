"""The parameters of notebooks: ranges, and what is said of a choice that the text does not know."""

import ast

import nbformat
import pytest

from rodlib.paper.parameters import checked
from rodlib.paper.repository import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("M_max", [0.1, 0.9, 1])
@pytest.mark.parametrize("trials", [2, 50])
def test_values_in_their_range_come_back_as_they_are(M_max, trials):
    given = {
        "M_max": (M_max, 0.9, 0.1, 1.0),
        "trials": (trials, 10, 2, 50),
        "log": ("", ""),
    }
    assert checked(**given) == {"M_max": M_max, "trials": trials, "log": ""}


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"M_max": (1.5, 0.9, 0.1, 1.0)},
            "M_max = 1.5 must be a number from 0.1 to 1$",
        ),
        (
            {"M_max": (0.09, 0.9, 0.1, 1.0)},
            "M_max = 0.09 must be a number from 0.1 to 1$",
        ),
        (
            {"M_max": ("0.9", 0.9, 0.1, 1.0)},
            "M_max = '0.9' must be a number from 0.1 to 1$",
        ),
        (
            {"M_max": (float("nan"), 0.9, 0.1, 1.0)},
            "M_max = nan must be a number from 0.1 to 1$",
        ),
        (
            {"trials": (1, 10, 2, 50)},
            "trials = 1 must be a whole number, from 2 to 50$",
        ),
        (
            {"trials": (51, 10, 2, 50)},
            "trials = 51 must be a whole number, from 2 to 50$",
        ),
        (
            {"trials": (7.5, 10, 2, 50)},
            "trials = 7.5 must be a whole number, from 2 to 50$",
        ),
        (
            {"trials": (9, 10, 2, 50), "first": (12, 5, 1, 9)},
            "first = 12 must be .* from 1 to 9$",
        ),
    ],
)
def test_what_is_out_of_range_is_refused_in_a_sentence(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        checked(**given)


def test_other_choices_than_those_of_the_text_are_told_of(monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", lambda text: shown.append(text.data))
    checked(M_max=(0.9, 0.9, 0.1, 1.0), log=("", ""))
    assert shown == []
    checked(M_max=(0.85, 0.9, 0.1, 1.0), trials=(10, 10, 2, 50), log=("a.csv", ""))
    (text,) = shown
    assert text.startswith(
        "**`M_max = 0.85`, `log = 'a.csv'`; the text was written for `0.9`, `''`.**"
    )
    assert "trials" not in text


def checks(source):
    """The arguments of calls of `checked`, by name, each a list of expressions."""
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    calls = [call for call in calls if getattr(call.func, "id", "") == "checked"]
    return {word.arg: word.value.elts for call in calls for word in call.keywords}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_each_parameter_of_a_notebook_is_checked_in_the_cell_below(path):
    """By its own name and with the default that stands in the cell of the parameters."""
    cells = [
        c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"
    ]
    chosen = {s.target.id: s.value for s in ast.parse(cells[1].source).body}
    below = checks(cells[2].source)
    assert [*below] == [*chosen]
    for name, (value, default, *ends) in below.items():
        assert value.id == name
        assert ast.literal_eval(default) == ast.literal_eval(chosen[name]), name
        assert (
            len(ends) == 2
            or not isinstance(ast.literal_eval(default), int | float)
            or (isinstance(ast.literal_eval(default), bool))
        )
