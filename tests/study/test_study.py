import time
from dataclasses import replace

import numpy as np
import pytest
from distributed import Client, LocalCluster
from plants import modal_model, stage

from rodlib import (
    LearningFilter,
    Rod,
    Spread,
    Study,
    current_trial_loop,
    draw,
    paper_loop,
    run_trials,
    sampled_response,
    zero_phase_butterworth,
)
from rodlib.case import assumed_reference
from rodlib.ilc.trials import rms
from rodlib.paper import published
from rodlib.study import study

LOOP, Q, OMEGA = paper_loop(), zero_phase_butterworth(), np.geomspace(1e-4, np.pi, 60)
FILTERS = {
    kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0) for kind in ("diagonal", "full")
}
SMALL = Study(
    LOOP, Q, FILTERS, Spread.of_all(0.3), omega=OMEGA, reference=assumed_reference(200), trials=3
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
            sigma = np.linalg.norm(Q.frequency_response(OMEGA)[:, None, None] * M, 2, axis=(1, 2))
            assert found["rate"][i, f] == pytest.approx(sigma.max(), rel=1e-9)
            assert found["rate_omega"][i, f] == OMEGA[sigma.argmax()]
            expected = sigma[OMEGA <= 0.02].sum()
            assert found["objective"][i, f] == pytest.approx(expected, rel=1e-9)
            plant = modal_model(specimen, 1.0, 150)
            trials = run_trials(LOOP, Q, L, SMALL.reference, None, 3, plant=plant)
            np.testing.assert_allclose(found["rms"][i, f], rms(trials.e), rtol=0, atol=1e-9)


def test_a_loop_that_is_not_stable_has_no_rate():
    """Rods so narrow that a heat flow warms them ten times as much."""
    narrow = replace(SMALL, nominal=Rod(width=0.004), spread=Spread(gains=0.9))
    found = narrow.judge(0, 12)
    lost = found["unstable_poles"] > 0
    assert lost.any() and not lost.all()
    for name in ("rate", "rate_omega", "objective", "rms"):
        assert np.isnan(found[name][lost]).all() and np.isfinite(found[name][~lost]).all()


def test_any_number_of_workers_finds_the_same_to_the_byte(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "SIZE", 2)
    found = {}
    with LocalCluster(2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        for workers in (2, 1):
            cluster.scale(workers)
            with Client(cluster) as client:
                while len(client.ncores()) != workers:
                    time.sleep(0.01)
            folder, address = tmp_path / str(workers), cluster.scheduler_address
            found[workers] = study.run(SMALL, 7, folder=folder, scheduler=address)
    found[0] = study.run(SMALL, 7, folder=tmp_path / "0", workers=0)
    contents = [
        {path.name: path.read_bytes() for path in (tmp_path / str(workers)).glob("*.npz")}
        for workers in found
    ]
    assert len(contents[0]) == 4 and all(each == contents[0] for each in contents)
    here = SMALL.judge(0, 2)
    for name, values in here.items():
        np.testing.assert_array_equal(found[2][name][:2], values)

    data = found[1]
    assert all(data.identical(each) for each in found.values())
    assert dict(data.sizes) == {"rod": 7, "filter": 2, "trial": 3, "channel": 2, "element": 4}
    assert [*data.filter.values] == ["diagonal", "full"] and [*data.trial.values] == [1, 2, 3]
    assert data.rms.attrs["units"] == "K" and data.conductivity.attrs["units"] == "W/(m K)"
    assert all("units" in data[name].attrs for name in data)
    assert data.attrs["spread_sensors"] == 0.3 * 0.04 and data.attrs["root"] == 0
    # Fewer rods are known without any worker, up to whole batches.
    again = study.run(SMALL, 4, folder=tmp_path / "1", scheduler="tcp://nobody:1")
    assert again.identical(data.isel(rod=slice(4)))


def test_the_name_depends_on_all_parameters_and_on_the_code(monkeypatch):
    changes = {
        "loop": replace(LOOP, N=LOOP.N * (1 + 1e-15)),
        "Q": zero_phase_butterworth(cutoff=0.11),
        "filters": {"diagonal": FILTERS["diagonal"]},
        "spread": Spread.of_all(0.31),
        "nominal": replace(SMALL.nominal, density=7801.0),
        "root": 1,
        "omega": OMEGA[1:],
        "band": (1e-4, 0.021),
        "reference": assumed_reference(200) + 1e-12,
        "disturbance": np.zeros((200, 3)),
        "trials": 4,
        "rest": 1,
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
        study._judge(b"", "of another rodlib", 0, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"loop": "paper"}, "loop = 'paper' must be a CurrentTrialLoop"),
        ({"loop": current_trial_loop(stage(Ts=1.0), ["F"])}, "must be that of a rod"),
        ({"Q": zero_phase_butterworth(Ts=2.0)}, "the sampling periods must be equal"),
        ({"Q": zero_phase_butterworth(ends="hold")}, "Q.ends = 'hold' must be 'zero'"),
        ({"filters": {}}, "filters = {} must hold at least one"),
        ({"filters": [FILTERS["full"]]}, "must be a dict"),
        ({"filters": {"none": None}}, r"filters\['none'\] = None must be a LearningFilter"),
        ({"spread": 0.2}, "spread = 0.2 must be a Spread"),
        ({"root": -1}, "root = -1"),
        ({"omega": [0.1, 0.1]}, r"omega must increase within \[0, 3.14159\]"),
        ({"omega": [0.1, 4.0]}, r"omega must increase within \[0, 3.14159\]"),
        ({"band": (2e-5, 3e-5)}, "contains none of the frequencies"),
        ({"trials": 0}, "trials = 0"),
        ({"reference": np.zeros((5, 3))}, r"reference has shape \(5, 3\)"),
        ({"disturbance": np.zeros((2, 200, 3))}, r"disturbance has shape \(2, 200, 3\)"),
        ({"rest": 200}, "rest = 200"),
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
