import multiprocessing
import os
import signal
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster
from hypothesis import given
from hypothesis import strategies as st
from plants import modal_model, stage

from rodlib import (
    Law,
    LearningFilter,
    Rod,
    Spread,
    Study,
    current_trial_loop,
    draw,
    paper_loop,
    run_trials,
    sampled_response,
    study,
    zero_phase_butterworth,
)
from rodlib.case import assumed_reference
from rodlib.ilc.files import alone
from rodlib.ilc.trials.run import rms
from rodlib.paper import published

SLOW = paper_loop(Ts=10.0)
LOOP, Q, OMEGA = paper_loop(), zero_phase_butterworth(), np.geomspace(1e-4, np.pi, 60)
FILTERS = {
    kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0)
    for kind in ("diagonal", "full")
}
SMALL = Study(
    LOOP,
    Q,
    FILTERS,
    Spread.of_all(0.3),
    omega=OMEGA,
    reference=assumed_reference(200),
    trials=3,
)


def test_what_is_found_out_about_a_rod():
    """By other ways: numpy's singular values, the loop around samples, run_trials."""
    found = SMALL.judge(3, 5)
    for i, number in enumerate((3, 4)):
        specimen = draw(SMALL.spread, number)
        assert found["density"][i] == specimen.rod.density
        assert tuple(found["sensors"][i]) == specimen.rod.sensors
        assert tuple(found["gains"][i]) == specimen.gains
        G = sampled_response(specimen.rod, OMEGA, 1.0)[:, :, [0, 2]]
        P = LOOP.frequency_response(OMEGA, G * np.array(specimen.gains)[[0, 2]])
        for f, L in enumerate(FILTERS.values()):
            M = np.eye(2) - P @ L.frequency_response(OMEGA)
            sigma = np.linalg.norm(
                Q.frequency_response(OMEGA)[:, None, None] * M, 2, axis=(1, 2)
            )
            assert found["rate"][i, f] == pytest.approx(sigma.max(), rel=1e-9)
            assert found["rate_omega"][i, f] == OMEGA[sigma.argmax()]
            eigenvalues = np.linalg.eigvals(
                Q.frequency_response(OMEGA)[:, None, None] * M
            )
            largest = np.abs(eigenvalues).max()
            assert found["spectral_rate"][i, f] == pytest.approx(largest, rel=1e-9)
            expected = sigma[OMEGA <= 0.02].sum()
            assert found["objective"][i, f] == pytest.approx(expected, rel=1e-9)
            plant = modal_model(specimen, 1.0, 150)
            trials = run_trials(LOOP, Law(Q, L), SMALL.reference, None, 3, plant=plant)
            np.testing.assert_allclose(
                found["rms"][i, f], rms(trials.e), rtol=0, atol=1e-9
            )


def test_a_loop_that_is_not_stable_has_no_rate():
    """Rods so narrow that a heat flow warms them ten times as much."""
    narrow = replace(SMALL, nominal=Rod(width=0.004), spread=Spread(gains=0.9))
    found = narrow.judge(0, 12)
    lost = found["unstable_poles"] > 0
    assert lost.any() and not lost.all()
    for name in ("rate", "rate_omega", "spectral_rate", "objective", "rms"):
        assert (
            np.isnan(found[name][lost]).all() and np.isfinite(found[name][~lost]).all()
        )


def simulated(loop, Q, L, specimen, modes, reference, trials):
    plant = modal_model(specimen, loop.Ts, modes)
    return rms(
        run_trials(loop, Law(Q, L), reference, trials=trials, plant=plant).e
    ).values


def test_the_papers_trials_are_those_of_run_trials():
    specimens = [draw(Spread.of_all(0.3), number) for number in range(2)]
    course = study.Course(LOOP, Q, [*FILTERS.values()], assumed_reference(), 4)
    found = course.rms([each.held(1.0) for each in specimens])
    assert found.shape == (2, 2, 4)
    for f, L in enumerate(FILTERS.values()):
        expected = simulated(LOOP, Q, L, specimens[f], 150, assumed_reference(), 4)
        np.testing.assert_allclose(found[f, f], expected, rtol=0, atol=1e-9)


