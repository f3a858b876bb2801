"""Measuring P: against loops that are known exactly, and a rig that shares nothing with them."""

from dataclasses import replace

import numpy as np
import pytest
from plants import furnace
from rods import Failing
from scipy.signal import lfilter
from scipy.stats import binom

from ilctools import ClosedLoop, current_trial_loop, load_log, measured_response, multisine, shake
from ilctools.errors import LogError, RigError
from ilctools.law.notes import loop_note, loop_of
from ilctools.measurement.excitation import excitation_of, with_excitation
from ilctools.measurement.excited import excited_response
from ilctools.models import state_sequence
from ilctools.signals import dataset
from rodlib import paper_loop, sampled_response
from rodlib.rigs import MISMATCHED, RestartingRig, RigParameters

SEEDS = 40
CASES = {  # loop, lowest and highest frequency (rad/s), hours, noise
    "rod": (paper_loop, 0.015, 0.5, 1.5, 0.02),
    "furnace": (lambda: current_trial_loop(furnace(10)), 0.08, 1.5, 0.6, 0.01),
}  # fmt: skip


@pytest.fixture(scope="module")
def quick(loop):
    """An excitation of the paper's loop that does not take long."""
    return multisine(loop, 5e-3, 0.5, 2.0, 4.3, lines=16)


@pytest.fixture(scope="module")
def short(loop):
    """The shortest one, for rigs."""
    return multisine(loop, 0.02, 0.5, 2.0, 1.1, lines=12)


def answer(loop, w, noise=0.0):
    """Outputs of all experiments, one after the other from rest, shape (experiment, time, m)."""
    closed, m, noise = loop.closed, len(loop.outputs), noise + 0 * w
    K = np.vstack([np.zeros((closed.nstates - len(loop.KL), m)), loop.KL])
    w, n = w.reshape(-1, m), noise.reshape(-1, m)
    states = state_sequence(closed.A, w @ closed.B[:, :m].T + n @ K.T, np.zeros(closed.nstates))
    return (states @ closed.C.T + w @ closed.D[:, :m].T + n).reshape(noise.shape)


def log_of(loop, excitation, y, v=None):
    v = excitation.signals if v is None else v
    run = dataset(
        loop.Ts, loop.outputs, loop.controls, [], loop.units,
        reference=0 * v, v=v, u=0 * v, y=y,
    )  # fmt: skip
    return with_excitation(run, excitation, loop)


def noise_of(excitation, sigma, seed, count=1):
    shape = (count, *excitation.signals.shape)
    return sigma * np.random.default_rng(seed).standard_normal(shape)


def estimate(loop, excitation, y):
    """P by the lines."""
    w, y = (x[:, -excitation.evaluated :] for x in (excitation.signals, y))
    return excited_response(w, y, w, {}, excitation, loop)


def off(response, truth):
    """Distance of a response from the truth, by frequency."""
    return np.linalg.norm(response - truth, 2, axis=(1, 2))


@pytest.mark.parametrize("name", CASES)
def test_the_region_covers_the_truth_at_least_as_often_as_it_says(name):
    """In the Frobenius norm as often; the largest singular value of a 2 x 2 matrix is less.

    Bias is below the noise, and the variance that of the errors.
    """
    make, lowest, highest, hours, sigma = CASES[name]
    loop = make()
    excitation = multisine(loop, lowest, highest, 1.0, hours, lines=12)
    settled = answer(loop, excitation.signals)
    noise = noise_of(excitation, sigma, 1, SEEDS)
    noisy = settled + answer(loop, 0 * noise, noise)
    bias, *measured = [estimate(loop, excitation, y) for y in [settled, *noisy]]
    truth = loop.frequency_response(excitation.omega)
    errors = np.array([one.response - truth for one in measured])
    power = np.mean(np.linalg.norm(errors, axis=(2, 3)) ** 2, axis=0)
    assert np.all(np.linalg.norm(bias.response - truth, axis=(1, 2)) < np.sqrt(power) / 3)
    for kind in ("noise", "error"):
        estimated = np.mean([getattr(one, kind) ** 2 for one in measured], axis=0)
        assert estimated.sum() / power.sum() == pytest.approx(1, abs=0.15)
    # the noise of the furnace falls by 4 between two lines, which a straight line does not
    assert 0.5 < np.min(estimated / power) < np.max(estimated / power) < 2
    radii = [one.radius(0.9) for one in measured]
    for norm, least, most in ((2, 0.89, 1), ("fro", 0.87, 0.93)):
        covered = np.linalg.norm(errors, norm, axis=(2, 3)) <= radii
        assert least <= covered.mean() <= most
        assert covered.sum(axis=0).min() >= binom.ppf(5e-4, SEEDS, 0.9)


