"""A response from records as they come: against plants that are known, and what is refused."""

import sys
import warnings
from pathlib import Path

import control
import numpy as np
import pytest
from plants import furnace, stage, tanks
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
from rodlib.ilc.measurement.estimation import (
    EstimatedResponse,
    _seen,
    estimated_response,
)
from rodlib.ilc.models import frequency_response
from rodlib.ilc.workbench.plant import Plant

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from regions import KINDS, response, several, single


def off(found, truth):
    return np.linalg.norm(found.response - truth, 2, axis=(1, 2))


@pytest.mark.parametrize("kind", ["steps, short", "learning", "steps, wrong start"])
def test_the_truth_is_within_the_region(kind):
    """A few; `make regions` counts 500 of each kind."""
    held = []
    for seed in range(6):
        log, plants = KINDS[kind](np.random.default_rng([seed, 99]))
        found = measured_response(log)
        held.append(
            off(found, response(plants, found.omega))
            <= found.radius(0.99, jointly=True)
        )
    assert np.sum(np.all(held, axis=1)) >= 5


def learned(loop, trials=4, samples=300, noise=1e-3, repeats=0.0, seed=0):
    """Trials under learning from noise in the sensors, and a reference with all frequencies."""
    rng, m = np.random.default_rng(seed), len(loop.outputs)
    c = np.zeros((m, m, 8))
    c[:, :, 4] = 0.3 * np.eye(m)
    L, Q = LearningFilter(c, loop.Ts), zero_phase_butterworth(2, 0.5 / loop.Ts, loop.Ts)
    r = np.repeat(rng.standard_normal((samples // 4, m)), 4, axis=0) * 0.3
    offset = repeats * np.cumsum(rng.standard_normal((samples, m)), axis=0)
    noise = noise * rng.standard_normal((trials, samples, m)) + offset
    with warnings.catch_warnings(action="ignore"):  # not all of them converge
        return run_trials(loop, Law(Q, L), r, None, trials, noise=noise)


LOOPS = {
    "stage": lambda: current_trial_loop(stage(), ["F"], {"x": 1.0, "F": 3.0}),
    "tanks": lambda: current_trial_loop(tanks(), ["pump A", "pump B", "pump C"]),
    "furnace": lambda: current_trial_loop(furnace(30)),
    "not ours": lambda: ClosedLoop(
        control.tf([0.2, 0.1], [1, -1.2, 0.5], 0.1, outputs=["y"])
    ),
}


@pytest.mark.parametrize("name", LOOPS)
def test_trials_under_learning_tell_P(name, tmp_path):
    """Also from a file, and without what repeats in all trials."""
    loop = LOOPS[name]()
    log = learned(loop, repeats=0.0 if name != "not ours" else 1.0)
    save_log(log, tmp_path / "log.csv")
    found = measured_response(load_log(tmp_path / "log.csv"))
    truth = loop.frequency_response(found.omega)
    assert isinstance(found, EstimatedResponse) and found.loop.outputs == loop.outputs
    within = off(found, truth) <= found.radius(0.99, jointly=True)
    assert within.all() and found.known.mean() > 0.5
    assert (
        np.median(found.radius()[found.known])
        < 0.2 * np.linalg.norm(truth, 2, (1, 2)).max()
    )


def test_a_filter_is_designed_for_it_and_keeps_its_promise():
    plant = control.tf([0.1], [1, -0.9], 1.0)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(100), 4)
    y = control.forced_response(plant, U=u).outputs + 0.01 * rng.standard_normal(400)
    found = measured_response(single(u, y))
    assert "one trial of 400 samples, from u to y" in repr(found)
    omega, Q = np.geomspace(1e-2, np.pi, 80), zero_phase_butterworth(2, 0.1)
    design = synthesise(found, Q, omega, M_max=0.9, L_max=20.0, band=(0.01, 0.1))
    assert design.check(plant).gamma <= 0.9
    assert any(
        "assumed: the plant is linear" in line
        for line in design.certificate.assumptions
    )
    assert try_out(Settings.of(Plant("", found))).text


def test_what_had_no_power_is_said_not_to_be_known():
    """An input that moves slowly says nothing of high frequencies, where noise is."""
    rng, N = np.random.default_rng(0), 300
    u = np.sin(2 * np.pi * np.arange(N) / 100) + np.sin(2 * np.pi * np.arange(N) / 33)
    plant = control.tf([0.3], [1, -0.7], 1.0)
    y = control.forced_response(plant, U=u).outputs + 0.05 * rng.standard_normal(N)
    found = measured_response(single(u, y))
    unknown = ~found.known
    assert unknown[found.omega > 2].all() and not unknown.all()
    size = np.linalg.norm(found.response, 2, axis=(1, 2))
    assert np.all(found.radius()[unknown] > size[unknown])
    assert "too little power" in repr(found)
    truth = frequency_response(control.ss(plant), found.omega)
    assert np.all(off(found, truth) <= found.radius(0.99))


def test_trials_that_start_apart_are_told_of():
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


def test_what_lines_tell_by_themselves():
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
    found = estimated_response(several(low[..., None], y[..., None]))
    assert not found.known[np.abs(found.omega - 2.5) < 0.2].any() and found.known.any()


def test_what_rests_on_the_prior_alone_does_not_count_as_known():
    log, _ = KINDS["a reference moves"](np.random.default_rng([0, 17]))
    found = estimated_response(log)
    assert found.alone[found.known].max() < 0.25 < found.alone.max()


def test_what_rings_on_beyond_the_record_is_refused():
    rng = np.random.default_rng(3)
    pole = np.exp(0.3 * (-0.04 + 1j))  # falls by e in 83 of 100 samples
    a = np.poly([pole, pole.conj()]).real
    u = np.repeat(rng.standard_normal(34), 3)[:100]
    y = lfilter([0, a.sum()], a, u) + 0.03 * rng.standard_normal(100)
    with pytest.raises(LogError, match="rings on"):
        measured_response(single(u, y))


def test_what_tells_nothing_is_refused_in_words():
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
