"""What noise does, against trials simulated one after the other, closed forms and other solvers."""

from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import stage, tanks
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import welch

from rodlib import (
    Law,
    LearningFilter,
    converged_noise,
    current_trial_loop,
    noise_on_trial,
    paper_loop,
    run_trials,
    synthesise,
    trial_noise,
    zero_phase_butterworth,
)
from rodlib.ilc import trial_operators
from rodlib.ilc.alternatives import p_type
from rodlib.ilc.evidence.noise import Spectrum, TrialNoise
from rodlib.ilc.loop.closed import with_noise
from rodlib.ilc.models import impulse_response
from rodlib.ilc.trials.run import rms

pytestmark = pytest.mark.filterwarnings("ignore:the error grows")  # after an impulse


@cache
def case(name):
    """A loop of one, two or three channels with a law, and a grid."""
    if name == "rod":
        loop, cutoff, band = paper_loop(), 0.1, (4e-4, 0.02)
    elif name == "stage":
        loop = current_trial_loop(stage(), ["F"], {"x": 5.0, "F": 20.0})
        cutoff, band = 300.0, (7.0, 100.0)
    else:
        loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
        cutoff, band = 0.3, (1e-3, 0.1)
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    omega = np.geomspace(1e-4, 1, 500) * np.pi / loop.Ts
    L = synthesise(loop, Q, omega, loop.Ts, structure="full", band=band).filter
    return loop, Law(Q, L), omega


def other_tanks(loop):
    plant = loop.plant
    return control.ss(0.97 * plant.A, plant.B, plant.C, 0, loop.Ts,
                      inputs=plant.input_labels, outputs=plant.output_labels)  # fmt: skip


def after_one(loop, law, trials, samples, noise=None, disturbance=None, plant=None):
    """True and measured error of trials of which the first is disturbed, (kind, trial, time, m)."""
    m, d = len(loop.outputs), len(loop.disturbances)
    n, flows = np.zeros((trials, samples, m)), np.zeros((trials, samples, d))
    n[0] += 0 if noise is None else noise
    flows[0] += 0 if disturbance is None else disturbance
    still = np.zeros((samples, m))
    e = run_trials(loop, law, still, flows, trials, noise=n, plant=plant).e.values
    return np.stack([e + n, e])


@pytest.mark.parametrize(
    ("name", "at", "samples", "trials"),
    [("rod", 600, 1800, 40), ("stage", 300, 600, 60), ("tanks", 400, 900, 60)],
)
def test_a_single_impulse_through_the_trials_has_the_predicted_rms(
    name, at, samples, trials
):
    """For white noise the variance is the sum of squares of what one impulse does, ever after.

    It is in the middle of the first trial, so that the ends of a trial do not matter. Of the
    coloured disturbance it is one impulse behind the colouring filter, in all sources at once.
    """
    loop, law, omega = case(name)
    m, d, pole = len(loop.outputs), len(loop.disturbances), 0.9
    white = 0
    for channel in range(m):
        impulse = np.zeros((samples, m))
        impulse[at, channel] = 1
        white = white + after_one(loop, law, trials, samples, noise=impulse) ** 2
    predicted = converged_noise(trial_noise(loop, omega, 1.0), law)
    found = [predicted.true.rms, predicted.measured.rms]
    np.testing.assert_allclose(found, np.sqrt(white.sum(axis=(1, 2))), rtol=2e-3)
    shares, tail = np.arange(1, d + 1.0), np.zeros(samples)
    tail[at:] = pole ** np.arange(samples - at)
    flows = after_one(loop, law, trials, samples, disturbance=np.outer(tail, shares))
    colour = 1 / np.abs(1 - pole * np.exp(-1j * omega * loop.Ts)) ** 2
    psd = colour[:, None, None] * np.outer(shares, shares)
    predicted = converged_noise(trial_noise(loop, omega, disturbance_psd=psd), law)
    found = [predicted.true.rms, predicted.measured.rms]
    np.testing.assert_allclose(found, np.sqrt((flows**2).sum(axis=(1, 2))), rtol=2e-3)


