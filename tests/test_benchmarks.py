"""The benchmarks are not timed here; that they can be run, and what is made of them, is tested."""

import ast
import json
import os
import subprocess
import sys
from functools import cache

import nbformat
import numpy as np
import pytest

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.paper.repository import ROOT

FOLDER = ROOT / "benchmarks"


@pytest.fixture
def benchmarks(monkeypatch):
    """The modules of the benchmarks can be imported."""
    pytest.importorskip("pytest_benchmark")
    monkeypatch.syspath_prepend(FOLDER)
    yield
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def test_ratios_are_those_of_the_times(benchmarks):
    import report

    rows = ("cvxpy", 3.0, 30), ("structured", 0.2, 2)
    assert list(report.compared("diagonal, 250", rows)) == [
        ["diagonal", "250", "structured", "0.20", "1", "2"],
        ["diagonal", "250", "CVXPY, batched", "3.00", "15", "30"],
    ]


def test_a_section_is_replaced_and_nothing_else(benchmarks, monkeypatch, tmp_path):
    import runner

    page = tmp_path / "figures" / "performance.md"
    page.parent.mkdir()
    page.write_text("one\n<!-- survey -->\nold\n<!-- end of survey -->\ntwo\n")
    monkeypatch.setattr(runner, "ROOT", tmp_path)
    runner.publish("survey", runner.table(["kind", "off"], [["motor", "1"]]))
    assert "<!-- end of survey -->" in page.read_text().splitlines()  # not in the last row
    lines = page.read_text().splitlines()
    assert lines[0] == "one" and lines[-1] == "two" and "old" not in lines
    assert lines[2:4] == ["| kind | off |", "| --- | ---: |"] and "| motor | 1 |" in lines[4]


class Timed:
    """In the place of pytest-benchmark's fixture: each function is called once."""

    def __init__(self):
        self.entries = []

    def pedantic(self, function, arguments, keywords, rounds):
        function(*arguments, **keywords)
        self.entries.append({
            "group": self.group,
            "extra_info": self.extra_info,
            "stats": {"min": 1.0 if self.extra_info["x"] == "structured" else 2.0},
        })  # fmt: skip


@pytest.mark.filterwarnings("ignore")
def test_each_way_of_make_bench_runs_and_has_a_row(benchmarks, monkeypatch, tmp_path):
    import bench_synthesis
    import report

    timed, said = Timed(), {}
    monkeypatch.setattr(bench_synthesis, "peak_memory", lambda *arguments, **keywords: 10.0)
    for method in bench_synthesis.METHODS:
        timed.extra_info = {}
        bench_synthesis.test_against_cvxpy(timed, 12, method, "diagonal")
    path = tmp_path / "benchmark.json"
    machine = {"machine": "a machine", "python_version": "3", "cpu": {}}
    path.write_text(json.dumps({"benchmarks": timed.entries, "machine_info": machine}))
    monkeypatch.setattr(report, "publish", said.__setitem__)
    report.main(path)
    rows = said["performance"].split("\n\n")[0].splitlines()
    assert rows[2] == "| diagonal | 12 | structured | 1.00 | 1 | 10 |"
    assert len(rows) == 2 + len(bench_synthesis.METHODS) and "a machine" in said["performance"]


@pytest.mark.filterwarnings("ignore")
def test_what_is_timed_solves_the_same_problem(benchmarks):
    import bench_synthesis

    problem = bench_synthesis.paper_problem(250)  # with fewer, ours adds some in between
    ours = bench_synthesis.structured(*problem, structure="full")
    _, value = bench_synthesis.by_cvxpy(*problem, "full")
    assert ours.value == pytest.approx(value, rel=1e-4)  # of Clarabel, "almost solved"
    assert bench_synthesis.for_rods(3, 30).certificate.grid_M <= 0.99 * (1 + 1e-6)


