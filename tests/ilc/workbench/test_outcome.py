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
    convergence,
    current_trial_loop,
    measured_response,
    multisine,
)
from rodlib.ilc import save_log
from rodlib.ilc.law.io import with_law
from rodlib.ilc.logs.notes import with_excitation
from rodlib.ilc.trials.run import dataset, run_trials, state_sequence
from rodlib.ilc.workbench import Plant, Settings, plant_of_file, try_out
from rodlib.paper.knobs import plant_of_rod

SOURCES = {  # as a reader would type them, and samples to look ahead
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
    return Plant(source, run(f"import rodlib\nfound = {source}")["found"], order=order)


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


def test_the_lines_make_the_same_filter(settings):
    settings = replace(settings, structure="full", uncertainty=1.0, M_max=0.95)
    found, by_hand = try_out(settings), run(settings.python)["design"]
    np.testing.assert_array_equal(
        found.design.filter.coefficients, by_hand.filter.coefficients
    )
    assert settings.python.count("\n") == 6  # two imports, three lines
    size = np.linalg.svd(by_hand.problem.P, compute_uv=False)[:, 0]
    np.testing.assert_allclose(by_hand.problem.radius, 0.01 * size, rtol=1e-12)


def test_the_line_says_what_singular_values_say(outcome, settings):
    omega = np.linspace(1e-6, np.pi / settings.Ts, 4000)
    P = settings.plant.loop.frequency_response(omega)
    L = outcome.design.filter.frequency_response(omega)
    M = settings.Q.frequency_response(omega)[:, None, None] * (
        np.eye(P.shape[1]) - P @ L
    )
    rate, gain, mean, objective = outcome.line.split("; ")[:4]
    peaks = [np.linalg.svd(X, compute_uv=False).max() for X in (M, L)]
    assert peaks[0] <= float(rate.split()[2]) + 1e-4
    assert peaks[0] == pytest.approx(outcome.design.certificate.all_M, rel=2e-3)
    assert peaks[1] == pytest.approx(float(gain.split()[2]), rel=2e-3)
    reached = convergence(P, settings.Q, outcome.design.filter, omega)
    expected = reached.mean(settings.band)
    assert float(mean.split()[-1]) == pytest.approx(expected, rel=5e-2, abs=1e-3)
    assert float(objective.split()[1][:-1]) == pytest.approx(
        outcome.design.value, rel=1e-3
    )


def test_the_trials_are_those_of_the_law(outcome, settings):
    """Three of them by hand: python-control simulates, update learns."""
    loop, r = settings.plant.loop, settings.plant.reference
    v, found = np.zeros_like(r), []
    for _ in range(3):
        w = np.hstack([r + v, np.zeros((len(r), len(loop.disturbances)))])
        e = r - np.atleast_2d(control.forced_response(loop.closed, U=w.T).outputs).T
        found.append(np.sqrt(np.mean(np.sum(e**2, axis=1))))
        v = Law(settings.Q, outcome.design.filter, rest=15).next(
            v, e
        )  # where nothing moves
    assert len(outcome.rms) == 10
    np.testing.assert_allclose(outcome.rms[:3], found, rtol=1e-6, atol=1e-9)
    assert found[2] < 0.2 * found[0]


def test_the_same_setting_gives_the_same_filter_whatever_was_before(rod):
    first = try_out(rod)
    try_out(replace(rod, L_max=30.0))
    again = try_out(replace(rod, M_max=0.9))
    assert (
        again.design.filter.coefficients.tobytes()
        == first.design.filter.coefficients.tobytes()
    )
    assert again.rms == first.rms


@pytest.mark.parametrize(
    "changes", [{"L_max": 5.0}, {"M_max": 0.3, "order": 3, "uncertainty": 3.0}]
)
def test_the_remedy_is_the_least_that_helps(rod, changes):
    settings = replace(rod, **changes)
    outcome = try_out(settings)
    assert outcome.design is None and outcome.rms == ()
    assert (
        outcome.line == outcome.message and "smallest feasible M_max" in outcome.message
    )
    assert try_out(replace(settings, M_max=outcome.M_max)).design is not None
    assert try_out(replace(settings, M_max=outcome.M_max - 0.0021)).design is None


def test_where_no_rate_below_one_will_do_there_is_no_remedy(rod):
    outcome = try_out(replace(rod, cutoff=2.0, L_max=0.5, order=1))
    assert outcome.M_max is None and "infeasible" in outcome.message


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cutoff": 9.0}, "cutoff = 9.0 must be in (0, 3.14159) rad/s"),
        (
            {"band": (0.1, 0.01)},
            "band = (0.1, 0.01) must be two increasing frequencies",
        ),
        ({"noise": np.nan}, "noise = nan must be zero or more"),
    ],
)
def test_nonsense_is_answered_by_a_sentence(rod, changes, words):
    outcome = try_out(replace(rod, **changes))
    assert outcome.design is None and outcome.M_max is None
    assert words in outcome.message


ANYTHING = st.one_of(st.floats(), st.floats(1e-3, 1e3), st.floats(0, 1))


@given(
    st.fixed_dictionaries(
        {},
        optional={
            name: ANYTHING
            for name in (
                "M_max",
                "L_max",
                "cutoff",
                "uncertainty",
                "noise",
            )
        }
        | {"order": st.integers(-1, 12), "Q_order": st.integers(-1, 5)},
    )
)
def test_nothing_that_a_knob_may_say_breaks_it(stage, changes):
    outcome = try_out(replace(stage, **changes))
    assert (outcome.design is None) == bool(outcome.message)
    if outcome.design is not None:
        assert (
            not outcome.design.certificate.failures and np.isfinite(outcome.rms).all()
        )