@given(
    samples=st.integers(1, 70),
    orders=st.lists(st.integers(1, 12), min_size=1, max_size=2),
    trials=st.integers(1, 4),
    cutoff=st.floats(0.003, 0.2),
    order=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_trials_are_those_of_run_trials(
    samples, orders, trials, cutoff, order, seed
):
    rng = np.random.default_rng(seed)
    Q = zero_phase_butterworth(order, cutoff, SLOW.Ts)
    filters = [
        LearningFilter(rng.standard_normal((2, 2, taps)), SLOW.Ts) for taps in orders
    ]
    reference = rng.standard_normal((samples, 2))
    specimen = draw(Spread.of_all(0.3), seed % 1000)
    found = study.Course(SLOW, Q, filters, reference, trials).rms(
        [specimen.held(SLOW.Ts)]
    )[0]
    for f, L in enumerate(filters):
        expected = simulated(SLOW, Q, L, specimen, 60, reference, trials)
        np.testing.assert_allclose(found[f], expected, rtol=1e-9)


def test_rods_side_by_side_are_what_they_are_alone():
    filters = [LearningFilter(np.ones((2, 2, 1)), 1.0)]
    course = study.Course(LOOP, Q, filters, np.ones((200, 2)), 3)
    rods = [draw(Spread.of_all(0.3), number).held(1.0) for number in range(5)]
    alone = np.concatenate([course.rms([rod]) for rod in rods])
    np.testing.assert_allclose(course.rms(rods), alone, rtol=1e-12)


@dataclass(frozen=True)
class Watched(Study):
    """A study that leaves a trace of each batch, and where rod 4 is judged does as it is told."""

    then: str = ""  # "wait", "die" once, or "fail"
    folder: str = ""

    def judge(self, start, stop):
        folder = Path(self.folder)
        if start == 4 and self.then == "wait":
            (folder / "gate").read_bytes()
        if start == 4 and self.then == "die" and not (folder / "dead").exists():
            (folder / "dead").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if start == 4 and self.then == "fail":
            while len(batches(folder)) < 3:
                time.sleep(0.01)
            raise ArithmeticError("four is too much")
        (folder / f"judged-{start}").touch()
        return super().judge(start, stop)

    name = "watched"  # whatever it does


def watched(folder, then=""):
    return Watched(
        **{field.name: getattr(SMALL, field.name) for field in fields(Study)},
        then=then, folder=str(folder),
    )  # fmt: skip


def batches(folder):
    return {path.name[-17:]: path.read_bytes() for path in folder.glob("*.npz")}


def judged(folder):
    return sorted(int(path.name[7:]) for path in folder.glob("judged-*"))


@pytest.fixture(scope="module", autouse=True)
def small_batches():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "SIZE", 2)
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """What this process finds by itself, and its folder."""
    folder = tmp_path_factory.mktemp("finished")
    return study.run(SMALL, 7, folder=folder, workers=0), folder