def test_make_bench_runs_and_measures_memory(tmp_path):
    """As it stands in the Makefile, but for the file, and one case of all."""
    pytest.importorskip("pytest_benchmark")
    path = tmp_path / "benchmark.json"
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    command = makefile.split("$(BIN)/pytest -q benchmarks/bench_*.py ")[1].split("$(BIN)")[0]
    options = command.replace("\\\n", " ").replace("build/benchmark.json", str(path)).split()
    chosen = ["-k", "structured and diagonal and 250", "-p", "no:cacheprovider"]
    which = [str(FOLDER / "bench_synthesis.py"), *chosen, *options]
    # of workers, of which pytest-benchmark takes no times, it is to know nothing
    environment = {key: value for key, value in os.environ.items() if "PYTEST" not in key}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = [sys.executable, "-m", "pytest", "-q", *which]
    subprocess.run(run, cwd=ROOT, env=environment, check=True, capture_output=True)
    (entry,) = json.loads(path.read_text())["benchmarks"]
    assert entry["group"] == "diagonal, 250" and entry["extra_info"]["x"] == "structured"
    assert 1 < entry["extra_info"]["memory"] < 500 and 0 < entry["stats"]["min"] < 60


def test_make_measure_lists_what_there_is(benchmarks):
    import runner

    listed = {line.split("WHAT=")[1].split()[0] for line in runner.listed().splitlines()}
    others = {"bench_synthesis", "further", "kinds", "report", "runner", "unseen"}
    assert listed == {path.stem for path in FOLDER.glob("*.py")} - others
    assert list(runner.run(divmod, [(7, 2), (9, 4)])) == [(3, 1), (2, 1)]


def test_the_survey_counts_how_problems_end(benchmarks, monkeypatch, capsys):
    """Of five, one is infeasible, and CVXPY says the same."""
    import survey

    said = {}
    monkeypatch.setattr(survey, "run", lambda function, _: map(function, (4, 11, 12, 44, 338)))
    monkeypatch.setattr(survey, "publish", said.__setitem__)
    assert not survey.main()
    counts = "5 problems: 4 end with a certified filter, 1 are infeasible, 0 fail."
    assert said["survey"].startswith(counts)
    assert "M_max of 1 of the 1 infeasible ones" in said["survey"]
    assert "of the 3 that are certified and have one plant: 3 end" in said["survey"]
    monkeypatch.setattr(survey, "synthesise", lambda *arguments, **options: 1 / 0)
    assert survey.outcome(4)["end"].startswith("ZeroDivisionError")


def test_regions_are_counted(benchmarks, monkeypatch):
    """A kind that is known, one with filters, and one that is refused."""
    import regions

    monkeypatch.setattr(regions, "RECORDS", 2)
    row = regions.counted("resonance, noise")
    assert len(row) == len(regions.TITLES) and row[-1] == "2, 2" and row[3:5] == ["100.0%"] * 2
    row = regions.counted("a loop without its reference")
    assert row[2:8] == [""] * 6 and row[8:10] == ["2", "2"]


def test_constants_are_halved_doubled_and_put_back(benchmarks, monkeypatch):
    """JOINT is a factor of the radius."""
    import constants

    monkeypatch.setattr(constants, "RECORDS", 1)
    monkeypatch.setattr(constants, "CHOSEN", ("steps",))
    ((radius, off),), ((wide, less),) = constants.changed("WIDE", 1), constants.changed("JOINT", 2)
    np.testing.assert_allclose([wide, less], [2 * radius, off / 2])
    assert constants.estimation.JOINT == 1.3
    for name, module in constants.CONSTANTS.items():
        assert hasattr(module, name)