def test_without_learning_around_another_plant():
    loop, law, omega = case("tanks")
    other, impulse = other_tanks(loop), np.zeros((900, 3))
    impulse[0, 1] = 1
    errors = after_one(loop, replace(law, L=None), 1, 900, impulse, plant=other)[:, 0]
    new = trial_noise(loop, omega, [0.0, 1.0, 0.0], plant=other)
    expected = np.sqrt((errors**2).sum(axis=1))
    np.testing.assert_allclose([new.true.rms, new.measured.rms], expected, rtol=2e-3)
    np.testing.assert_allclose(new.P, loop.frequency_response(omega, other), atol=1e-9)
    assert np.abs(new.P - loop.frequency_response(omega)).max() > 0.01
    assert new.learned.total == 0


@given(st.integers(1, 4), st.integers(0, 9999), st.floats(0.01, 1))
def test_what_is_learned_solves_the_lyapunov_equation(m, seed, gain):
    rng = np.random.default_rng(seed)
    omega, Q = np.linspace(0.05, 3, 6), zero_phase_butterworth(1, 1.0)
    L = LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    random = rng.standard_normal((3, 6, m, m)) + 1j * rng.standard_normal((3, 6, m, m))
    change = 0.95 * random[0] / np.linalg.norm(random[0], 2, axis=(1, 2))[:, None, None]
    P = (np.eye(m) - change) @ np.linalg.inv(L.frequency_response(omega))
    measured, true = (
        Spectrum(omega, 1.0, x @ x.conj().swapaxes(1, 2)) for x in random[1:]
    )
    new = TrialNoise(P, measured, true, replace(true, density=0 * P))
    found = converged_noise(new, Law(Q, L, gain=gain))
    for i, q in enumerate(Q.frequency_response(omega)):
        PL = P[i] @ L.frequency_response(omega)[i]
        M = (1 - gain) * np.eye(m) + gain * q * (np.eye(m) - PL)
        added = (gain * q) ** 2 * PL @ measured.density[i] @ PL.conj().T
        expected = solve_discrete_lyapunov(M, added)
        limit = {"rtol": 0, "atol": 1e-8 * np.abs(expected).max()}
        np.testing.assert_allclose(found.learned.density[i], expected, **limit)
        total = expected + true.density[i]
        np.testing.assert_allclose(found.true.density[i], total, **limit)
        total = expected + measured.density[i]
        np.testing.assert_allclose(found.measured.density[i], total, **limit)


def test_a_densitys_forms():
    loop, _, omega = case("tanks")
    matrices = np.broadcast_to(4 * np.eye(3), (500, 3, 3))
    first = trial_noise(loop, omega, 4.0).measured.density
    for form in (np.full(3, 4.0), np.full(500, 4.0), np.full((500, 3), 4.0), matrices):
        other = trial_noise(loop, omega, form).measured.density
        np.testing.assert_array_equal(other, first)
    one = trial_noise(loop, omega, [0.0, 1.0, 0.0])
    two = trial_noise(loop, omega, disturbance_psd=[2.0])
    both = trial_noise(loop, omega, [0.0, 1.0, 0.0], [2.0])
    np.testing.assert_allclose((one.true + two.true).density, both.true.density)
    np.testing.assert_array_equal(two.true.density, two.measured.density)


def test_units_of_a_density():
    """The RMS is the root of the variance; one in unit^2 / Hz is 2 Ts times as large."""
    Ts, omega = 0.02, np.geomspace(1e-3, np.pi / 0.02, 2000)
    density = np.tile(np.diag([9.0, 36.0]), (2000, 1, 1))
    both = Spectrum(omega, Ts, density)
    np.testing.assert_allclose(both.rms, [3, 6], rtol=1e-9)
    assert both.total == pytest.approx(np.sqrt(45))
    signal = 3 * np.random.default_rng(0).standard_normal(100_000)
    _, one_sided = welch(signal, 1 / Ts, nperseg=128)
    np.testing.assert_allclose(one_sided[1:-1], 2 * Ts * 9, rtol=0.2)


