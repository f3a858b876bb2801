"""From settings to a filter: on four plants, against the lines of Python and trials run by hand."""

from dataclasses import replace

import control
import numpy as np
import plants
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import (
    Law,
    Rod,
    Settings,
    current_trial_loop,
    measured_response,
    multisine,
    run_trials,
    save_log,
    try_out,
)
from rodlib.ilc.law.io import with_law
from rodlib.ilc.measurement.excitation import with_excitation
from rodlib.ilc.trials.run import dataset, state_sequence
from rodlib.ilc.workbench.plant import Plant, plant_of_file
from rodlib.paper import plant_of_rod

SOURCES = {  # as a reader would type them, and the filter's order
    "stage": (
        "rodlib.current_trial_loop(plants.stage(), ['F'], {'x': 1.0, 'F': 3.0}, {'x': 'mm'})", 10
    ),
    "tanks": (
        "rodlib.current_trial_loop(plants.tanks(), ['pump A', 'pump B', 'pump C'])", 6
    ),
    "furnace": ("rodlib.current_trial_loop(plants.furnace(20))", 25),
}  # fmt: skip


def run(lines):
    namespace = {"plants": plants}
    exec(lines, namespace)
    return namespace


def plant_named(name):
    if name == "rod":
        return plant_of_rod(Rod(density=8000.0))
    source, order = SOURCES[name]
    return Plant(source, run(f"import rodlib\nloop = {source}")["loop"], order=order)


@pytest.fixture(scope="module", params=["rod", *SOURCES])
def settings(request):
    return Settings.of(plant_named(request.param))


@pytest.fixture(scope="module")
def outcome(settings):
    return try_out(settings)


@pytest.fixture(scope="module")
def rod():
    return Settings.of(plant_of_rod(Rod()))


@pytest.fixture(scope="module")
def stage():
    return Settings.of(plant_named("stage"))


def check_lines(outcome):
    """The lines of Python make the same filter; their namespace."""
    namespace = run(outcome.settings.python)
    by_hand = namespace["design"].filter.coefficients
    np.testing.assert_array_equal(outcome.design.filter.coefficients, by_hand)
    assert namespace["law"].rest == outcome.settings.plant.rest
    return namespace


def test_the_lines_make_the_same_filter(settings):
    settings = replace(settings, structure="full", uncertainty=1.0, M_max=0.95)
    problem = check_lines(try_out(settings))["design"].problem
    size = np.linalg.svd(problem.P, compute_uv=False)[:, 0]
    np.testing.assert_allclose(problem.radius, 0.01 * size, rtol=1e-12)


def sigma_of(outcome, omega):
    """Largest singular values of M and L."""
    settings = outcome.settings
    P = settings.plant.loop.frequency_response(omega)
    L = outcome.design.filter.frequency_response(omega)
    q = settings.Q.frequency_response(omega)[:, None, None]
    M = q * (np.eye(P.shape[1]) - P @ L)
    return [np.linalg.svd(matrices, compute_uv=False)[:, 0] for matrices in (M, L)]


def test_the_certificate_agrees_with_singular_values(outcome, settings):
    sigma_M, sigma_L = sigma_of(outcome, np.linspace(1e-6, np.pi / settings.Ts, 4000))
    in_band = sigma_of(outcome, np.geomspace(*settings.band, 2000))[0]
    certificate = outcome.design.certificate
    assert sigma_M.max() == pytest.approx(certificate.all_M, rel=2e-3)
    assert sigma_L.max() == pytest.approx(certificate.all_L, rel=2e-3)
    assert certificate.mean_M == pytest.approx(in_band.mean(), rel=5e-2, abs=1e-3)
    assert (
        f"mean of sigma_max(M) over the band: {certificate.mean_M:.4f}" in outcome.text
    )


def test_the_trials_are_those_of_the_law(outcome, settings):
    """Three of them by hand, simulated by python-control."""
    loop, r = settings.plant.loop, settings.plant.reference
    v, errors = np.zeros_like(r), []
    for _ in range(3):
        w = np.hstack([r + v, np.zeros((len(r), len(loop.disturbances)))])
        e = r - np.atleast_2d(control.forced_response(loop.closed, U=w.T).outputs).T
        errors.append(np.sqrt(np.mean(np.sum(e**2, axis=1))))
        v = Law(settings.Q, outcome.design.filter, rest=15).next(v, e)
    assert len(outcome.rms) == 10
    np.testing.assert_allclose(outcome.rms[:3], errors, rtol=1e-6, atol=1e-9)
    assert errors[2] < 0.2 * errors[0]


def test_the_same_settings_give_the_same_filter_whatever_was_before(rod):
    first = try_out(rod)
    try_out(replace(rod, L_max=30.0))
    again = try_out(replace(rod, M_max=0.9))
    coefficients = [o.design.filter.coefficients.tobytes() for o in (first, again)]
    assert coefficients[0] == coefficients[1] and again.rms == first.rms


@pytest.mark.parametrize(
    "changes", [{"L_max": 5.0}, {"M_max": 0.3, "order": 3, "uncertainty": 3.0}]
)
def test_the_remedy_is_the_smallest_that_helps(rod, changes):
    settings = replace(rod, **changes)
    outcome = try_out(settings)
    assert outcome.design is None and outcome.rms == ()
    assert outcome.text == outcome.message and "M_max" in outcome.message
    assert try_out(replace(settings, M_max=outcome.M_max)).design is not None
    assert try_out(replace(settings, M_max=outcome.M_max - 0.0021)).design is None