@pytest.mark.filterwarnings("ignore")
def test_how_often_radii_hold_the_truth_is_counted(benchmarks, monkeypatch, capsys):
    """With half an hour of shaking instead of six, two seeds; and with radii that hold nothing."""
    import confidence

    short = confidence.multisine(confidence.LOOP, 0.05, 0.3, 5.0, 0.5, lines=6)
    monkeypatch.setattr(confidence, "EXCITATION", short)
    monkeypatch.setattr(confidence, "measured", cache(confidence.measured))
    monkeypatch.setattr(confidence, "SEEDS", 2)
    monkeypatch.setattr(confidence, "run", lambda function, seeds: map(function, seeds))
    confidence.main()
    assert "99%: 100.00% +- 0.00% of 2 seeds" in capsys.readouterr().out
    own = confidence.response_and_radii
    monkeypatch.setattr(confidence, "response_and_radii", lambda seed: (own(seed)[0], [0, 0, 0]))
    confidence.main()
    assert "99%: 0.00% +- 0.00%" in capsys.readouterr().out


def test_two_other_settings_of_parameters_that_each_notebook_has(benchmarks):
    import parameters

    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    assert [*parameters.SETTINGS] == [path.name[:2] for path in notebooks]
    for path in notebooks:
        cells = [c for c in nbformat.read(path, 4).cells if c.cell_type == "code"]
        chosen = {s.target.id: s.value for s in ast.parse(cells[1].source).body}
        settings = parameters.SETTINGS[path.name[:2]]
        assert len(settings) == 2
        for setting in settings:
            assert {*setting} <= {*chosen}, path.stem
            assert setting != {name: ast.literal_eval(chosen[name]) for name in setting}


@pytest.mark.parametrize(
    ("name", "frame", "sentence"),
    [
        ("ValueError", "\x1b[31m----> 5\x1b[0m     raise ValueError(message)", True),
        ("ValueError", "----> 5 axes.plot(x, y)", False),
        ("KeyError", "File /a/toolbox/ilctools/arguments.py:31, in number", False),
    ],
)
def test_a_check_of_ours_ends_in_a_sentence(benchmarks, name, frame, sentence):
    import parameters

    frames = ["cell", frame]
    error = parameters.papermill.PapermillExecutionError(0, 1, "", name, "", frames)
    assert parameters.is_a_sentence(error) == sentence


@pytest.mark.parametrize("name", ["motor", "levitation"])
def test_a_kind_of_plant_goes_the_whole_way(benchmarks, name):
    import whole_way

    row = whole_way.outcome(name, trials=4)
    assert row["end"] == "learned" and not row["said"]
    assert row["promised"] < 0.2 and row["on the rig"] < 0.2
    assert row["rms"][-1] < row["rms"][0] / 10


def test_a_kind_that_does_not_learn_is_well_only_with_a_warning(benchmarks):
    import whole_way

    row = whole_way.outcome("motor", -3.0, trials=4)  # so light that no loop holds it
    assert row["end"] == "said so" and any("unstable" in text for text in row["said"])
    assert "| none |" in whole_way.table_of([row])
    assert whole_way.end_of(row | {"said": []}) == "silent"
    late = {"rms": np.array([1.0, 0.01, 0.3]), "noise": 0.01, "said": []}
    assert whole_way.end_of(late) == "silent"


def test_the_watch_keeps_quiet_and_speaks(benchmarks):
    import watch

    results = [watch.converging(seed) for seed in (2, 5)]  # of the furnace
    row = watch.quiet_row("furnace", results)
    assert row[1:3] == ["none", "2"] and row[4:] == ["0", "0.00"]
    loud = watch.loud_row("P has 2 times the gain", [2])
    assert loud[1:] == ["not the model", "1", "1", "3", "3"]
    assert watch.quiet_row("furnace", [(10, {"model": 3})])[4:] == ["1", "100.00"]