@pytest.mark.parametrize(
    "psd",
    [
        -1.0,
        [1.0, -1.0, 0.0],
        np.ones(2),
        np.full((500, 3, 3), np.triu(np.ones((3, 3)))),
        np.full((500, 3, 3), 1 - np.eye(3)),
        1j,
        np.nan,
    ],
    ids=str,
)
def test_what_is_no_density_is_refused(psd):
    loop, _, omega = case("tanks")
    with pytest.raises(ValueError, match="noise_psd"):
        trial_noise(loop, omega, psd)


def test_what_does_not_fit_trials_without_ends_is_refused():
    loop, law, omega = case("tanks")
    new, Q, L = trial_noise(loop, omega, 1.0), law.Q, law.L
    without = current_trial_loop(tanks()[:, ["pump A", "pump B", "pump C"]])
    with pytest.raises(ValueError, match="disturbance_psd"):
        trial_noise(without, omega, 1.0, 1.0)
    with pytest.raises(ValueError, match="does not converge"):
        converged_noise(new, Law(Q, replace(L, coefficients=-0.01 * L.coefficients)))
    with pytest.raises(ValueError, match="Ts"):
        converged_noise(new, Law(replace(Q, Ts=1.0), replace(L, Ts=1.0)))
    with pytest.raises(ValueError, match="L acts on 1 channels"):
        converged_noise(new, Law(Q, LearningFilter([[[1.0]]], 2.0)))


VARIANCE = {"stage": [4.0], "tanks": [1.0, 4.0, 9.0]}


def by_impulses(loop, law, samples, variance, trials, plant=None):
    """Variances of true and measured outputs in the last trial, from one impulse after another.

    What one in the first trial leaves k trials later is what one k trials before the last leaves
    in the last: the law is the same from each trial to the next.
    """
    m, power = len(variance), 0
    for p, channel in np.ndindex(samples, m):
        noise = np.zeros((samples, m))
        noise[p, channel] = np.sqrt(variance[channel])
        errors = after_one(loop, law, trials, samples, noise, plant=plant)
        power = power + np.sum(errors**2, axis=1)
    return power


@pytest.mark.parametrize("name", VARIANCE)
@pytest.mark.parametrize(
    ("trials", "rest", "gain", "ends"),
    [(1, 0, 1.0, "zero"), (4, 0, 1.0, "hold"), (3, 7, 0.6, "zero")],
)
def test_each_impulse_of_noise_run_through_the_trials(name, trials, rest, gain, ends):
    """Whatever the law does at the ends, to rounding."""
    loop, law, _ = case(name)
    Q, L = replace(law.Q, ends=ends), replace(law.L, ends=ends)
    law, variance = Law(Q, L, rest, gain), VARIANCE[name]
    expected = by_impulses(loop, law, 30, variance, trials)
    found = noise_on_trial(loop, law, 30, variance, trials=trials)
    limit = 1e-9 * expected.max()
    np.testing.assert_allclose(found.true**2, expected[0], rtol=1e-9, atol=limit)
    np.testing.assert_allclose(found.measured**2, expected[1], rtol=1e-9)
    assert rms(found.true) == pytest.approx(np.sqrt(expected[0].sum() / 30), rel=1e-9)
    first = noise_on_trial(loop, law, 30, variance, trials=1)
    learned = found.true**2 - first.true**2
    np.testing.assert_allclose(found.learned**2, learned, atol=1e-12 * expected.max())


def test_around_another_plant_and_with_another_learning_operator():
    loop, law, _ = case("tanks")
    law, other = replace(law, L=p_type(0.5, 2, 3, loop.Ts)), other_tanks(loop)
    expected = by_impulses(loop, law, 25, [1.0] * 3, trials=3, plant=other)
    found = noise_on_trial(loop, law, 25, 1.0, trials=3, plant=other)
    np.testing.assert_allclose(found.measured**2, expected[1], rtol=1e-9)
    assert list(found.output) == loop.outputs and found.time[1] == loop.Ts


