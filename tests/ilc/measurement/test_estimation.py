"""A response from records as they come: against plants that are known, and what is refused."""

import sys
import warnings
from pathlib import Path

import control
import numpy as np
import pytest
from plants import PUMPS, tanks
from scipy.signal import butter, lfilter

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    Settings,
    current_trial_loop,
    load_log,
    measured_response,
    run_trials,
    save_log,
    synthesise,
    try_out,
    zero_phase_butterworth,
)
from rodlib.ilc.loop.notes import LogError
from rodlib.ilc.measurement.estimation import _seen, estimated_response
from rodlib.ilc.models import frequency_response
from rodlib.ilc.workbench.plant import Plant

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from regions import KINDS, response, several, single


def off(estimate, truth):
    return np.linalg.norm(estimate.response - truth, 2, axis=(1, 2))


@pytest.mark.parametrize("kind", ["steps, short", "learning", "steps, wrong start"])
def test_the_truth_is_within_the_region(kind):
    """A few; `make regions` counts 500 of each kind."""
    count = 0
    for seed in range(4):
        log, plants = KINDS[kind](np.random.default_rng([seed, 99]))
        estimate = measured_response(log)
        error = off(estimate, response(plants, estimate.omega))
        count += np.all(error <= estimate.radius(0.99, jointly=True))
    assert count >= 3


LOOPS = {
    "tanks": lambda: current_trial_loop(tanks(), PUMPS),
    "not ours": lambda: ClosedLoop(
        control.tf([0.2, 0.1], [1, -1.2, 0.5], 0.1, outputs=["y"])
    ),
}


