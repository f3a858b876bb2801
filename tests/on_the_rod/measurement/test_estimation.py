"""A response from records as they come: against plants that are known, and what is refused."""

import numpy as np
import pytest
from regions import KINDS, response, several, single
from scipy.signal import lfilter

from ilctools import measured_response, read_table, state_sequence
from ilctools.law.notes import NO_RESET, RESET
from ilctools.models import from_rest
from rodlib.paper import ROOT


def off(estimate, truth):
    return np.linalg.norm(estimate.response - truth, 2, axis=(1, 2))


def covers(estimate, plants):
    """Whether the joint 99 % region has the truth in it."""
    error = off(estimate, response(plants, estimate.omega))
    return np.all(error <= estimate.radius(0.99, jointly=True))


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("steps, short", 0),
        ("steps, wrong start", 0),
        ("learning", 0),
        ("learning, delay of 30", 2),  # with lags as long as a trial it is 3.2 radii away
        ("fast and slow", 1),  # without slow parts, 5.8
        ("a long delay, noise", 1),  # without a search for delays, widely
        ("feedback, coloured noise", 1),  # of commands, which follow the noise
    ],
)
def test_the_truth_is_within_the_region(kind, seed):
    """Once; `make measure WHAT=regions` counts 200 of each kind."""
    log, plants, *of = KINDS[kind](np.random.default_rng([seed, 99]))
    assert covers(measured_response(log, *of), plants)


@pytest.mark.parametrize("kind", ["steps", "steps, drift", "learning, 2 trials"])
def test_the_last_digits_of_a_record_do_not_move_the_region(kind):
    """By less than a thousandth: what the next processor rounds otherwise is no result."""
    log, _ = KINDS[kind](np.random.default_rng([0, 99]))
    here, there = (measured_response(one) for one in (log, log.assign(y=log.y * (1 + 1e-15))))
    radius = here.radius(0.99, jointly=True)
    np.testing.assert_allclose(there.radius(0.99, jointly=True), radius, rtol=1e-3)
    assert np.all(off(there, here.response) < 1e-3 * radius)


def test_frequencies_without_power_are_not_identified():
    """An input that moves slowly says nothing of high frequencies, where noise is."""
    rng, N, plant = np.random.default_rng(0), 300, ([0, 0.3], [1, -0.7])
    u = np.sin(2 * np.pi * np.arange(N) / 100) + np.sin(2 * np.pi * np.arange(N) / 33)
    estimate = measured_response(single(u, lfilter(*plant, u) + 0.05 * rng.standard_normal(N)))
    unknown = ~estimate.known
    assert unknown[estimate.omega > 2].all() and not unknown.all()
    size = np.linalg.norm(estimate.response, 2, axis=(1, 2))
    np.testing.assert_array_equal(unknown, estimate.radius() >= size)
    first = np.flatnonzero(estimate.known)[0]
    assert f"identified from {estimate.omega[first]:.3g} to" in repr(estimate)
    assert np.all(off(estimate, response([[plant]], estimate.omega)) <= estimate.radius(0.99))


def test_several_records_tell_more_than_one():
    """Of different lengths, with unknown starts: less radius than from the longest alone."""
    logs, plants = KINDS["three lengths"](np.random.default_rng(5))
    alone, together = measured_response(logs[1]), measured_response(logs[:2])
    assert covers(together, plants)
    assert np.median(together.radius() / alone.radius()) < 0.9


def test_logs_of_one_length_are_one_as_what_disturbs_them_may_repeat():
    """Of trials under learning, one file each, the truth was up to 5 radii away."""
    log, _ = KINDS["learning"](np.random.default_rng([0, 99]))
    apart = measured_response([log.isel(trial=[k]) for k in range(8)])
    np.testing.assert_array_equal(apart.response, measured_response(log).response)


def test_a_gain_that_drifts_is_said():
    log, _ = KINDS["gain drifts by 20 %"](np.random.default_rng(1))
    words = "y0 does not respond as in one linear plant: .*the course of trial 1"
    with pytest.warns(UserWarning, match=words):
        estimate = measured_response(log)
    assert estimate.apart > 0.01 and estimate.findings[0] in str(estimate)


def test_trials_without_reset_are_one_record():
    rng = np.random.default_rng(0)
    w = np.repeat(rng.standard_normal(200), 3)
    y = lfilter([0, 0.2], [1, -0.8], w) + 0.02 * rng.standard_normal(600)
    logs = [several(*(x.reshape(-1, N, 1) for x in (w, y)), "w") for N in (600, 150)]
    logs[1].attrs[RESET] = NO_RESET
    one, four = map(measured_response, logs)
    np.testing.assert_array_equal(four.response, one.response)


def test_a_long_delay_is_found_where_the_fit_without_it_has_lost_B():
    """From there a search with the delay stays where B is nothing."""
    log, plants = KINDS["a long delay, noise"](np.random.default_rng([7, 19]))
    estimate = measured_response(log)
    assert covers(estimate, plants)
    assert estimate.known.mean() > 0.9


def test_what_may_not_settle_is_warned_of():
    """An integrator under much noise."""
    u, noise = np.random.default_rng(2).standard_normal((2, 200))
    with pytest.warns(UserWarning, match="y0 may not settle, or a periodic disturbance"):
        measured_response(single(u, np.cumsum(u) - u + noise))


def test_records_without_enough_excitation_are_refused():
    rng, N = np.random.default_rng(0), 120
    u, noise = rng.standard_normal((2, N)), 0.01 * rng.standard_normal((2, N))
    whole = single(u, u + noise)
    for log, of, message in (
        (single(u * [[1], [0]], u), None, "u1 never moved"),
        (single(u, u * [[0], [1]]), None, "y0 never moved"),
        (single(u[:, :9], u[:, :9]), None, "9 samples"),
        (single(u[[0, 0]], u + noise), None, "moved alike"),
        (whole, "w", "reference"),
        (whole.drop_vars("u"), None, "commands u"),
        (whole, "y", "of = 'y'"),
    ):
        with pytest.raises(ValueError, match=message):
            measured_response(log, of)
    with pytest.raises(ValueError, match="uncertainty"):
        measured_response(whole, uncertainty=[0.1])


@pytest.mark.filterwarnings("ignore:.*may not settle")  # half a record is short
@pytest.mark.parametrize("name", ["board-1s", "board-3s"])
def test_the_first_half_of_a_real_record_predicts_the_second(name):
    """More than half of each output's variance, from the best state and offset at the middle."""
    log = read_table(
        ROOT / "data" / "tclab" / f"{name}.csv",
        time=0,
        inputs={"Q1": "Heater 1", "Q2": "Heater 2"},
        outputs={"T1": "Temperature 1", "T2": "Temperature 2"},
    )
    middle = log.sizes["time"] // 2
    model = measured_response(log.isel(time=slice(middle))).model()
    u, y = log.u.values[0, middle:], log.y.values[0, middle:]
    states = np.eye(model.nstates)
    free = [state_sequence(model.A, 0 * u @ model.B.T, x) @ model.C.T for x in states]
    offsets = [np.broadcast_to(one, y.shape) for one in np.eye(2)]
    columns = np.reshape([*free, *offsets], (-1, y.size)).T
    missed = (y - from_rest(model, u)).ravel()
    left = np.reshape(missed - columns @ np.linalg.lstsq(columns, missed)[0], y.shape)
    assert np.all(left.var(axis=0) < 0.45 * y.var(axis=0))
