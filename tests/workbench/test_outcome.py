"""From settings to a filter: against the lines of Python and trials run by hand."""

from dataclasses import replace

import control
import numpy as np
import plants
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ilctools import ClosedLoop, Law, synthesise
from rodlib import Rod, Settings, try_out
from rodlib.paper import plant_of_rod
from rodlib.workbench.plant import Plant

SOURCES = {  # as a reader would type them, and the filter's order
    "stage": (
        "ilctools.current_trial_loop(plants.stage(), ['F'], {'x': 1.0, 'F': 3.0}, {'x': 'mm'})", 10
    ),
    "tanks": ("ilctools.current_trial_loop(plants.tanks(), plants.PUMPS)", 6),
}  # fmt: skip


def run(lines):
    namespace = {"plants": plants}
    exec(lines, namespace)
    return namespace


def settings_of(name):
    source, order = SOURCES[name]
    loop = run(f"import ilctools, rodlib\nloop = {source}")["loop"]
    return Settings.of(Plant(source, loop, choices={"order": order}))


@pytest.fixture(scope="module", params=SOURCES)
def outcome(request):
    return try_out(settings_of(request.param))


@pytest.fixture(scope="module")
def rod():
    return Settings.of(plant_of_rod(Rod()))


@pytest.fixture(scope="module")
def stage():
    return settings_of("stage")


def check_lines(outcome):
    """The lines of Python make the same filter; their namespace."""
    namespace = run(outcome.settings.python)
    by_hand = namespace["design"].filter.coefficients
    np.testing.assert_array_equal(outcome.design.filter.coefficients, by_hand)
    assert namespace["law"].rest == outcome.settings.plant.rest
    return namespace


@pytest.mark.parametrize("name", ["rod", "tanks"])
def test_the_lines_make_the_same_filter(name, rod):
    settings = rod if name == "rod" else settings_of(name)
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


def test_the_certificate_agrees_with_singular_values(outcome):
    Ts, certificate = outcome.settings.Ts, outcome.design.certificate
    sigma_M, sigma_L = sigma_of(outcome, np.linspace(1e-6, np.pi / Ts, 4000))
    in_band = sigma_of(outcome, np.geomspace(*outcome.settings.band, 2000))[0]
    assert sigma_M.max() == pytest.approx(certificate.all_M, rel=2e-3)
    assert sigma_L.max() == pytest.approx(certificate.all_L, rel=2e-3)
    assert certificate.mean_M == pytest.approx(in_band.mean(), rel=5e-2, abs=1e-3)
    assert f"band: {certificate.mean_M:.4f}" in outcome.text


def test_the_trials_are_those_of_the_law(outcome):
    """Three of them by hand, simulated by python-control."""
    plant = outcome.settings.plant
    loop, r = plant.loop, plant.reference
    v, errors = np.zeros_like(r), []
    for _ in range(3):
        w = np.hstack([r + v, np.zeros((len(r), len(loop.disturbances)))])
        e = r - np.atleast_2d(control.forced_response(loop.closed, U=w.T).outputs).T
        errors.append(np.sqrt(np.mean(np.sum(e**2, axis=1))))
        v = Law(outcome.settings.Q, outcome.design.filter, rest=15).next(v, e)
    assert len(outcome.rms) == 10
    np.testing.assert_allclose(outcome.rms[:3], errors, rtol=1e-6, atol=1e-9)
    assert errors[2] < 0.2 * errors[0]


def test_the_remedy_is_the_smallest_that_helps(rod):
    settings = replace(rod, M_max=0.3, order=3, uncertainty=3.0)
    outcome = try_out(settings)
    assert outcome.design is None and outcome.rms == ()
    assert outcome.text == outcome.message and "M_max" in outcome.message
    assert try_out(replace(settings, M_max=outcome.M_max)).design is not None
    assert try_out(replace(settings, M_max=outcome.M_max - 0.0021)).design is None


REFUSALS = [  # settings without a filter or a remedy, and what the message names
    ({"cutoff": 2.0, "L_max": 0.5, "order": 1}, "infeasible"),
    ({"cutoff": 9.0}, "cutoff = 9.0"),
    ({"band": (0.1, 0.01)}, "band = (0.1, 0.01)"),
    ({"noise": np.nan}, "noise = nan"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSALS)
def test_settings_without_a_filter_are_answered_by_a_message(rod, changes, message):
    outcome = try_out(replace(rod, **changes))
    assert outcome.design is None and outcome.M_max is None
    assert message in outcome.message


def test_whatever_the_synthesis_raises_is_a_message_with_what_the_workbench_has(rod, monkeypatch):
    """A bare RuntimeError, of limits that the solver cannot meet, or what overflows."""

    def fail(*arguments, **keywords):
        raise error

    monkeypatch.setattr("rodlib.workbench.outcome.synthesise", fail)
    for error in (RuntimeError("take more frequencies"), OverflowError("too large")):
        outcome = try_out(rod)
        assert outcome.design is None and outcome.message.startswith(str(error))
        assert ("200 frequencies" in outcome.message) == isinstance(error, RuntimeError)


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


def test_settings_begin_with_the_plants_choices_or_the_defaults(rod, stage):
    """With another sampling period, all frequencies move with it, and the rule for the gain."""
    assert (rod.M_max, rod.L_max, rod.cutoff) == (0.9, 50.0, 0.1)
    assert rod.band == (1e-4, 0.02)
    assert (rod.order, rod.Q_order, rod.structure) == (10, 2, "diagonal")
    assert (stage.cutoff, stage.band) == (100.0, (0.1, 100.0))
    assert stage.omega[-1] == np.pi * 1000
    P = np.abs(stage.plant.loop.frequency_response(np.linspace(0.1, 100.0, 1000)))
    assert 4 * (1 - 1e-9) <= stage.L_max * P.min() < 8
    problem = synthesise(stage.plant.loop, stage.Q, stage.omega, order=10).problem
    assert (problem.L_max, problem.band) == (stage.L_max, stage.band)


@pytest.mark.parametrize(
    ("message", "task"),
    [
        ("reference", {"reference": np.zeros((20, 2))}),
        ("disturbance", {"disturbance": np.ones((9, 1))}),
        ("rest", {"rest": 1000}),
        ("loop has no P", {"loop": ClosedLoop(Ts=1.0, outputs=["y"])}),
    ],
)
def test_the_task_must_fit_a_plant_with_a_model(stage, message, task):
    with pytest.raises(ValueError, match=message):
        replace(stage.plant, **task)