@pytest.mark.parametrize("name", LOOPS)
def test_trials_under_learning_give_P(name, tmp_path):
    """From noise in the sensors and a rich reference; also without what repeats in all trials."""
    loop, trials, samples = LOOPS[name](), 4, 240
    rng, m = np.random.default_rng(0), len(loop.outputs)
    L = LearningFilter(np.eye(m)[..., None] * [0, 0, 0, 0, 0.3], loop.Ts)
    r = np.repeat(rng.standard_normal((samples // 4, m)), 4, axis=0) * 0.3
    noise = 1e-3 * rng.standard_normal((trials, samples, m))
    if name == "not ours":
        noise += np.cumsum(rng.standard_normal((samples, m)), axis=0)
    law = Law(zero_phase_butterworth(2, 0.5 / loop.Ts, loop.Ts), L)
    with warnings.catch_warnings(action="ignore"):  # not all of them converge
        save_log(run_trials(loop, law, r, None, trials, noise=noise), tmp_path / "log")
    estimate = measured_response(load_log(tmp_path / "log"))
    truth = loop.frequency_response(estimate.omega)
    assert estimate.loop.outputs == loop.outputs
    assert np.all(off(estimate, truth) <= estimate.radius(0.99, jointly=True))
    assert estimate.known.mean() > 0.5
    size = np.linalg.norm(truth, 2, (1, 2)).max()
    assert np.median(estimate.radius()[estimate.known]) < 0.2 * size


def test_a_filter_is_designed_for_it_and_keeps_its_promise():
    plant = control.tf([0.1], [1, -0.9], 1.0)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(100), 4)
    y = control.forced_response(plant, U=u).outputs + 0.01 * rng.standard_normal(400)
    estimate = measured_response(single(u, y))
    omega, Q = np.geomspace(1e-2, np.pi, 80), zero_phase_butterworth(2, 0.1)
    design = synthesise(estimate, Q, omega, order=10, L_max=20.0, band=(0.01, 0.1))
    assert design.check(plant).gamma <= 0.9
    assumptions = "".join(design.certificate.assumptions)
    assert "the plant is linear" in assumptions
    assert try_out(Settings.of(Plant("", estimate))).text


def test_frequencies_without_power_are_not_identified():
    """An input that moves slowly says nothing of high frequencies, where noise is."""
    rng, N = np.random.default_rng(0), 300
    u = np.sin(2 * np.pi * np.arange(N) / 100) + np.sin(2 * np.pi * np.arange(N) / 33)
    plant = control.tf([0.3], [1, -0.7], 1.0)
    y = control.forced_response(plant, U=u).outputs + 0.05 * rng.standard_normal(N)
    estimate = measured_response(single(u, y))
    unknown = ~estimate.known
    assert unknown[estimate.omega > 2].all() and not unknown.all()
    size = np.linalg.norm(estimate.response, 2, axis=(1, 2))
    assert np.all(estimate.radius()[unknown] > size[unknown])
    assert "too little power" in repr(estimate)
    truth = frequency_response(control.ss(plant), estimate.omega)
    assert np.all(off(estimate, truth) <= estimate.radius(0.99))


def test_trials_that_start_apart_are_reported():
    """The region assumes that they do not; that ordinary ones are no news, other tests hold."""
    rng, plant = np.random.default_rng(0), control.ss(control.tf([0.1], [1, -0.9], 1.0))
    u = rng.standard_normal((6, 200))
    y = [
        control.forced_response(plant, U=row, X0=3 * k).outputs
        for k, row in enumerate(u)
    ]
    y = np.array(y) + 0.01 * rng.standard_normal((6, 200))
    with pytest.warns(UserWarning, match=r"start from different states \(y0\)"):
        measured_response(several(u[..., None], y[..., None]))


def test_each_line_by_itself():
    """White noise of 0.1 under a white input of one is off by 0.1 / sqrt(lines) at each."""
    rng, angles = np.random.default_rng(0), np.linspace(0.3, 3, 40)
    u, noise = rng.standard_normal((2, 100, 200, 1))
    alone, agrees = _seen(u, 0.1 * noise, angles, np.full(40, 1e-3))
    np.testing.assert_allclose(
        alone, 0.01, rtol=0.5
    )  # a hundred trials, a line of each
    assert agrees.all()
    echo = 0.3 * np.roll(u, 2, axis=1)  # what an estimate has missed
    assert not _seen(u, 0.1 * noise + echo, angles, np.full(40, 1e-3))[1].any()
    assert _seen(u, 0.1 * noise + echo, angles, np.full(40, 0.3))[1].all()  # it said so


def test_a_resonance_that_was_hardly_excited_does_not_count_as_known():
    """Learned up to a quarter of the Nyquist frequency, with one at four fifths of it."""
    rng, lag, N = np.random.default_rng(0), np.exp(-0.05), 400
    pole = np.exp(2.5 * (-0.02 + 1j))
    ring, slow = np.poly([pole, pole.conj()]).real, ([0, 1 - lag], [1, -lag])
    low = lfilter(*butter(4, 0.25), rng.standard_normal((20, N)), axis=1)
    y = (
        lfilter(*slow, low)
        + lfilter([0, 0.05], ring, low)
        + 0.03 * rng.standard_normal((20, N))
    )
    estimate = estimated_response(several(low[..., None], y[..., None]))
    assert (
        not estimate.known[np.abs(estimate.omega - 2.5) < 0.2].any()
        and estimate.known.any()
    )


def test_what_rings_on_beyond_the_record_is_refused():
    rng = np.random.default_rng(3)
    pole = np.exp(0.3 * (-0.04 + 1j))  # falls by e in 83 of 100 samples
    a = np.poly([pole, pole.conj()]).real
    u = np.repeat(rng.standard_normal(34), 3)[:100]
    y = lfilter([0, a.sum()], a, u) + 0.03 * rng.standard_normal(100)
    with pytest.raises(LogError, match="rings on"):
        measured_response(single(u, y))


def test_records_without_enough_excitation_are_refused():
    rng, N = np.random.default_rng(0), 120
    u, noise = rng.standard_normal((2, N)), 0.01 * rng.standard_normal((2, N))
    whole = single(u, u + noise)
    integral = np.cumsum(u[:1], axis=1) + noise[:1]
    for log, of, message in (
        (single(u * [[1], [0]], u), None, "u1 never moved"),
        (single(u, u * [[0], [1]]), None, "y0 never moved"),
        (single(u[:, :9], u[:, :9]), None, "9 samples"),
        (single(u[:1], integral), None, "y0 does not settle"),
        (single(u[[0, 0]], u + noise), None, "moved alike"),
        (whole, "w", "reference"),
        (whole.drop_vars("u"), None, "commands u"),
        (whole, "y", "of = 'y'"),
    ):
        with pytest.raises(ValueError, match=message):
            measured_response(log, of)
    with pytest.raises(ValueError, match="uncertainty"):
        measured_response(whole, uncertainty=[0.1])
