"""Noise on a trial with two ends: against impulses in every sample, matrices, and seeds."""

from dataclasses import replace

import control
import numpy as np
import pytest
from plants import tanks

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    noise_on_trial,
    p_type,
    paper_loop,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc import converged_noise, trial_noise, trial_operators
from rodlib.ilc.evidence.finite_trial import impulse_response
from rodlib.ilc.loop.closed import with_noise
from rodlib.ilc.trials.run import rms
from tests.ilc.evidence.test_noise import case

VARIANCE = {"stage": [4.0], "tanks": [1.0, 4.0, 9.0]}


def by_impulses(loop, Q, L, samples, variance, trials, rest=0, step=1.0, plant=None):
    """Variances of true and measured outputs in the last trial, from one impulse after another.

    What one in the first trial leaves k trials later is what one k trials before the last leaves
    in the last: the law is the same from each trial to the next.
    """
    m, power = len(variance), np.zeros((2, samples, len(variance)))
    still, law = np.zeros((samples, m)), Law(Q, L, rest, step)
    for p, channel in np.ndindex(samples, m):
        noise = np.zeros((trials, samples, m))
        noise[0, p, channel] = np.sqrt(variance[channel])
        run = run_trials(loop, law, still, None, trials, plant=plant, noise=noise)
        e = run.e.values
        power += np.sum(np.stack([e + noise, e]) ** 2, axis=1)
    return power


@pytest.mark.filterwarnings(
    "ignore:the error grows"
)  # an impulse, in one trial of them
@pytest.mark.parametrize("name", ["stage", "tanks"])
@pytest.mark.parametrize(
    "how",
    [{"trials": 1}, {"trials": 4}, {"trials": 3, "rest": 7, "step": 0.6}],
    ids=str,
)
@pytest.mark.parametrize("ends", ["zero", "hold"])
def test_each_impulse_of_noise_run_through_the_trials(name, how, ends):
    """Whatever the law does at the ends, to rounding."""
    loop, Q, _, [L] = case(name)
    Q, L = replace(Q, ends=ends), replace(L, ends=ends)
    expected = by_impulses(loop, Q, L, 30, VARIANCE[name], **how)
    found = noise_on_trial(loop, Q, L, 30, VARIANCE[name], **how)
    limit = 1e-9 * expected.max()
    np.testing.assert_allclose(found.true**2, expected[0], rtol=1e-9, atol=limit)
    np.testing.assert_allclose(found.measured**2, expected[1], rtol=1e-9)
    assert rms(found.true) == pytest.approx(np.sqrt(expected[0].sum() / 30), rel=1e-9)
    learned = (
        found.true**2
        - noise_on_trial(loop, Q, L, 30, VARIANCE[name], trials=1).true ** 2
    )
    np.testing.assert_allclose(found.learned**2, learned, atol=1e-12 * expected.max())


@pytest.mark.filterwarnings("ignore:the error grows")
def test_around_another_plant_and_with_another_learning_operator():
    loop, Q, _, _ = case("tanks")
    L = p_type(0.5, 2, 3, loop.Ts)
    other = control.ss(0.97 * loop.plant.A, loop.plant.B, loop.plant.C, 0, loop.Ts,
                       inputs=loop.plant.input_labels, outputs=loop.outputs)  # fmt: skip
    expected = by_impulses(loop, Q, L, 25, [1.0] * 3, trials=3, plant=other)
    found = noise_on_trial(loop, Q, L, 25, 1.0, trials=3, plant=other)
    np.testing.assert_allclose(found.measured**2, expected[1], rtol=1e-9)
    assert list(found.output) == loop.outputs and found.time[1] == loop.Ts
    before = noise_on_trial(loop, Q, L, 25, 1.0, trials=3)
    assert abs(rms(before.learned) / rms(found.learned) - 1) > 0.01