def test_without_a_rate_below_one_there_is_no_remedy(rod):
    outcome = try_out(replace(rod, cutoff=2.0, L_max=0.5, order=1))
    assert outcome.M_max is None and "infeasible" in outcome.message


@pytest.mark.parametrize(
    "changes", [{"cutoff": 9.0}, {"band": (0.1, 0.01)}, {"noise": np.nan}]
)
def test_settings_out_of_range_are_answered_by_a_message(rod, changes):
    outcome = try_out(replace(rod, **changes))
    (name,) = changes
    assert outcome.design is None and outcome.M_max is None
    assert f"{name} = {changes[name]}" in outcome.message


NUMBER = st.one_of(st.floats(), st.floats(1e-3, 1e3), st.floats(0, 1))
NUMBERS = dict.fromkeys(("M_max", "L_max", "cutoff", "uncertainty", "noise"), NUMBER)
ORDERS = {"order": st.integers(-1, 12), "Q_order": st.integers(-1, 5)}


@given(st.fixed_dictionaries({}, optional=NUMBERS | ORDERS))
def test_every_position_of_the_knobs_has_an_outcome(stage, changes):
    outcome = try_out(replace(stage, **changes))
    assert (outcome.design is None) == bool(outcome.message)
    if outcome.design is not None:
        assert not outcome.design.certificate.failures
        assert np.isfinite(outcome.rms).all()


def test_noise_bounds_the_error_from_below(stage):
    clean, noisy = try_out(stage), try_out(replace(stage, noise=0.1))
    assert clean.rms[-1] < 1e-3 < 0.09 < noisy.rms[-1] < 0.15
    assert noisy.design.value == clean.design.value


def test_the_papers_choices_are_carried_over(rod):
    """With another sampling period, all frequencies move with it, and the rule for the gain."""
    assert (rod.M_max, rod.L_max, rod.cutoff) == (0.9, 50.0, 0.1)
    assert rod.band == (1e-4, 0.02)
    assert (rod.order, rod.Q_order, rod.structure) == (10, 2, "diagonal")
    stage = Settings.of(plant_named("stage"))
    assert (stage.cutoff, stage.band) == (100.0, (0.1, 20.0))
    assert stage.omega[-1] == np.pi * 1000
    P = stage.plant.frequency_response([100.0])
    assert 1 <= stage.L_max * abs(P[0, 0, 0]) < 2


@pytest.mark.parametrize(
    ("name", "task"),
    [
        ("reference", {"reference": np.zeros((20, 2))}),
        (
            "disturbance",
            {"reference": np.zeros((20, 1)), "disturbance": np.ones((9, 1))},
        ),
        ("rest", {"reference": np.zeros((10, 1)), "rest": 10}),
    ],
)
def test_the_task_must_fit_the_plant(stage, name, task):
    with pytest.raises(ValueError, match=name):
        Plant("loop", stage.plant.loop, **task)


def test_a_log_brings_its_loop_and_its_task(tmp_path):
    loop = current_trial_loop(plants.tanks(), ["pump A", "pump B", "pump C"])
    law = Law(Settings.of(Plant("", loop, order=6)).Q, None)
    rng = np.random.default_rng(0)
    r, leak = rng.standard_normal((40, 3)), rng.standard_normal((40, 1))
    trials = run_trials(loop, law, r, leak, 2)
    save_log(with_law(trials, law.bound_to(loop)), tmp_path / "tanks.csv")
    plant = plant_of_file(tmp_path / "tanks.csv")
    np.testing.assert_array_equal(plant.reference, r)
    np.testing.assert_array_equal(plant.disturbance, np.repeat(leak[None], 10, axis=0))
    check_lines(try_out(Settings.of(plant)))


def test_a_measured_response_has_its_own_uncertainty(tmp_path):
    loop = current_trial_loop(plants.stage(), ["F"], {"x": 1.0, "F": 3.0})
    excitation = multisine(loop, 20.0, 1500.0, 1.0, 0.002, lines=20)
    closed, w = loop.closed, excitation.signals
    zero = np.zeros(closed.nstates)
    y = state_sequence(closed.A, w[0] @ closed.B[:, :1].T, zero) @ closed.C.T
    y = y[None] + 1e-4 * np.random.default_rng(0).standard_normal(w.shape)
    trials = dataset(
        loop.Ts, loop.outputs, loop.controls, [], loop.units,
        reference=0 * w, v=w, u=0 * w, y=y, delta=0 * w,
    )  # fmt: skip
    trials = with_excitation(trials, excitation, loop)
    save_log(trials, tmp_path / "excited.csv")
    plant = plant_of_file(tmp_path / "excited.csv")
    assert plant.measured and plant.loop.outputs == ["x"]
    settings = Settings.of(plant)
    outcome = try_out(settings)
    assert "within the radius" in outcome.text
    assert repr(check_lines(outcome)["P"]) == repr(measured_response(trials))
    drift = replace(plant, response=replace(plant.response, findings=("drift",)))
    assert "the measurement: drift" in try_out(Settings.of(drift)).text
    truth = replace(outcome, settings=Settings.of(Plant("", loop)))
    assert sigma_of(truth, settings.omega)[0].max() <= 0.9
    refused = try_out(replace(settings, uncertainty=5.0))
    assert "uncertainty = 5 %" in refused.message


def test_a_log_without_its_loop_is_refused(tmp_path, stage):
    trials = run_trials(
        stage.plant.loop, Law(stage.Q, None), np.zeros((9, 1)), trials=1
    )
    save_log(trials, tmp_path / "bare.csv")
    with pytest.raises(ValueError, match=r"bare.csv: "):
        plant_of_file(tmp_path / "bare.csv")
