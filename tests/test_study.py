from dataclasses import replace

import numpy as np
import pytest
from distributed import Client
from hypothesis import given
from hypothesis import strategies as st
from rods import modal_model

from ilctools import Law, LearningFilter, run_trials, zero_phase_butterworth
from ilctools.trials.run import rms
from rodlib import Rod, Spread, Study, draw, paper_loop, sampled_response, study
from rodlib.case import assumed_reference
from rodlib.paper import published

SLOW = paper_loop(Ts=10.0)
LOOP, Q, OMEGA = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), np.geomspace(1e-4, np.pi, 60)
FILTERS = {
    kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0) for kind in ("diagonal", "full")
}
SMALL = Study(
    LOOP, Q, FILTERS, Spread.of_all(0.3), omega=OMEGA, reference=assumed_reference(200), trials=3
)


def simulated(loop, Q, L, specimen, modes, reference, trials):
    plant = modal_model(specimen, loop.Ts, modes)
    law = Law(Q, L)
    return rms(run_trials(loop, law, reference, trials=trials, plant=plant).e).values


@pytest.fixture(scope="module")
def data():
    return SMALL.run(2)


@pytest.mark.parametrize("number", [0, 1])
def test_results_are_those_of_other_ways(data, number):
    """numpy's singular values, the loop around the sampled rod, run_trials."""
    specimen, found = draw(SMALL.spread, number), data.sel(rod=number)
    assert found.rms.attrs["units"] == "K" and data.attrs["spread_sensors"] == 0.012
    assert found.density == specimen.rod.density
    assert tuple(found.sensors.values) == specimen.rod.sensors
    assert tuple(found.gains.values) == specimen.gains
    assert found.unstable_poles == 0
    G = sampled_response(specimen.rod, OMEGA, 1.0)[:, :, [0, 2]]
    P = LOOP.frequency_response(OMEGA, G * np.array(specimen.gains)[[0, 2]])
    q = Q.frequency_response(OMEGA)[:, None, None]
    for name, L in FILTERS.items():
        M = q * (np.eye(2) - P @ L.frequency_response(OMEGA))
        sigma = np.linalg.norm(M, 2, axis=(1, 2))
        radius = np.abs(np.linalg.eigvals(M)).max()
        law = found.sel(filter=name)
        assert law.gamma == pytest.approx(sigma.max(), rel=1e-9)
        assert law["at"] == OMEGA[sigma.argmax()]
        assert law.spectral_radius == pytest.approx(radius, rel=1e-9)
        expected = simulated(LOOP, Q, L, specimen, 150, SMALL.reference, 3)
        np.testing.assert_allclose(law.rms, expected, rtol=0, atol=1e-9)


@pytest.mark.filterwarnings("ignore:(v |the |learning adds)")  # what is drawn
@given(
    samples=st.integers(1, 70),
    orders=st.lists(st.integers(1, 12), min_size=1, max_size=2),
    cutoff=st.floats(0.003, 0.2),
    root=st.integers(0, 1000),
)
def test_any_trials_are_those_of_run_trials(samples, orders, cutoff, root):
    rng = np.random.default_rng(root)
    Q = zero_phase_butterworth(2, cutoff, SLOW.Ts)
    filters = {
        f"{k}": LearningFilter(rng.standard_normal((2, 2, order)), SLOW.Ts)
        for k, order in enumerate(orders)
    }
    reference, spread = rng.standard_normal((samples, 2)), Spread.of_all(0.3)
    some = {"omega": [0.01, 0.1], "reference": reference, "trials": 4}
    found = Study(SLOW, Q, filters, spread, root=root, **some).run(1)
    for name, L in filters.items():
        specimen = draw(spread, 0, root)
        expected = simulated(SLOW, Q, L, specimen, 60, reference, 4)
        np.testing.assert_allclose(found.rms.sel(filter=name)[0], expected, rtol=1e-9)


def test_an_unstable_loop_has_no_rate():
    """Rods so narrow that a heat flow warms them ten times as much."""
    narrow = replace(SMALL, nominal=Rod(width=0.004), spread=Spread(gains=0.9))
    found = narrow.run(12)
    unstable = found.unstable_poles > 0
    assert unstable.any() and not unstable.all()
    for name in ("gamma", "at", "spectral_radius", "rms"):
        assert (found[name].isnull() == unstable).all()


def test_workers_find_the_same_to_the_byte(data, monkeypatch):
    monkeypatch.setattr(study, "SIZE", 2)
    workers = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    with Client(**workers, dashboard_address=":0") as client:
        found = SMALL.run(5, client)
    assert found.identical(SMALL.run(5))
    assert found.isel(rod=slice(2)).identical(data)
