"""A response from records as they come: against plants that are known, and what is refused."""

import warnings

import numpy as np
import pytest
from plants import lags
from records import held
from regions import KINDS, response, several, single
from scipy.signal import lfilter

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    measured_response,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.law.notes import NO_RESET, RESET
from ilctools.models import frequency_response


def off(estimate, truth):
    return np.linalg.norm(estimate.response - truth, 2, axis=(1, 2))


def covers(estimate, plant, median=np.inf):
    """The joint 99 % region has the truth in it, and is not large where P is identified."""
    of = response if isinstance(plant, list) else frequency_response
    error = off(estimate, of(plant, estimate.omega))
    assert np.all(error <= estimate.radius(0.99, jointly=True))
    assert np.median(estimate.radius()[estimate.known]) < median


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
    covers(measured_response(log, *of), plants)


@pytest.mark.parametrize("kind", ["steps", "steps, drift", "learning, 2 trials"])
def test_the_last_digits_of_a_record_do_not_move_the_region(kind):
    """By less than a thousandth: what the next processor rounds otherwise is no result."""
    log, _ = KINDS[kind](np.random.default_rng([0, 99]))
    here, there = (measured_response(one) for one in (log, log.assign(y=log.y * (1 + 1e-15))))
    radius = here.radius(0.99, jointly=True)
    np.testing.assert_allclose(there.radius(0.99, jointly=True), radius, rtol=1e-3)
    assert np.all(off(there, here.response) < 1e-3 * radius)


def test_trials_under_learning_give_P(tmp_path):
    """From noise in the sensors and a rich reference, without what repeats in all trials."""
    loop, trials, samples = current_trial_loop(lags()), 3, 160
    rng = np.random.default_rng(0)
    L = LearningFilter(np.eye(2)[..., None] * [0, 0, 0, 0, 0, 0.3], loop.Ts)
    r = 0.3 * held(rng, 4, 2, samples).T
    noise = 1e-3 * rng.standard_normal((trials, samples, 2))
    noise += np.cumsum(0.03 * rng.standard_normal((samples, 2)), axis=0)
    law = Law(zero_phase_butterworth(2, 0.5, loop.Ts), L)
    with warnings.catch_warnings(action="ignore"):  # not all of them converge
        save_log(run_trials(loop, law, r, None, trials, noise=noise), tmp_path / "log")
    estimate = measured_response(load_log(tmp_path / "log"))
    assert estimate.loop.outputs == loop.outputs and estimate.known.mean() > 0.5
    size = np.linalg.norm(loop.frequency_response(estimate.omega), 2, (1, 2)).max()
    covers(estimate, loop.P, 0.2 * size)


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
    covers(together, plants)
    assert np.median(together.radius() / alone.radius()) < 0.9


def test_logs_of_one_length_are_one_as_what_disturbs_them_may_repeat():
    """Of trials under learning, one file each, the truth was up to 5 radii away."""
    log, _ = KINDS["learning"](np.random.default_rng([0, 99]))
    apart = measured_response([log.isel(trial=[k]) for k in range(8)])
    np.testing.assert_array_equal(apart.response, measured_response(log).response)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("three trials saturate", "large inputs|trial 1"),
        ("quadratic", "large inputs"),
        ("gain drifts by 20 %", "the course of trial 1"),
        ("backlash", "moves up and down"),
    ],
)
def test_what_is_not_one_linear_plant_is_said(kind, words):
    log, _ = KINDS[kind](np.random.default_rng(1))
    with pytest.warns(UserWarning, match=f"y0 does not respond as in one linear plant: .*{words}"):
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


def test_what_diverges_is_refused_and_what_integrates_is_within_the_region():
    """A short record cannot distinguish what integrates from a slow lag: it may be warned of."""
    rng = np.random.default_rng(0)
    u, noise = np.repeat(rng.standard_normal(67), 3)[:200], rng.standard_normal(200)

    def log(pole):
        y = lfilter([0, 0.1], [1, -pole], u)
        return single(u, y + 0.1 * y.std() * noise)

    with pytest.raises(ValueError, match="y0 does not settle"):
        measured_response(log(1.05))
    with pytest.warns(UserWarning, match="P rises like an integrator"):
        estimate = measured_response(log(1.0))
    covers(estimate, [[([0, 0.1], [1, -1.0])]])


def test_a_long_delay_is_found_where_the_fit_without_it_has_lost_B():
    """From there a search with the delay stays where B is nothing."""
    log, plants = KINDS["a long delay, noise"](np.random.default_rng([7, 19]))
    estimate = measured_response(log)
    covers(estimate, plants)
    assert estimate.known.mean() > 0.9


def test_what_may_not_settle_is_warned_of():
    """An integrator under much noise."""
    u, noise = np.random.default_rng(2).standard_normal((2, 200))
    with pytest.warns(UserWarning, match="y0 may not settle"):
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
