"""The benchmarks are not timed here; a few cases of each run, and their outcome is tested."""

import re
from contextlib import nullcontext
from importlib import import_module
from types import SimpleNamespace

import bench_synthesis
import numpy as np
import pytest
import regions
import runner
import survey
import whole_way


@pytest.fixture
def page(tmp_path, monkeypatch):
    """A page with a section, in the place of performance.md."""
    path = tmp_path / "figures" / "performance.md"
    path.parent.mkdir()
    monkeypatch.setattr(runner, "ROOT", tmp_path)
    one_process = nullcontext(SimpleNamespace(map=map))
    monkeypatch.setattr(runner, "ProcessPoolExecutor", lambda: one_process)

    def written(section, function, *arguments):
        path.write_text(f"one\n<!-- {section} -->\nold\n<!-- end of {section} -->\ntwo\n")
        failed = function(*arguments)
        assert not failed
        above, text, below = re.split("<!-- .* -->\n", path.read_text())
        assert (above, below) == ("one\n", "two\n")
        return text

    return written


@pytest.mark.parametrize(
    ("name", "few", "said"),
    [
        (  # of five, one is infeasible, and CVXPY says the same
            "survey",
            [(4, 11, 12, 44, 338)],
            r"^5 problems: 4 end with a certified filter, 1 are infeasible, 0 fail\."
            r".*M_max of 1 of the 1 infeasible .* of the 3 that .* one plant: 3 end",
        ),
        (
            "whole_way",
            [[("motor", 1.0, 4), ("levitation", 1.0, 4), ("motor", -3.0, 4)]],  # too light to hold
            r"\| motor \| 1 \| 1 \| 0.01 \| 0\.00\d+ \| 0\.12\d* \| 3\.36 \| 0\.0\d+ \| 0\.05"
            r" \|  \| learned \|.*\| none \|.*3 ways: 2 learned, 1 said so",
        ),
    ],
)
def test_a_few_cases_run_and_are_counted(name, few, said, page):
    assert re.search(said, page(name, import_module(name).main, *few), re.DOTALL)


def test_regions_are_counted(monkeypatch):
    """A kind that is known, one with filters, and one that is refused."""
    monkeypatch.setattr(regions, "RECORDS", 2)
    row = regions.counted("resonance, noise")
    assert len(row) == len(regions.TITLES) and row[-1] == "2, 2" and row[3:5] == ["100.0%"] * 2
    row = regions.counted("a loop without its reference")
    assert row[2:8] == [""] * 6 and row[8:10] == ["2", "2"]


def test_what_fails_or_learns_nothing_in_silence_is_counted(monkeypatch):
    late = {"rms": np.array([1.0, 0.01, 0.3]), "noise": 0.01, "said": []}
    assert whole_way.end_of(late) == "silent"
    monkeypatch.setattr(survey, "synthesise", lambda *arguments, **options: 1 / 0)
    assert survey.outcome(4)["end"].startswith("ZeroDivisionError")


def test_what_is_timed_runs_and_its_time_and_memory_are_a_table(page, monkeypatch):
    """That all methods find the same filter, toolbox/tests/test_base.py tests."""
    monkeypatch.setattr(bench_synthesis, "measured", lambda function, arguments, calls: (calls, 7))
    *rows, _, _ = page("performance", bench_synthesis.main, (60,)).splitlines()
    assert rows[-1] == "| full | 60 | CVXPY, batched | 2.00 | 0.222 | 7 |" and len(rows) == 2 + 6
    problem = *bench_synthesis.paper_problem(60), "full"
    assert 0 <= bench_synthesis.added_memory(bench_synthesis.of_the_model, problem) < 500
