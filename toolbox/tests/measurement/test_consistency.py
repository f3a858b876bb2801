"""Score tests of one linear plant: by hand, on two levels, on loops, and of many trials."""

from dataclasses import replace

import numpy as np
import pytest
from problems import memory
from records import backlash, dead, dense, group_of, held, in_a_loop
from scipy.signal import detrend, lfilter

from ilctools.measurement.arx.regression import regression
from ilctools.measurement.arx.trials import series_of
from ilctools.measurement.consistency import (
    CURVED,
    FOLLOWS,
    PLAY,
    columns_of,
    contradictions,
    score,
)
from ilctools.measurement.estimation import SEEN


def said(groups, reference=True, least=SEEN):
    fit = regression(groups, not reference)
    return {words for words, by in contradictions(fit, groups, reference) if by > least}


def lagged(u, rng, noise=0.03):
    """One lag of gain one and noise."""
    return lfilter([0, 0.3], [1, -0.7], u) + noise * rng.standard_normal(u.shape)


def test_score_and_information_are_those_of_the_normal_distribution_of_y():
    rng = np.random.default_rng(0)
    u = rng.standard_normal((3, 80))
    groups = [group_of(lagged(u, rng), u)]
    fit = regression(groups, False)
    layout, post = fit.data.layout, fit.posterior
    columns = columns_of(fit, groups)
    q, J, power = score(fit, groups, columns)
    rows, means = dense(groups, layout)
    X, y = rows[:, :-1], rows[:, -1]
    of_B = layout.where_B(0)
    gain = X[:, of_B] @ fit.mean[of_B]
    added = [detrend(columns(series)) for series in series_of(groups)]
    Z = np.column_stack([gain, np.hstack(added).T])
    V = np.diag(1 / np.where(means, post.weight, 1.0)) + X * post.root_D**2 @ X.T
    unit = np.sqrt(power.diagonal())
    Z /= unit
    by_hand = Z.T @ np.linalg.solve(V, np.column_stack([y, Z]))
    np.testing.assert_allclose(by_hand[:, 0], q / unit, atol=1e-6 * np.linalg.norm(y))
    np.testing.assert_allclose(by_hand[:, 1:], J / np.outer(unit, unit), atol=1e-6)


@pytest.mark.parametrize("held", [1, 12])
def test_two_levels_are_not_curved(held):
    """Squares and cubes of two levels are lines, and so is the sign of the last move.

    Three draws; a hundred of each kind are counted by ``make measure WHAT=regions``.
    """
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, 1.0], 300 // held), held)[None]
        assert not said([group_of(lagged(u, rng), u)], False)


def test_a_dead_zone_and_backlash_are_said_but_not_what_is_hardly_curved():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal((1, 40)), 10, axis=1)
        behind = backlash(u[0], 0.3)[None]
        assert PLAY in said([group_of(lagged(behind, rng), u)])
        assert CURVED in said([group_of(lagged(dead(u, 0.6), rng), u)])
        groups = [group_of(lagged(u + 0.003 * u**3, rng, 1e-4), u)]
        assert not said(groups) and CURVED in said(groups, least=0.002)


def test_a_spring_that_stiffens_is_said():
    """A resonance whose spring is stronger by a hundredth of the square of its travel."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        u, y = np.repeat(rng.standard_normal((1, 500)), 3, axis=1), np.zeros((1, 1500))
        for t in range(2, 1500):
            force = u[0, t - 1] - 0.01 * y[0, t - 1] ** 3
            y[0, t] = 1.9 * y[0, t - 1] - 0.98 * y[0, t - 2] + 0.08 * force
        noisy = y + 0.03 * rng.standard_normal(y.shape)
        assert CURVED in said([group_of(noisy, u)])
        linear = lfilter([0, 0.08], [1, -1.9, 0.98], u) + 0.03 * rng.standard_normal(y.shape)
        assert not said([group_of(linear, u)])


@pytest.mark.parametrize(
    ("moves", "controller"),
    [(0.0, ([0.32, -0.3], [1, -1])), (0.05, ([0.32, -0.3], [1, -1])), (0.0, ([1.5, -0.5], [1]))],
)
def test_a_loop_without_its_reference_is_said(moves, controller):
    """What is estimated is -1 / C, at a radius of nothing."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        r = moves * held(rng, 600)
        noise = lfilter([0.05], [1, -0.9], rng.standard_normal(600))
        u, y = in_a_loop(([0, 0.3], [1, -0.7]), controller, r, noise)
        assert FOLLOWS in said([group_of(y[None], u[None])], False)


@pytest.mark.parametrize("direct", [0, 1])
@pytest.mark.parametrize("noise", [0.03, 1e-4])
def test_an_open_loop_in_which_y_answers_at_once_is_not_a_closed_one(direct, noise):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(100), 3)[None]
        y = lfilter([0.3 * direct, 0.3 * (1 - direct)], [1, -0.7], u)
        assert FOLLOWS not in said([group_of(y + noise * rng.standard_normal(y.shape), u)], False)


def test_memory_grows_as_the_trials_do():
    """Columns of each trial are made for one contrast at a time: no trial by trial by time."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((90, 200))
    groups = [group_of(lagged(u, rng), u)]
    fit = regression(groups, False)
    # of 8 bytes each
    assert memory(lambda: list(contradictions(fit, groups))) < 8 * 90 * 90 * 200


def disturbed(gains, direct=0.0, N=200):
    """Of one input and one disturbance of ten times its effect; another gain of P in each trial."""
    rng, K = np.random.default_rng(0), len(gains)
    u, d = held(rng, 2, K, N, samples=2)
    y = np.array(gains)[:, None] * lfilter([0, 0.1], [1, -0.9], u)
    y = y + lfilter([direct, 1.0], [1, -0.9], d) + 0.003 * rng.standard_normal((K, N))
    return [group_of(y, u, d, known=1)]


def test_a_contradiction_is_by_how_much_of_P_whatever_the_disturbance_does():
    groups = disturbed([1.0, 1.0, 1.5, 1.0])
    found = dict(contradictions(regression(groups, False), groups))
    assert max(found, key=found.get) == "trial 2"
    # 1.5 and 1 differ by 0.5 of 1.125, the mean; a quarter of the power goes into the mean itself
    assert found["trial 2"] == pytest.approx(0.75**0.5 * 0.5 / 1.125, abs=0.05)
    assert not said(disturbed([1.0] * 4))


def test_a_trial_of_another_length_is_found_by_its_name():
    (first,), (second,) = disturbed([1.0, 1.0]), disturbed([1.0, 1.5, 1.0], N=150)
    groups = [first, replace(second, names=("a", "b", "c"))]
    found = dict(contradictions(regression(groups, False), groups))
    assert max(found, key=found.get) == "b"


def test_a_disturbance_that_acts_at_once_is_no_sign_of_a_loop():
    """Nor is it left out where commands are known to act a sample later."""
    groups = disturbed([1.0, 1.0], direct=3.0)
    fit = regression(groups, False)
    assert FOLLOWS not in dict(contradictions(fit, groups, False))
    np.testing.assert_allclose(fit.impulse(1).ravel(), [0, 3.0], atol=0.02)
