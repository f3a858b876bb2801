"""The benchmarks are not timed here; a few cases of each run, and their outcome is tested."""

import re
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from types import SimpleNamespace

import bench_synthesis
import other_parameters
import pytest
import regions
import runner


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


def test_regions_are_counted(page, monkeypatch):
    """A kind with filters, and one that is refused."""
    monkeypatch.setattr(regions, "RECORDS", 2)
    kinds = ["resonance, noise", "a loop without its reference"]
    known, refused = rows = [*runner.run(regions.counted, kinds)]
    with ThreadPoolExecutor(1) as threads:  # another executor
        assert [*runner.run(regions.counted, kinds[1:], threads)] == [refused]
    assert len(known) == len(regions.TITLES) and known[-1] == "2, 2"
    assert known[3:5] == ["100.0%"] * 2
    assert refused[2:8] == [""] * 6 and refused[8:10] == ["2", "2"]
    lines = page("regions", runner.publish, "regions", runner.table(regions.TITLES, rows))
    assert lines.splitlines()[2:] == [f"| {' | '.join(row)} |" for row in rows]


def test_what_is_timed_runs_and_its_time_and_memory_are_a_table(page, monkeypatch):
    """That all methods find the same filter, toolbox/tests/test_channels.py tests."""
    monkeypatch.setattr(bench_synthesis, "measured", lambda function, arguments, calls: (calls, 7))
    *rows, _, _ = page("performance", bench_synthesis.main, (60,)).splitlines()
    assert rows[-1] == "| full | 60 | CVXPY, batched | 2.00 | 0.222 | 7 |" and len(rows) == 2 + 6
    problem = *bench_synthesis.paper_problem(60), "full"
    assert 0 <= bench_synthesis.added_memory(bench_synthesis.of_the_model, problem) < 500


@pytest.mark.parametrize(
    ("name", "parameters", "outcome", "said"),
    [  # of some 300 runs these had ended worst: in errors of Python and of NumPy
        ("08-alternatives", {"slowest": 0.9, "evaluations": 9}, "own error", "no filter of 9 has"),
        ("10-measurement", {"M_max": 0.65, "hours": 2.0}, "own error", "smallest feasible M_max"),
    ],
)
def test_a_notebook_with_other_parameters_ends_sensibly(name, parameters, outcome, said):
    with ProcessPoolExecutor(1) as pool:  # a run changes the folder and the backend
        ended, text, _ = pool.submit(other_parameters.ended, name, parameters).result()
    assert ended == outcome and said in text


def test_parameters_are_drawn_within_their_ranges():
    name = "03-ilc-synthesis"
    of, values = other_parameters.ranges(name), {}
    assert of["order"] == [10, 1, 60]
    for number in range(200):
        values = other_parameters.drawn(name, number, 0)
        assert 1 <= len(values) <= other_parameters.MOST_AT_ONCE
        for key, value in values.items():
            _, least, most = of[key]
            assert least <= value <= most and isinstance(value, type(least))
    assert values == other_parameters.drawn(name, 199, 0) != other_parameters.drawn(name, 199, 1)
