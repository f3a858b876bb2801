"""The benchmarks are not timed here; that they can be run, and what is made of them, is tested."""

import ast
import json
import pickle
import sys

import nbformat
import numpy as np
import pytest

from rodlib.paper.repository import ROOT

FOLDER = ROOT / "tests" / "benchmarks"


@pytest.fixture
def benchmarks(monkeypatch):
    """The modules of the benchmarks can be imported."""
    pytest.importorskip("pytest_benchmark")
    monkeypatch.syspath_prepend(FOLDER)
    yield
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def entry(group, x, time):
    extra = {"x": x, "memory": 10 * time}
    return {"group": group, "extra_info": extra, "stats": {"min": time}}


def test_ratios_and_exponents_are_those_of_the_times(benchmarks, monkeypatch, tmp_path):
    import report

    entries = [
        entry("diagonal, 250", "structured", 0.2),
        entry("diagonal, 250", "cvxpy", 3.0),
    ]
    entries += [entry("size", x, 0.01 * x**2) for x in (1, 2, 3, 4)]
    entries += [entry("order", x, 0.1 * x) for x in (5, 10, 20)]
    entries += [
        entry("trials", "one_by_one", 2.2),
        entry("trials", "judged", 0.2),
    ]
    entries.append(entry("alternatives", "P-type", 0.004))
    cpu = {"brand_raw": "a processor", "count": 3}
    machine = {"cpu": cpu, "python_version": "3.12", "machine": ""}
    times, page = tmp_path / "times.json", tmp_path / "figures" / "performance.md"
    page.parent.mkdir()
    times.write_text(json.dumps({"benchmarks": entries, "machine_info": machine}))
    page.write_text(
        "before\n<!-- performance -->\nold\n<!-- end of performance -->\nafter\n"
    )
    (tmp_path / "pyproject.toml").write_text('name = "rodlib"')  # a clone, by its looks
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path / "results"))
    monkeypatch.setattr(report, "checkout", lambda name: tmp_path)
    report.main(times)
    lines = page.read_text().splitlines()
    assert "| diagonal | 250 | structured | 0.20 | 1 | 2 |" in lines
    assert "| diagonal | 250 | CVXPY, batched | 3.00 | 15 | 30 |" in lines
    assert "| size | 1 | 4 | 0.01 to 0.16 | 2.0 | 0 to 2 |" in lines
    assert "| order | 5 | 20 | 0.50 to 2.00 | 1.0 | 5 to 20 |" in lines
    assert "A study of many rods is 11 times as fast, rod by rod, as" in lines
    assert "Measured on: a processor, 3 cores, Python 3.12." in lines
    assert lines[0] == "before" and lines[-1] == "after" and "old" not in lines
    assert (tmp_path / "figures" / "performance.png").stat().st_size > 1000


def test_what_is_measured_travels_to_another_process(benchmarks, monkeypatch):
    """Memory is that of a fresh process, which gets the function and its arguments pickled."""
    import bench_synthesis

    sent = []
    monkeypatch.setattr(
        bench_synthesis, "measure", lambda *a, **k: sent.append((a[3:], k))
    )
    for method in ("structured", "all", "cvxpy"):
        bench_synthesis.test_many_plants(None, method)
    bench_synthesis.test_growth_with_size(None, 2)
    for call in sent:
        pickle.dumps(call)
    assert len(sent) == 4


def test_three_other_settings_of_parameters_that_each_notebook_has(benchmarks):
    import parameters

    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    assert [*parameters.SETTINGS] == [path.name[:2] for path in notebooks]
    for path in notebooks:
        cells = [c for c in nbformat.read(path, 4).cells if c.cell_type == "code"]
        chosen = {s.target.id: s.value for s in ast.parse(cells[1].source).body}
        settings = parameters.SETTINGS[path.name[:2]]
        assert len(settings) == 3
        for setting in settings:
            assert {*setting} <= {*chosen}, path.stem
            assert setting != {name: ast.literal_eval(chosen[name]) for name in setting}


@pytest.mark.parametrize(
    ("name", "frames", "sentence"),
    [
        ("ValueError", ["cell", "File /a/rodlib/ilc/arguments.py:31, in number"], True),
        (
            "ValueError",
            ["cell", "\x1b[31m----> 5\x1b[0m     raise ValueError(message)"],
            True,
        ),
        (
            "ValueError",
            ["cell", "----> 5 axes.plot(x, y)", "File matplotlib/axes.py:7"],
            False,
        ),
        ("KeyError", ["cell", "File /a/rodlib/ilc/arguments.py:31, in number"], False),
    ],
)
def test_a_check_of_ours_ends_in_a_sentence_and_all_else_in_a_traceback(
    benchmarks, name, frames, sentence
):
    import parameters

    error = parameters.papermill.PapermillExecutionError(0, 1, "", name, "", frames)
    assert parameters.is_a_sentence(error) == sentence


@pytest.mark.parametrize("name", ["motor", "levitation"])
def test_a_kind_of_plant_goes_the_whole_way(benchmarks, name):
    import whole_way

    row = whole_way.outcome(name, trials=4)
    assert row["end"] == "learned" and not row["said"] and row["kept"] == 2
    assert row["promised"] < 0.2 and row["on the rig"] < 0.2
    assert row["rms"][-1] < row["rms"][0] / 10
    assert "law: the recorded v is that of the law in every trial" in row["summary"]
    table = whole_way.table_of([row])
    assert table.splitlines()[-1].startswith(f"| {name} | 1 | 1 | 0.0")


def test_a_kind_that_does_not_learn_is_well_only_if_somebody_says_so(
    benchmarks, monkeypatch
):
    import whole_way

    row = whole_way.outcome("motor", -3.0, trials=4)  # so light that no loop holds it
    assert (
        row["end"] == "said so"
        and "on the rig" not in row
        and "unstable" in row["words"]
    )
    assert "| none |" in whole_way.table_of([row])
    assert whole_way.end_of(row | {"words": []}) == "silent"
    assert whole_way.end_of(row | {"words": ["?"]}) == "said what is not known"
    late = {"rms": np.array([1.0, 0.01, 0.3]), "noise": 0.01, "words": []}
    assert whole_way.end_of(late) == "silent"
    monkeypatch.setattr(whole_way, "record", lambda *a, **k: 1 / 0)
    assert whole_way.outcome("motor", trials=4)["end"].startswith("ZeroDivisionError")