def test_noise_is_the_floor_that_no_trial_falls_below(stage):
    clean, noisy = try_out(stage), try_out(replace(stage, noise=0.1))
    assert clean.rms[-1] < 1e-3 < 0.09 < noisy.rms[-1] < 0.15
    assert noisy.design.value == clean.design.value  # it is in the trials alone


def test_the_papers_choices_are_carried_over():
    """With another sampling period, all frequencies move with it, and the rule for the gain."""
    rod = Settings.of(plant_of_rod(Rod()))
    assert (rod.M_max, rod.L_max, rod.cutoff, rod.band) == (
        0.9,
        50.0,
        0.1,
        (1e-4, 0.02),
    )
    assert (rod.order, rod.Q_order, rod.structure) == (10, 2, "diagonal")
    stage = Settings.of(plant_named("stage"))
    assert (stage.cutoff, stage.band, stage.omega[-1]) == (
        100.0,
        (0.1, 20.0),
        np.pi * 1000,
    )
    P = stage.plant.loop.frequency_response([100.0])
    assert 1 <= stage.L_max * abs(P[0, 0, 0]) < 2


@pytest.mark.parametrize("Ts", [0.003, 1.0, 30.0])
def test_the_band_begins_with_the_design_frequencies(Ts):
    """Three digits of 1e-4 / Ts may lie below it."""
    settings = Settings.of(
        Plant("lag", current_trial_loop(control.ss(0.9, 0.1, 1, 0, Ts)))
    )
    assert (
        settings.omega[0] * (1 - 1e-12) <= settings.band[0] < 1.01 * settings.omega[0]
    )
    assert settings.band[0] == float(f"{settings.band[0]:.3g}")


def test_the_signals_of_a_plant_must_be_its_own():
    loop = current_trial_loop(plants.stage(), ["F"])
    with pytest.raises(ValueError, match="reference has shape"):
        Plant("loop", loop, np.zeros((10, 2)))
    with pytest.raises(ValueError, match="disturbance has shape"):
        Plant("loop", loop, np.zeros((10, 1)), np.zeros((10, 1)))
    with pytest.raises(ValueError, match="rest = 10 must be"):
        Plant("loop", loop, np.zeros((10, 1)), rest=10)


def test_a_log_brings_its_loop_its_reference_and_its_disturbances(tmp_path):
    loop = current_trial_loop(plants.tanks(), ["pump A", "pump B", "pump C"])
    settings = Settings.of(Plant("", loop, order=6))
    rng = np.random.default_rng(0)
    r, leak = rng.standard_normal((40, 3)), rng.standard_normal((40, 1))
    trials = run_trials(loop, Law(settings.Q, None), r, leak, 2)
    save_log(with_law(trials, Law(settings.Q, None, loop=loop)), tmp_path / "tanks.csv")
    plant = plant_of_file(tmp_path / "tanks.csv")
    np.testing.assert_array_equal(plant.reference, r)
    assert plant.disturbance.shape == (10, 40, 1)
    np.testing.assert_array_equal(plant.disturbance[9], leak)
    found, by_hand = (
        try_out(Settings.of(plant)),
        run(Settings.of(plant).python)["design"],
    )
    np.testing.assert_array_equal(
        found.design.filter.coefficients, by_hand.filter.coefficients
    )


def test_a_measured_response_brings_its_radius(tmp_path):
    loop = current_trial_loop(plants.stage(), ["F"], {"x": 1.0, "F": 3.0})
    excitation = multisine(loop, 20.0, 1500.0, 1.0, 0.002, lines=20)
    closed, w = loop.closed, excitation.signals
    states = state_sequence(
        closed.A, w[0] @ closed.B[:, :1].T, np.zeros(closed.nstates)
    )
    y = (states @ closed.C.T)[None]
    y += 1e-4 * np.random.default_rng(0).standard_normal(y.shape)
    run_of = dataset(
        loop.Ts, loop.outputs, loop.controls, [], loop.units,
        reference=0 * w, v=w, u=0 * w, y=y, delta=0 * w,
    )  # fmt: skip
    save_log(with_excitation(run_of, excitation, loop), tmp_path / "shaken.csv")
    plant = plant_of_file(tmp_path / "shaken.csv")
    assert plant.measured and plant.loop.outputs == ["x"]
    settings = Settings.of(plant)
    outcome = try_out(settings)
    assert "within the radius" in outcome.line
    doubted = replace(
        plant, response=replace(plant.response, findings=("outputs drift",))
    )
    assert "the measurement: outputs drift" in try_out(Settings.of(doubted)).line
    by_hand = run(settings.python)
    assert repr(by_hand["P"]) == repr(
        measured_response(
            run_of.assign_attrs(with_excitation(run_of, excitation, loop).attrs)
        )
    )
    np.testing.assert_array_equal(
        outcome.design.filter.coefficients, by_hand["design"].filter.coefficients
    )
    truth = loop.frequency_response(settings.omega)
    L = outcome.design.filter.frequency_response(settings.omega)
    M = settings.Q.frequency_response(settings.omega) * np.abs(1 - truth * L)[:, 0, 0]
    assert M.max() <= 0.9
    refused = try_out(replace(settings, uncertainty=5.0))
    assert "uncertainty = 5 % must be 0 for a measured response" in refused.message


def test_a_log_that_says_nothing_of_its_loop_is_refused(tmp_path):
    loop = current_trial_loop(plants.stage(), ["F"])
    save_log(run_trials(loop, Law(Settings.of(Plant("", loop)).Q, None), np.zeros((9, 1)), None, 1),
             tmp_path / "bare.csv")  # fmt: skip
    with pytest.raises(ValueError, match=r"bare.csv: "):
        plant_of_file(tmp_path / "bare.csv")
