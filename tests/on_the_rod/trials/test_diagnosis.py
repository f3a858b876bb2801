"""Trials that go wrong are warned of; trials that converge are not."""

import warnings
from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import PUMPS, altered, bump, furnace, tanks
from scipy.signal import lfilter
from scipy.stats import f as f_distribution

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.trials.diagnosis import chance, chance_of_excess, unexplained
from ilctools.trials.rms import rms_by_octave

GRID = np.geomspace(1e-4, np.pi, 200)


def white(seed, *shape):
    return np.random.default_rng(seed).standard_normal(shape)


@cache
def furnace_law(cutoff):
    """The law of a furnace whose pipe holds 20 samples, bound to its loop."""
    loop = current_trial_loop(furnace(20), None, {"valve": 0.1})
    Q = zero_phase_butterworth(2, cutoff, 1.0)
    design = synthesise(loop, Q, GRID, 1.0, order=30, band=(1e-4, cutoff / 3))
    return Law(Q, design.filter, loop=loop)


@pytest.fixture
def free():
    """The loop of a furnace by its P alone, and a law that is bound to none."""
    law = furnace_law(0.05)
    return ClosedLoop(law.loop.P), replace(law, loop=None), bump(600, [10.0]), None


@pytest.fixture(scope="module")
def tank_law():
    loop, Q = current_trial_loop(tanks(), PUMPS), zero_phase_butterworth(2, 0.02, 2.0)
    design = synthesise(loop, Q, GRID / 2, 2.0, order=10, band=(1e-4, 0.007))
    return Law(Q, design.filter, loop=loop)


LEVELS = [10.0, 5.0, 8.0]


@pytest.fixture(scope="module")
def cases(tank_law):
    """Laws that converge, the size of a reference, and plants for which they do."""
    cases = [(tank_law, LEVELS, [None])]
    for gain in (0.02, 0.3):
        L = LearningFilter(gain * np.eye(3)[..., None], 2.0)
        cases.append((Law(tank_law.Q, L, loop=tank_law.loop), LEVELS, [None]))
    plants = [None, furnace(20, gain=1.1), furnace(21, gain=0.9)]
    return [*cases, *((furnace_law(cutoff), [10.0], plants) for cutoff in (0.05, 0.2))]


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_ordinary_trials_are_not_warned_of(cases, seed):
    """Converging, with noise, white or not, and disturbances that repeat or do not."""
    rng = np.random.default_rng(seed)
    law, amplitude, plants = cases[rng.integers(len(cases))]
    law = Law(law.Q, law.L, gain=rng.choice([1.0, 0.5, 0.2]), loop=law.loop)
    samples, trials, m = rng.integers(150, 900), rng.integers(4, 16), len(amplitude)
    pole, d = rng.choice([0, 0.5, 0.9, 0.98]), len(law.loop.disturbances)
    noise = rng.standard_normal((trials, samples + 200, m))
    noise = lfilter([1 - pole], [1, -pole], noise, axis=1)[:, 200:]
    noise *= 10 ** rng.uniform(-4, -0.3) * max(amplitude)
    push = rng.standard_normal((rng.choice([1, trials]), 1, d))
    push = 10 ** rng.uniform(-2, 0.5) * push * bump(samples, np.ones(d))
    push = np.broadcast_to(push, (trials, samples, d))
    plant = plants[rng.integers(len(plants))]
    with warnings.catch_warnings():
        if plant is not None:  # where it is right
            warnings.filterwarnings("ignore", "the convergence rate")
        reference = bump(samples, amplitude)
        run_trials(law.loop, law, reference, push, trials, noise=noise, plant=plant)


def test_the_probability_of_growth_by_chance_is_that_of_counting():
    x = np.sqrt(np.mean(white(0, 200000, 4, 6) ** 2, axis=2))
    increasing = (np.diff(x) > 0).all(axis=1)
    for ratio in (1.5, 3.0):
        seen = np.mean(increasing & (x[:, -1] >= ratio * x[:, 0]))
        assert 0.3 * chance(ratio, 6, 4) < seen < 1.1 * chance(ratio, 6, 4)
    assert chance(2.0, 6, 2) == pytest.approx(f_distribution.sf(4.0, 6, 6))
    assert chance(1e200, 6, 2) < 1e-100