def test_a_heater_board_is_known_from_long_moves_around_the_working_point(benchmarks, monkeypatch):
    import boards

    (A, B), fits = boards.logs()
    z, noise = boards.with_squares(A, fits[0]), np.array([0.06, 0.11])
    given = z, B.u.values[0], noise
    with monkeypatch.context() as fewer:
        fewer.setattr(boards, "DRAWN", 10)
        left, least, direct, unknown = boards.moved("by the minute, 36 min", 1, *given)
    assert left < 0.2 and least < direct < 1 and not unknown
    bent, none, *_ = boards.moved("those of log B, 10 min", 1, *given)
    assert bent > 5 * left and none > 1
    radius, best = boards.shaken(1.5, 1, z, noise, fits[1].values)
    assert radius < 0.2 and 0.3 < best < 0.6
    assert boards.ranges(np.array([[0.123, 2], [0.456, 1]]), (2, 0)) == [
        "0.12 to 0.46", "1 to 2",
    ]  # fmt: skip


def test_laws_are_judged_by_what_trials_leave_with_the_same_noise(benchmarks):
    """Against the simulator of the toolbox: a plant of two channels that is off."""
    import peers

    case = peers.case_of("plate")
    P, Q = case.plants[1], zero_phase_butterworth(2, case.cutoff, 1.0)
    L = LearningFilter(np.stack([np.eye(2), -0.5 * np.eye(2)], axis=-1), 1.0)
    log = run_trials(
        ClosedLoop(case.plants[0]), Law(Q, L), case.reference, plant=P, noise=case.noise
    )
    without_noise = rms(log.e + case.noise).values  # the log has what the sensors show
    np.testing.assert_allclose(case.errors(Q, L, 1), without_noise, rtol=1e-9)
    np.testing.assert_array_equal(case.noise, peers.case_of("plate").noise)
    assert np.std(case.noise[..., 1]) == pytest.approx(peers.NOISE * 0.6, rel=0.05)


def test_an_opponents_least_squares_and_inverse_are_what_they_are_called(benchmarks):
    """Against dense least squares over the circle, and against P itself."""
    import peers

    case = peers.case_of("plate")
    Q = zero_phase_butterworth(2, case.cutoff, 1.0)
    opponents = peers.Opponents(synthesise(case.known, Q, order=2).problem, 400)
    L = opponents.least_squares(np.log10([3, 2, 1e-3]))
    angles, lags = np.linspace(0, 2 * np.pi, 2 * peers.LINES, endpoint=False), np.arange(-2, 4)
    P = case.plants[0](np.exp(1j * angles)).transpose(2, 0, 1)
    weight = Q.frequency_response(np.minimum(angles, 2 * np.pi - angles)) / np.sqrt(len(angles))
    columns = np.einsum("n,nij,nk->nikj", weight, P, np.exp(1j * np.outer(angles, lags)))
    ridge = np.sqrt(1e-3) * opponents.size * np.eye(12)
    matrix = np.vstack([columns.reshape(-1, 12), ridge])
    target = np.vstack([(weight[:, None, None] * np.eye(2)).reshape(-1, 2), np.zeros((12, 2))])
    x = np.linalg.lstsq(matrix, target)[0].real.reshape(6, 2, 2)
    np.testing.assert_allclose(L.coefficients, x.transpose(1, 2, 0), atol=1e-8 * np.abs(x).max())
    L = opponents.zero_phase_inversion([0, -12, 0.3])
    F = zero_phase_butterworth(2, 10**0.3 * case.cutoff, 1.0).frequency_response([0.1])
    PL = opponents.known(np.array([0.1])) @ L.frequency_response([0.1])
    np.testing.assert_allclose(PL[0], F[0] * np.eye(2), atol=1e-4)


def test_what_is_lost_to_peers_is_named(benchmarks):
    import peers

    ours, other, third = (np.array([x, x, x, x, x]) for x in (0.4, 0.1, 0.35))
    rows = [
        ("one", "none", {"ours": ours, "norm_optimal": other}, None),
        ("two", "0.1", {"ours": ours, "norm_optimal": third}, None),
    ]
    nominal, off = peers.losses(rows)
    assert "1 of 2; above 3 times: 1. Not within: one (4)" in nominal and "1 of 2" in off