def dense(loop, law, samples, sigma):
    """Converged variances (true, measured) by the book: matrices of the whole trial."""
    m, I = len(loop.outputs), np.eye(samples * len(loop.outputs))  # noqa: E741
    P, Q, L = (X @ I for X in trial_operators(loop.P, law.Q, law.L, samples))
    h = impulse_response(with_noise(loop)[:, -m:], samples)
    T = np.zeros((samples, m, samples, m))
    for p in range(samples):
        T[p:, :, p] = h[: samples - p]
    T = sigma * T.reshape(P.shape)
    M, B = Q @ (I - L @ P), Q @ L @ (sigma * I + T)
    V = B @ B.T
    for _ in range(30):
        V, M = V + M @ V @ M.T, M @ M
    learned = ((P @ V) * P).sum(axis=1)
    power = [(X**2).sum(axis=1) + learned for X in (T, sigma * I + T)]
    return np.reshape(power, (2, samples, m))


def test_cut_short_in_the_middle_it_is_that_of_the_whole_trial():
    loop, law, omega = case("stage")
    samples = 900
    found = noise_on_trial(loop, law, samples, 0.25)
    true, measured = dense(loop, law, samples, 0.5)
    np.testing.assert_allclose(found.true**2, true, rtol=1e-2, atol=1e-3 * true.max())
    np.testing.assert_allclose(found.measured**2, measured, rtol=1e-2)
    for predicted, expected in [(found.true, true), (found.measured, measured)]:
        size = np.sqrt(expected.sum() / samples)
        assert rms(predicted) == pytest.approx(size, rel=1e-3)
    flat = found.learned[samples // 2]
    assert (found.learned == flat).all("channel").sum() > samples / 4  # it was cut
    endless = converged_noise(trial_noise(loop, omega, 0.25), law)
    np.testing.assert_allclose(found.true[samples // 2], endless.true.rms, rtol=5e-3)
    np.testing.assert_allclose(flat, endless.learned.rms, rtol=5e-3)


def test_the_papers_loop_by_seeds():
    """What the rod does in 25 trials after the fifteenth, within four standard errors (1 to 4 %).

    The formula without ends says 6.3 mK.
    """
    loop, Q = paper_loop(), zero_phase_butterworth()
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 1000), L_max=400)
    found = noise_on_trial(loop, design.law(), 2500, 0.02**2)
    noise = 0.02 * np.random.default_rng(3).standard_normal((40, 2500, 2))
    run = run_trials(loop, design.law(), np.zeros((2500, 2)), None, 40, noise=noise)
    y = (run.e + noise)[15:]
    parts = [(slice(None), 9.1), (slice(100), 23.9), (slice(2400, None), None)]
    for part, expected in parts:
        seen = rms(y.isel(time=part)) ** 2
        predicted = float(rms(found.true.isel(time=part)) ** 2)
        # a converged trial remembers about as many trials as the slowest rate says, ten
        error = float(seen.std() / np.sqrt(len(seen) / 4))
        assert abs(float(seen.mean()) - predicted) < 4 * error
        if expected:
            assert 1e3 * np.sqrt(predicted) == pytest.approx(expected, abs=0.06)


def test_what_does_not_fit_a_trial_is_refused():
    loop, law, _ = case("stage")
    for variance in (-1.0, [1.0, 1.0]):
        with pytest.raises(ValueError, match="noise_variance"):
            noise_on_trial(loop, law, 30, variance)
    with pytest.raises(ValueError, match="does not converge on a trial"):
        negative = replace(law.L, coefficients=-law.L.coefficients)
        noise_on_trial(loop, replace(law, L=negative), 300, 1.0)
    with pytest.raises(ValueError, match=r"law\.L"):
        noise_on_trial(loop, replace(law, L=None), 30, 1.0)
    with pytest.raises(ValueError, match="Ts"):
        noise_on_trial(loop, case("tanks")[1], 30, 1.0)