def lags(u):
    """Four first-order lags, two inputs to two outputs, (experiment, time, channel)."""
    y = np.zeros_like(u)
    for (i, j), a in np.ndenumerate([[0.97, 0.99], [0.985, 0.96]]):
        gain = [[1, 0.4], [0.3, 0.8]][i][j]
        y[..., i] += lfilter([0, gain * (1 - a)], [1, -a], u[..., j])
    return y


def resonance(u):
    return lfilter([0, 0.07], [1, -1.94 * np.cos(0.3), 0.97**2], u, axis=1)


@pytest.mark.parametrize(
    ("plant", "outputs", "bent", "hours"),
    [(lags, ["y1", "y2"], 0.1, 1.4), (resonance, ["y"], 1.0, 0.72)],
)
def test_the_radius_holds_what_is_not_linear(plant, outputs, bent, hours):
    """Behind w + c w^3; the truth is the mean over the draws of phases, without noise."""
    loop, rng = ClosedLoop(Ts=1.0, outputs=outputs), np.random.default_rng(1)

    def measured(excitation, noise):
        w = excitation.signals
        y = plant(w + bent * w**3) + noise * rng.standard_normal(w.shape)
        return estimate(loop, excitation, y)

    plans = [
        multisine(loop, 0.015, 1.0, 0.5, hours, 40, realisations=2, seed=seed) for seed in range(16)
    ]
    truth = np.mean([measured(plan, 0.0).response for plan in plans], axis=0)
    found = [measured(plan, 0.003) for plan in plans]
    outside = np.array([off(P.response, truth) > P.radius() for P in found])
    # lines of a draw are alike: as if there were five independent ones in each
    assert outside.mean() <= binom.ppf(0.999, 5 * len(plans), 0.05) / (5 * len(plans))
    most = outside.sum(axis=0).max()  # at the resonance, too, where what is not linear is larger
    assert most <= binom.ppf(1 - 1e-4, len(plans), 0.05)
    jointly = [np.all(off(P.response, truth) <= P.radius(0.99, jointly=True)) for P in found]
    assert np.sum(jointly) >= binom.ppf(0.001, len(plans), 0.99)
    assert bent < 0.3 or all(np.median(P.distortion / P.noise) > 0.5 for P in found)


def test_the_rig_is_measured(loop, short):
    """Against the rod's own equation: neither rig nor truth knows the model of the design."""
    rig = RestartingRig(parameters=RigParameters(lag=0.0))
    measured = measured_response(shake(rig, loop, short))
    assert not measured.findings
    omega = np.geomspace(0.02, 0.5, 200)  # between the lines, too
    G = sampled_response(MISMATCHED, omega, 1.0)[:, :, [0, 2]]
    response, radius = measured.on(omega, 0.999)
    assert np.all(off(response, loop.frequency_response(omega, G)) < radius)
    assert measured.lines.omega.size == len(short.harmonics)
    measured.plot().canvas.draw()  # noise and distortion, too


def test_shaking_is_logged_and_gone_on_with(loop, short, tmp_path):
    path = tmp_path / "shaken.csv"
    with pytest.raises(RigError, match="trial 2"):
        shake(Failing(1500, [np.nan, 0.0]), loop, short, path=path)
    with pytest.raises(LogError, match=r"experiments \[1\] of 4"):
        measured_response(load_log(path))
    with pytest.raises(ValueError, match="another experiment"):
        shake(Failing(), loop, replace(short, amplitude=(1.0, 1.0)), path=path)
    shake(Failing(), loop, short, path=path)
    log = load_log(path)
    assert excitation_of(log) == short and loop_note(loop_of(log)) == loop_note(loop)
    np.testing.assert_array_equal(log.v, short.signals)
    np.testing.assert_array_equal(log.y, shake(Failing(), loop, short).y)


