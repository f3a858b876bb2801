"""The five notebooks of the paper: its equations as code, and what to try.

And of all notebooks: what they import, and that the ledger is written in one cell.
"""

import io
import re
import warnings
from contextlib import redirect_stdout

import matplotlib.pyplot as plt
import pytest
from books import BOOKS, cells, code, prose
from other_parameters import begun, run_cell

from rodlib.paper import ROOT

PAPER = [name for name in BOOKS if "01" <= name < "06"]
PRINTED = range(1, 47)  # equations of the paper


def shown(name):
    """The sources of the code cells that are not folded."""
    return [cell.source for cell in cells(name) if not cell.metadata.get("jupyter", {})]


def test_every_equation_of_the_paper_has_a_line_of_code():
    numbers = set()
    for name in PAPER:
        for line in "\n".join(shown(name)).splitlines():
            _, _, comment = line.partition("#")
            tags = [int(tag) for tag in re.findall(r"\((\d+)\)", comment)]
            assert len(tags) <= 2, line
            numbers |= {*tags}
    assert numbers == {*PRINTED}


@pytest.mark.parametrize("name", PAPER)
def test_a_notebook_of_the_paper_asks_and_suggests(name):
    assert "**Question**" in prose(name) and "**Try**" in prose(name)


@pytest.mark.parametrize("name", BOOKS)
def test_notebooks_enter_by_the_doors_and_write_the_ledger_once(name):
    sources = code(name)
    for package in re.findall(
        r"^\s*(?:from|import) ((?:rodlib|ilctools)[\w.]*)", "\n".join(sources), re.M
    ):
        assert package in ("rodlib", "ilctools", "rodlib.paper")
    assert not any("ledger.record(" in source for source in sources[:-1])


TRIED = [
    ("01-model", {"degree": 1}, [r"\[0\.9653 0\.9653\]", r"M = 1, 4 states: differs by 18\.0%"]),
    ("01-model", {"degree": 4}, [r"\[1\.1541 1\.1541"]),
    ("01-model", {"length": 2.0}, ["M = 3: zeros with Re s > 0: none"]),
    ("02-feedback", {"R_s": 0.5}, ["state feedback: .* 171 s"]),
    (
        "02-feedback",
        {"Q_o": 20.0},
        ["observer: .* 102 s", "without the observer is the same: True"],
    ),
    (
        "03-ilc-synthesis",
        {"M_max": 0.85},
        [r"synthesise +227\.9\d+ .* 4\.8\n", r"price of M_max: 51\d\d\."],
    ),
    ("04-simulation", {"first_disturbed": 2}, [r"2\.08 1\.23 .* 0\.01\n"]),
    ("05-experiment-replay", {"unmeasured": []}, [r"\n10 +0\.053 +0\.032 +1\.7"]),
]
# of notebook 3, in cells that take seconds and that no outcome needs
LONG = ("simulated = run_trials(", "strict = synthesise(", "def proven(")


def outputs(name, parameters, monkeypatch, tmp_path):
    """What each cell but the ledger's and the long ones prints, with other parameters.

    Pictures are not saved.
    """
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path))
    monkeypatch.chdir(ROOT / "notebooks")
    with warnings.catch_warnings(action="ignore"), plt.rc_context():
        names, sources = begun(name)
        names |= parameters | {"save": lambda *_: plt.close()}
        for source in sources[:-1]:
            if any(text in source for text in LONG):
                continue
            with redirect_stdout(io.StringIO()) as printed:
                run_cell(source, names)
            yield printed.getvalue()


@pytest.mark.parametrize(("name", "parameters", "outcome"), TRIED)
def test_what_the_notebooks_suggest_to_try_comes_out(
    name, parameters, outcome, monkeypatch, tmp_path
):
    (parameter,) = parameters
    suggestion = prose(name).partition("**Try**")[2]
    assert f"`{parameter} = {parameters[parameter]!r}`" in suggestion
    text, missing = "", outcome
    for printed in outputs(name, parameters, monkeypatch, tmp_path):
        text += printed
        missing = [expected for expected in missing if not re.search(expected, text)]
        if not missing:
            break
    assert not missing
