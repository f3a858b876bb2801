"""Each door has an example of a few lines, which runs as it stands, and says where else to look."""

import doctest
import inspect
import re
from functools import reduce

import matplotlib.pyplot as plt
import pytest

import ilctools
import rodlib
from ilctools.synthesis.result import Synthesis

OTHERS = {"MISMATCHED", "errors"}  # a rod, and a room
DOORS = sorted({*ilctools.__all__, *rodlib.__all__} - OTHERS)
NOT_DOORS = {"Synthesis": Synthesis}  # which one gets from a door


def door(name):
    """By its name, which is in one of the two packages."""
    return getattr(ilctools if name in ilctools.__all__ else rodlib, name)


@pytest.mark.parametrize("name", DOORS)
def test_the_example_of_a_door_runs(name, tmp_path, monkeypatch):
    """In a folder of its own, with warnings as errors; output to the letter."""
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(door(name))
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples and text.rpartition("\n\n")[2].startswith("Examples\n---")
    assert any(step.want for step in example.examples)
    assert any(name in step.source for step in example.examples)
    said = []
    results = doctest.DocTestRunner().run(example, out=said.append)
    plt.close("all")
    assert results.attempted and not results.failed, "".join(said)


@pytest.mark.parametrize("name", DOORS)
def test_see_also_leads_to_what_is_there(name):
    text = inspect.getdoc(door(name))
    (section,) = re.findall(r"^See Also\n-{8}\n((?:.+\n?)+)", text, re.MULTILINE)
    for line in section.splitlines():
        target, words = line.split(" : ")
        first, *rest = target.removeprefix("rodlib.").split(".")
        thing = NOT_DOORS.get(first) or door(first)
        assert name in rodlib.__all__ or first not in rodlib.__all__
        assert reduce(getattr, rest, thing) and words and first != name