def test_a_drift_is_within_the_radius_of_the_lines_and_said(loop, quick):
    """Of some five standard deviations."""
    y = answer(loop, quick.signals, noise_of(quick, 0.02, 4)[0])
    ramp = [0.0, 3e-5] * np.arange(quick.samples)[:, None]
    drifting, still = (estimate(loop, quick, y + x) for x in (ramp, 0.0))
    moved = off(drifting.response, still.response)
    assert np.all(moved < drifting.radius()) and drifting.radius()[0] > 2 * still.radius()[0]
    assert drifting.distortion[0] > 5 * drifting.noise[0] and still.distortion.min() == 0


@pytest.mark.parametrize("lines", [40, 200])
def test_between_lines_that_are_far_apart_a_delay_is_known(lines):
    """Its phase turns by two radians between 40 lines. Experiments follow without a pause, so that
    what is on its way from one to the next may be anything.
    """
    sizes = {"outlet": 10.0, "valve": 5.0}
    loop = current_trial_loop(furnace(20, Ts=30.0), sizes=sizes)
    plan = multisine(loop, 5e-4, 0.08, 5.0, 43.0, lines=lines)
    log = log_of(loop, plan, answer(loop, plan.signals, noise_of(plan, 1e-3, 3)[0]))
    grid = np.geomspace(1e-4, 0.07, 500)
    response, radius = measured_response(log).on(grid, 0.999)
    assert np.all(off(response, loop.frequency_response(grid)) < radius)
    assert np.median(radius) < 3e-4


def test_wrong_records_are_refused(loop, quick):
    w = quick.signals
    y = answer(loop, w, noise_of(quick, 0.02, 5)[0])
    gap, broken = y.copy(), w.copy()
    gap[0, -100], broken[1, -300:] = np.nan, 0
    log = log_of(loop, quick, y)
    without = log.drop_attrs().assign_attrs(Ts=1.0, excitation=log.excitation)
    for wrong, message in (
        (log_of(loop, quick, gap), "log.y"),
        (log_of(loop, quick, y, broken), "w is not the excitation"),
        (without, "not a log of shake"),
    ):
        with pytest.raises(ValueError, match=message):
            measured_response(wrong)
    one = multisine(ClosedLoop(Ts=1.0, outputs=["y1"]), 0.02, 0.5, 2.0, 1.0)
    with pytest.raises(ValueError, match="loop has 2 learned inputs, but excitation has 1"):
        shake(Failing(), loop, one)


def test_between_the_lines_and_in_other_units(loop, quick):
    y = answer(loop, quick.signals, noise_of(quick, 0.02, 6)[0])
    measured = measured_response(log_of(loop, quick, y))
    response, radius = measured.on(measured.omega, 0.9)
    np.testing.assert_allclose(response, measured.response)
    np.testing.assert_allclose(radius, measured.radius(0.9, jointly=True))
    dense = np.geomspace(1e-4, np.pi, 300)
    response, radius = measured.on(dense, 0.99)
    assert np.all(off(response, loop.frequency_response(dense)) <= radius)
    start, bound = measured.lines.on([1e-9], 0.99)  # the loop's observer integrates
    np.testing.assert_allclose(start[0], np.eye(2), atol=1e-6)
    assert bound[0] < 1e-3
    with pytest.raises(ValueError, match="confidence = 1"):
        measured.radius(1)
    scale = np.array([0.1, 30.0])
    of_P = scale / scale[:, None]
    response, radius = measured.on(dense, 0.9, scale)
    np.testing.assert_allclose(response, measured.on(dense, 0.9)[0] * of_P)
    truth = loop.frequency_response(dense) * of_P
    assert np.all(off(response, truth) <= radius)