@pytest.fixture(scope="module")
def scheduler():
    with LocalCluster(
        2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def test_any_number_of_workers_finds_the_same_to_the_byte(
    finished, scheduler, tmp_path
):
    (data, folder), found = finished, {}
    found["one"] = study.run(SMALL, 7, folder=tmp_path / "one", workers=1)
    found["two"] = study.run(SMALL, 7, folder=tmp_path / "two", scheduler=scheduler)
    assert len(batches(folder)) == 4
    for name, each in found.items():
        assert each.identical(data) and batches(tmp_path / name) == batches(folder)
    for name, values in SMALL.judge(0, 2).items():
        np.testing.assert_array_equal(data[name][:2], values)

    assert dict(data.sizes) == {
        "rod": 7,
        "filter": 2,
        "trial": 3,
        "channel": 2,
        "element": 4,
    }
    assert [*data.filter.values] == ["diagonal", "full"] and [*data.trial.values] == [
        1,
        2,
        3,
    ]
    assert (
        data.rms.attrs["units"] == "K" and data.conductivity.attrs["units"] == "W/(m K)"
    )
    assert all("units" in data[name].attrs for name in data)
    assert data.attrs["spread_sensors"] == 0.3 * 0.04 and data.attrs["root"] == 0


def test_what_is_finished_is_not_judged_again(finished):
    """Fewer rods are known without any worker, up to whole batches."""
    data, folder = finished
    again = study.run(SMALL, 4, folder=folder, scheduler="tcp://nobody:1")
    assert again.identical(data.isel(rod=slice(4)))


def test_without_a_folder_nothing_is_kept(finished, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", None)
    assert study.run(SMALL, 2, workers=0).identical(finished[0].isel(rod=slice(2)))
    assert os.listdir(tmp_path) == []


def interrupted(folder):
    study.SIZE = 2
    study.run(watched(folder, "wait"), 7, folder=folder, workers=0)


def test_a_killed_run_goes_on_where_it_was(finished, tmp_path, gate):
    run = multiprocessing.get_context("spawn").Process(
        target=interrupted, args=(tmp_path,)
    )
    run.start()
    while len(batches(tmp_path)) < 2:
        assert run.is_alive()
        time.sleep(0.01)
    run.kill()
    run.join()
    assert judged(tmp_path) == [0, 2]
    for path in tmp_path.glob("judged-*"):
        path.unlink()
    study.run(watched(tmp_path), 7, folder=tmp_path, workers=0)
    assert judged(tmp_path) == [4, 6]
    assert batches(tmp_path) == batches(finished[1])


def test_a_killed_worker_changes_nothing(finished, scheduler, tmp_path):
    study.run(watched(tmp_path, "die"), 7, folder=tmp_path, scheduler=scheduler)
    assert (tmp_path / "dead").exists()
    assert batches(tmp_path) == batches(finished[1])


def test_an_error_of_the_work_is_raised_and_the_rest_is_kept(
    finished, scheduler, tmp_path
):
    with pytest.raises(ArithmeticError, match="four is too much"):
        study.run(watched(tmp_path, "fail"), 7, folder=tmp_path, scheduler=scheduler)
    rest = {
        part: content
        for part, content in batches(finished[1]).items()
        if part[:6] != "000004"
    }
    assert batches(tmp_path) == rest and len(rest) == 3


def test_a_second_run_in_the_same_folder_is_refused(tmp_path):
    with (
        alone(tmp_path / "lock", "the test"),
        pytest.raises(RuntimeError, match=f"another process is at work in {tmp_path}"),
    ):
        study.run(SMALL, 2, folder=tmp_path, workers=0)


def test_the_name_depends_on_all_parameters_and_on_the_code(monkeypatch):
    changes = {
        "loop": replace(LOOP, N=LOOP.N * (1 + 1e-15)),
        "Q": zero_phase_butterworth(cutoff=0.11),
        "filters": {"diagonal": FILTERS["diagonal"]},
        "spread": Spread.of_all(0.31),
        "nominal": replace(SMALL.nominal, density=7801.0),
        "root": 1,
        "omega": OMEGA[1:],
        "reference": assumed_reference(200) + 1e-12,
        "trials": 4,
    }
    assert changes.keys() == Study.__dataclass_fields__.keys()
    names = {replace(SMALL, **{name: value}).name for name, value in changes.items()}
    name = SMALL.name
    assert len(names | {name}) == len(changes) + 1
    assert replace(SMALL, loop=paper_loop()).name == name
    monkeypatch.setattr(study, "_code", lambda: "another")
    assert SMALL.name not in names | {name}


def test_a_worker_with_another_rodlib_is_refused():
    with pytest.raises(RuntimeError, match="a worker has another rodlib"):
        study._judge(SMALL, "of another rodlib", 0, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"loop": "paper"}, "loop = 'paper' must be a CurrentTrialLoop"),
        ({"loop": current_trial_loop(stage(Ts=1.0), ["F"])}, "must be that of a rod"),
        ({"Q": zero_phase_butterworth(Ts=2.0)}, "the sampling periods must be equal"),
        ({"Q": zero_phase_butterworth(ends="hold")}, "Q.ends = 'hold' must be 'zero'"),
        ({"filters": {}}, "filters = {} must hold at least one"),
        ({"filters": [FILTERS["full"]]}, "must be a dict"),
        (
            {"filters": {"none": None}},
            r"filters\['none'\] = None must be a LearningFilter",
        ),
        ({"spread": 0.2}, "spread = 0.2 must be a Spread"),
        ({"root": -1}, "root = -1"),
        ({"omega": [0.1, 0.1]}, "omega, .* must be a row of increasing frequencies"),
        ({"omega": [0.1, 4.0]}, r"omega spans .* must lie in \[0, 3.14159\]"),
        ({"trials": 0}, "trials = 0"),
        ({"reference": np.zeros((5, 3))}, r"reference has shape \(5, 3\)"),
    ],
)
def test_what_is_no_study_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(SMALL, **changes)


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((SMALL, 0), {}, "rods = 0 must be a whole number"),
        ((FILTERS, 5), {}, "must be a Study"),
        ((SMALL, 5), {"workers": -1}, "workers = -1"),
        ((SMALL, 5), {"folder": 7}, "folder = 7 must be the path of a file"),
    ],
)
def test_what_cannot_be_run_is_refused(arguments, keywords, message):
    with pytest.raises(ValueError, match=message):
        study.run(*arguments, **keywords)