def dense(loop, Q, L, samples, sigma):
    """Converged variances (true, measured) by the book: matrices of the whole trial."""
    m = loop.plant.noutputs
    P, Q, L = (X @ np.eye(samples * m) for X in trial_operators(loop.P, Q, L, samples))
    h = impulse_response(with_noise(loop)[:, -m:], samples)
    T = np.zeros((samples, m, samples, m))
    for p in range(samples):
        T[p:, :, p] = h[: samples - p]
    T = sigma * T.reshape(P.shape)
    M, B = Q @ (np.eye(len(P)) - L @ P), Q @ L @ (sigma * np.eye(len(P)) + T)
    V = B @ B.T
    for _ in range(30):
        V, M = V + M @ V @ M.T, M @ M
    learned = ((P @ V) * P).sum(axis=1)
    return [((X**2).sum(axis=1) + learned).reshape(samples, m)
            for X in (T, sigma * np.eye(len(P)) + T)]  # fmt: skip


def test_cut_short_in_the_middle_it_is_that_of_the_whole_trial():
    loop, Q, omega, [L] = case("stage")
    samples = 900
    found = noise_on_trial(loop, Q, L, samples, 0.25)
    true, measured = dense(loop, Q, L, samples, 0.5)
    np.testing.assert_allclose(found.true**2, true, rtol=1e-2, atol=1e-3 * true.max())
    np.testing.assert_allclose(found.measured**2, measured, rtol=1e-2)
    for each, expected in [(found.true, true), (found.measured, measured)]:
        assert rms(each) == pytest.approx(np.sqrt(expected.sum() / samples), rel=1e-3)
    flat = found.learned[samples // 2]
    assert (found.learned == flat).all("channel").sum() > samples / 4  # it was cut
    endless = converged_noise(trial_noise(loop, omega, 0.25), Q, L)
    np.testing.assert_allclose(found.true[samples // 2], endless.true.rms, rtol=5e-3)
    np.testing.assert_allclose(flat, endless.learned.rms, rtol=5e-3)


@pytest.mark.parametrize(
    ("L_max", "start", "whole"), [(50, 6.2, 6.7), (400, 23.9, 9.1)]
)
def test_the_paper_s_loop_by_seeds(L_max, start, whole):
    """What the rod does in 25 trials after the fifteenth, within four standard errors (1 to 4 %).

    The formula without ends says 6.6 and 6.3 mK.
    """
    loop, Q = paper_loop(), zero_phase_butterworth()
    omega = np.geomspace(1e-4, np.pi, 1000)
    L = synthesise(loop, Q, omega, L_max=L_max).filter
    found = noise_on_trial(loop, Q, L, 2500, 0.02**2)
    noise = 0.02 * np.random.default_rng(3).standard_normal((40, 2500, 2))
    run = run_trials(loop, Law(Q, L), np.zeros((2500, 2)), None, 40, noise=noise)
    y = (run.e + noise)[15:]
    for part, expected in [
        (slice(None), whole),
        (slice(100), start),
        (slice(2400, None), None),
    ]:
        seen, said = (
            rms(y.isel(time=part)) ** 2,
            float(rms(found.true.isel(time=part)) ** 2),
        )
        # a converged trial remembers about as many trials as the slowest rate tells, ten
        error = float(seen.std() / np.sqrt(len(seen) / 4))
        assert abs(float(seen.mean()) - said) < 4 * error
        if expected:
            assert 1e3 * np.sqrt(said) == pytest.approx(expected, abs=0.06)
    endless = converged_noise(trial_noise(loop, omega, 0.02**2), Q, L).true.rms
    np.testing.assert_allclose(found.true[1250], endless, rtol=1e-3)


def test_what_does_not_fit_is_refused():
    loop, Q, _, [L] = case("stage")
    with pytest.raises(
        ValueError, match="noise reaches -1, but a variance is not negative"
    ):
        noise_on_trial(loop, Q, L, 30, -1.0)
    with pytest.raises(
        ValueError, match=r"noise has shape \(2,\), but must have shape \(1,\)"
    ):
        noise_on_trial(loop, Q, L, 30, [1.0, 1.0])
    with pytest.raises(
        ValueError, match="L does not converge on a trial with two ends"
    ):
        noise_on_trial(loop, Q, LearningFilter(-L.coefficients, L.Ts), 300, 1.0)
    loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
    with pytest.raises(ValueError, match="L acts on 1 channels, but must act on 3"):
        noise_on_trial(
            loop, replace(Q, cutoff=0.3, Ts=2.0), replace(L, Ts=2.0), 30, 1.0
        )