def test_the_probability_of_an_excess_is_that_of_counting():
    """Of noise whose variance is estimated where a gain and a phase were fitted."""
    noise, predicted = white(0, 3000, 3, 15, 1), white(1, 1, 15, 1).repeat(3, axis=0)
    F, n = [], np.array([8.0])  # values in the octave from harmonic 4 on
    for changes in noise:
        _, size, freedom = unexplained(changes[:2] + 5 * predicted[:2], predicted[:2])
        F.append(rms_by_octave(changes[2])[2] ** 2 / size[2])
        assert freedom[2] <= n
    for f in (1.5, 4.0):
        p = chance_of_excess(np.sqrt([f]), 1.0, n, 2)
        assert np.mean(f < np.array(F)) == pytest.approx(p.item(), rel=0.15)
        two = chance_of_excess(np.sqrt([f, f]), 1.0, n, 2)  # octaves
        np.testing.assert_allclose(two, 2 * np.append(p, p))


def test_other_references_and_noise_alone_are_no_growth(cases, free):
    """Noise alone: the error rises to the level of the noise that was learned."""
    law, amplitude, _ = cases[2]
    growing = [bump(200, a * np.array(amplitude)) for a in (0.1, 0.3, 1.0, 3.0, 9.0)]
    run_trials(law.loop, law, np.array(growing), trials=5)
    # of a delay, where sigma_max(M) = 0.9 makes much of noise, but no more than it must
    law = Law(zero_phase_butterworth(2, 3.0, 1.0), LearningFilter([[[1.9]]], 1.0))
    delay = ClosedLoop(control.ss(0, 1, 1, 0, 1.0)), law
    for task, trials, least in (free[:2], 12, 1), (delay, 5, 3):
        noise = white(trials % 12, trials, 900, 1)
        size = rms(run_trials(*task, 0 * noise[0], trials=trials, noise=noise).e).values
        assert least < size[-1] / size[0] < 5


@pytest.mark.parametrize(("gain", "moved"), [(2.0, "2"), (0.3, "0.3")])
def test_another_gain_of_P_is_noticed_in_trial_3(gain, moved, free):
    """After one of another task, which does not count. Of twice the gain e changes its sign."""
    plant, noise = gain * free[0].P, 0.02 * white(1, 4, 600, 1)
    tasks = np.outer([0.1, 1, 1, 1], free[2])[..., None]
    with pytest.warns(UserWarning, match=f"trial 4 has .* trial [23];.* {moved} in outlet came"):
        run_trials(*free[:2], tasks, None, 4, plant=plant, noise=noise)
    run_trials(*free, 2, plant=plant)  # in the first two the noise is not known


def test_an_error_that_creeps_away_from_the_best_is_noticed(free):
    """By 2 % in each trial, where P has the wrong sign: too little to show from the one before."""
    loop, law, *task = free
    case, noise = (loop, replace(law, gain=0.02), *task, 6), 0.02 * white(1, 6, 600, 1)
    with pytest.warns(UserWarning, match=r"rate .*trial 3 has 1\.\d+ .* of trial 1;"):
        run = run_trials(*case, plant=-loop.P, noise=noise)
    assert np.all(np.diff(rms(run.e).values) < 0.03 * rms(run.e).values[0])
    run_trials(*case, plant=loop.P, noise=noise)


def test_a_disturbance_that_grows_by_as_much_in_each_trial_is_no_other_plant(free):
    """Trials after the best one it is as many times as large as from one to the next."""
    loop, law, *task = free
    noise = 0.1 * np.arange(8)[:, None, None] * white(2, 600, 1) + 0.02 * white(1, 8, 600, 1)
    run = run_trials(loop, replace(law, gain=0.02), *task, 8, noise=noise, plant=loop.P)
    size = rms(run.e).values
    assert size.argmin() == 2 and size[-1] > 1.05 * size.min()


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_slow_convergence_is_noticed(noise, tank_law):
    """Nothing else would show that the pump on the right is weak."""
    model, noise = tanks(), noise * white(3, 9, 600, 3)
    weak = altered(model, B=[1, 1, 1, 0.3])
    case = tank_law.loop, tank_law, bump(600, LEVELS), None, 9
    with pytest.warns(UserWarning, match=r"rate .* up to 0\.0.* right came") as caught:
        run = run_trials(*case, plant=weak, noise=noise)
    assert len(caught) == 1 and rms(run.e).values[-1] < 0.1 * rms(run.e).values[0]
    run_trials(*case, plant=model, noise=noise)
    noise[1] += bump(600, [2.0, 1.0, 0.0])  # a new disturbance, and later another
    noise[5] -= bump(600, [1.0, 2.0, 1.0])
    run_trials(*case, plant=model, noise=noise)
