"""What noise does, against trials simulated one after the other, closed forms and other solvers."""

from functools import cache

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import stage, tanks
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import fftconvolve, lfilter, welch

from rodlib import (
    Law,
    LearningFilter,
    Rod,
    converged_noise,
    current_trial_loop,
    midr,
    minimal_realisation,
    noise_by_trial,
    paper_loop,
    run_trials,
    synthesise,
    trial_noise,
    zero_phase_butterworth,
)
from rodlib.ilc import Spectrum, TrialNoise
from rodlib.paper import published

BOTH = ("true", "measured")


def stepped(loop, w, n, d):
    """The outputs y of the loop, sample by sample: shape (..., time, channel), all at once.

    n is added to the y that the observer and the feedback (16), (18) see.
    """
    A, C = loop.closed.A.T, loop.closed.C.T
    B, D = loop.closed.B.T, loop.closed.D.T
    inputs = np.concatenate([w, d], axis=-1)
    x, y = np.zeros((*w.shape[:-2], len(A))), inputs @ D
    for p in range(w.shape[-2]):
        y[..., p, :] += x @ C
        x = x @ A + inputs[..., p, :] @ B
        x[..., -len(loop.KL) :] += n[..., p, :] @ loop.KL.T
    return y


def simulate(loop, Q, L, n, d, trials=200, step=1.0):
    """Errors of trials with reference zero, of the true and of the measured outputs.

    n and d have the shape (trial, case, time, channel); trials beyond theirs are without.
    """
    m, samples = n.shape[-1], n.shape[-2]
    zero, pulse = np.zeros((m, samples, m)), np.zeros((m, samples, m))
    pulse[range(m), 0, range(m)] = 1
    response = stepped(
        loop, pulse, zero, np.zeros((m, samples, d.shape[-1]))
    )  # P: (in, time, out)
    new = stepped(loop, np.zeros_like(n), n, d)
    v, errors = np.zeros(n.shape[1:]), []
    for k in range(trials):
        Pv = [
            fftconvolve(v[..., i, None], response[None, i], axes=1)[:, :samples]
            for i in range(m)
        ]
        y = sum(Pv) + (new[k] if k < len(n) else 0)
        measured = y + (n[k] if k < len(n) else 0)
        errors.append((-y, -measured))
        a = np.broadcast_to(step, trials)[k]
        v = Law(Q, L, gain=a).next(v, -measured)
    return np.moveaxis(np.array(errors), 1, 0)


def coloured(rng, shape, pole):
    """Signals of variance one along time, shape (..., time, channel); white for pole 0."""
    *others, samples, m = shape
    white = rng.standard_normal((*others, samples + 100, m))
    return np.sqrt(1 - pole**2) * lfilter([1], [1, -pole], white, axis=-2)[..., 100:, :]


def colour(omega, Ts, pole):
    """Their spectral density."""
    return (1 - pole**2) / np.abs(1 - pole * np.exp(-1j * omega * Ts)) ** 2


@cache
def rod():
    """The paper's loop and grid, and filters: printed, full, hardly learning, robust."""
    loop, Q, omega = (
        paper_loop(),
        zero_phase_butterworth(),
        np.geomspace(1e-4, np.pi, 1000),
    )
    full = synthesise(loop, Q, omega, 1.0, structure="full").filter
    slow = synthesise(
        loop, Q, omega, 1.0, uncertainty=np.full(1000, 0.005), M_max=0.95, L_max=10
    ).filter
    tiny = LearningFilter(0.03 * full.coefficients, 1.0)
    return (
        loop,
        Q,
        omega,
        [LearningFilter(published.matrix("L_diagonal"), 1.0), full, tiny, slow],
    )


@cache
def others(name):
    """A loop of one channel and of three, with a grid and a full filter."""
    if name == "stage":
        loop = current_trial_loop(stage(), ["F"], {"x": 5.0, "F": 20.0})
        cutoff, band = 300.0, (7.0, 100.0)
    else:
        loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
        cutoff, band = 0.3, (1e-3, 0.1)
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    omega = np.geomspace(1e-4, 1, 500) * np.pi / loop.Ts
    design = synthesise(loop, Q, omega, loop.Ts, structure="full", band=band)
    return loop, Q, omega, [design.filter]


# At which sample impulses come, and the length of a trial.
LENGTH = {"rod": (600, 1800), "stage": (300, 600), "tanks": (400, 900)}


def case(name):
    return rod() if name == "rod" else others(name)


def root_sum(errors):
    """By kind (true, measured), case and channel, of the squares over trials and time."""
    return np.sqrt((errors**2).sum(axis=(1, 3)))


@pytest.mark.parametrize("source", ["noise", "disturbance"])
@pytest.mark.parametrize("name", LENGTH)
def test_a_single_impulse_through_200_trials_tells_the_rms(name, source):
    """For white noise the variance is the sum of squares of what one impulse does, ever after.

    For coloured noise, of what one impulse behind the colouring filter does, here in all channels
    at once. It is in the middle of the first trial, so that the ends of a trial do not matter.
    """
    loop, Q, omega, filters = case(name)
    at, samples = LENGTH[name]
    sizes = {"noise": loop.plant.noutputs, "disturbance": len(loop.disturbances)}
    m, pole = sizes[source], 0.9
    shares = np.arange(1, m + 1.0)
    mixed = colour(omega, loop.Ts, pole)[:, None, None] * np.outer(shares, shares)
    tail = np.sqrt(1 - pole**2) * pole ** np.arange(samples - at)
    for L in filters:
        white = name != "rod"
        count = 1 + m * white
        signals = {
            key: np.zeros((1, count, samples, size)) for key, size in sizes.items()
        }
        signals[source][0, 0, at:] = np.outer(tail, shares)
        signals[source][0, range(1, count), at, range(count - 1)] = 1
        errors = simulate(loop, Q, L, signals["noise"], signals["disturbance"])
        power = (errors**2).sum(axis=(1, 3))  # (true and measured, impulse, channel)
        for density, expected in [
            (mixed, power[:, 0]),
            (1.0, power[:, 1:].sum(axis=1)),
        ][: 1 + white]:
            found = converged_noise(trial_noise(loop, omega, **{source: density}), Q, L)
            np.testing.assert_allclose(
                [found.true.rms, found.measured.rms], np.sqrt(expected), rtol=1e-3
            )


@pytest.mark.parametrize(("name", "side_by_side"), [("stage", 10), ("tanks", 5)])
def test_200_trials_with_noise_and_a_disturbance_drawn_at_random(name, side_by_side):
    """Within 2 %, which is three times the standard deviation of what is found, or more."""
    loop, Q, omega, [L] = case(name)
    at, samples = LENGTH[name]
    m, sources = loop.plant.noutputs, len(loop.disturbances)
    for pole in (0.0, 0.9):
        rng = np.random.default_rng(0)
        n = coloured(rng, (200, side_by_side, samples, m), pole)
        d = 4 * coloured(rng, (200, side_by_side, samples, sources), 0.9 - pole)
        errors = simulate(loop, Q, L, n, d)[:, 50:, :, at // 2 : -80]
        found = np.sqrt((errors**2).mean(axis=(1, 2, 3)))
        coming = {"noise": pole, "disturbance": 0.9 - pole}
        density = {key: colour(omega, loop.Ts, value) for key, value in coming.items()}
        density["disturbance"] *= 16
        expected = converged_noise(trial_noise(loop, omega, **density), Q, L)
        np.testing.assert_allclose(
            found, [expected.true.rms, expected.measured.rms], rtol=0.02
        )


def test_the_simulation_here_is_that_of_run_trials(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    rng = np.random.default_rng(1)
    n, d = rng.standard_normal((6, 1, 60, 2)), rng.standard_normal((6, 1, 60, 3))
    step = 1 / np.arange(1, 7)
    true, measured = simulate(loop, Q, L, n, d, 6, step)[:, :, 0]
    run = run_trials(
        loop, Law(Q, L, gain=step[:-1]), np.zeros((60, 2)), d[:, 0], 6, noise=n[:, 0]
    )
    np.testing.assert_allclose(run.e, measured, atol=1e-9)
    np.testing.assert_allclose(run.e + n[:, 0], true, atol=1e-9)


def random_case(m, seed, n=6):
    """Random responses, a random Hermitian density, and a filter for which trials converge."""
    rng = np.random.default_rng(seed)
    omega, Q = np.linspace(0.05, 3, n), zero_phase_butterworth(1, 1.0)
    L = LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    random = rng.standard_normal((3, n, m, m)) + 1j * rng.standard_normal((3, n, m, m))
    change = 0.95 * random[0] / np.linalg.norm(random[0], 2, axis=(1, 2))[:, None, None]
    P = (np.eye(m) - change) @ np.linalg.inv(L.frequency_response(omega))
    measured, true = (x @ x.conj().swapaxes(1, 2) for x in random[1:])
    return known(omega, P, measured, true), Q, L


def responses(new, Q, L):
    """M and Q P L by the book."""
    omega = new.measured.omega
    q, PL = (
        Q.frequency_response(omega)[:, None, None],
        new.P @ L.frequency_response(omega),
    )
    return q * (np.eye(PL.shape[1]) - PL), q * PL


def known(omega, P, measured, true=0.0):
    """What is new in every trial, from numbers or arrays; of the period one."""
    of = [
        np.broadcast_to(density * np.ones((1, 1)), P.shape)
        for density in (measured, true)
    ]
    return TrialNoise(P, *(Spectrum(omega, 1.0, density) for density in of))


sizes = st.integers(1, 4)
seeds = st.integers(0, 9999)
steps = st.floats(0.01, 1)


@given(sizes, seeds, steps)
def test_what_is_learned_solves_the_lyapunov_equation(m, seed, step):
    new, Q, L = random_case(m, seed)
    found = converged_noise(new, Q, L, step)
    for i, (M, QPL) in enumerate(zip(*responses(new, Q, L), strict=True)):
        M, QPL = (1 - step) * np.eye(m) + step * M, step * QPL
        added = QPL @ new.measured.density[i] @ QPL.conj().T
        expected = solve_discrete_lyapunov(M, added)
        limit = 1e-9 * np.abs(expected).max()
        np.testing.assert_allclose(
            found.learned.density[i], expected, rtol=0, atol=limit
        )
        total = expected + new.true.density[i], expected + new.measured.density[i]
        np.testing.assert_allclose(found.true.density[i], total[0], rtol=0, atol=1e-8)
        np.testing.assert_allclose(
            found.measured.density[i], total[1], rtol=0, atol=1e-8
        )


@given(sizes, seeds)
def test_Q_may_be_samples(m, seed):
    new, Q, L = random_case(m, seed)
    q = Q.frequency_response(new.measured.omega)
    found, same = (converged_noise(new, each, L).learned.density for each in (Q, q))
    np.testing.assert_array_equal(found, same)


@given(seeds)
def test_one_channel_has_a_closed_form(seed):
    new, Q, L = random_case(1, seed)
    M, QPL = responses(new, Q, L)
    expected = new.measured.density * (1 + np.abs(QPL) ** 2 / (1 - np.abs(M) ** 2))
    np.testing.assert_allclose(
        converged_noise(new, Q, L).measured.density, expected, rtol=1e-10
    )


@given(sizes, seeds, steps)
def test_trial_by_trial_it_grows_to_where_it_converges(m, seed, step):
    new, Q, L = random_case(m, seed)
    trials = noise_by_trial(new, Q, L, [step] * 20)
    assert trials[0].learned.total == 0
    totals = [each.learned.total for each in trials]
    assert np.all(np.diff(totals) >= -1e-12 * max(totals))
    M, QPL = responses(new, Q, L)
    M, added = (1 - step) * np.eye(m) + step * M, step * QPL
    each = [np.linalg.matrix_power(M, k) @ added for k in range(20)]
    expected = sum(x @ new.measured.density @ x.conj().swapaxes(1, 2) for x in each)
    limit = 1e-10 * np.abs(expected).max()
    np.testing.assert_allclose(trials[-1].learned.density, expected, rtol=0, atol=limit)


def test_steps_that_fall_let_the_noise_of_the_past_fade():
    """With steps 1/k and M = 0, v is the mean over k trials, whose variance falls as 1/k."""
    omega, Q = np.linspace(0.01, 3, 50), zero_phase_butterworth(1, 1.0)
    z = np.exp(1j * omega)[:, None, None]
    new = known(omega, 1 / z, 1.0)
    L = LearningFilter([[[1.0]]], 1.0)
    averaged = noise_by_trial(new, Q, L, 1 / np.arange(1, 200))
    q = Q.frequency_response(omega)[:, None, None]
    for k in (1, 5, 199):
        np.testing.assert_allclose(averaged[k].learned.density, q**2 / k, rtol=1e-10)


@pytest.mark.parametrize("name", ["rod", "stage", "tanks"])
def test_with_falling_steps_the_error_tends_to_that_without_learning(name):
    loop, Q, omega, [L, *_] = case(name)
    new = trial_noise(loop, omega, noise=1.0)
    constant = converged_noise(new, Q, L)
    falling = noise_by_trial(new, Q, L, np.minimum(1, 3 / np.arange(1, 1000)))
    learned = [falling[k].learned.total for k in (9, 99, 999)]
    assert learned[0] < constant.learned.total
    assert learned[1] < learned[0] / 2 and learned[2] < learned[1] / 2
    assert falling[-1].true.total < new.true.total + 0.1 * (
        constant.true.total - new.true.total
    )


def test_falling_steps_simulated():
    """The variance in trial 12 is the sum over what an impulse in each of the trials does there."""
    loop, Q, omega, [L] = case("stage")
    at, samples = LENGTH["stage"]
    step = np.minimum(1, 2 / np.arange(1, 13))
    n = np.zeros((12, 12, samples, 1))
    n[range(12), range(12), at] = 1
    errors = simulate(loop, Q, L, n, np.zeros_like(n), 12, step)
    found = np.sqrt((errors**2).sum(axis=(2, 3, 4)))  # (true and measured, trial)
    trials = noise_by_trial(trial_noise(loop, omega, 1.0), Q, L, step[:-1])
    expected = [
        [each.true.total for each in trials],
        [each.measured.total for each in trials],
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_densitys_forms_and_units():
    loop, _, omega, _ = case("tanks")
    forms = [
        4.0,
        np.full(3, 4.0),
        np.full(500, 4.0),
        np.full((500, 3), 4.0),
        np.broadcast_to(4 * np.eye(3), (500, 3, 3)),
    ]
    first, *others = (trial_noise(loop, omega, noise=form) for form in forms)
    for other in others:
        np.testing.assert_array_equal(other.measured.density, first.measured.density)
    one = trial_noise(loop, omega, noise=[0.0, 1.0, 0.0])
    two = trial_noise(loop, omega, disturbance=[2.0])
    both = trial_noise(loop, omega, [0.0, 1.0, 0.0], [2.0])
    np.testing.assert_allclose((one.true + two.true).density, both.true.density)
    np.testing.assert_array_equal(two.true.density, two.measured.density)


def test_the_rms_is_the_square_root_of_the_variance_and_a_data_sheets_density_twice_Ts_as_large():
    Ts, pole = 0.02, 0.7
    omega = np.geomspace(1e-3, np.pi / Ts, 2000)
    density = 9 * colour(omega, Ts, pole)[:, None, None] * np.diag([1.0, 4.0])
    both = Spectrum(omega, Ts, density)
    np.testing.assert_allclose(both.rms, [3, 6], rtol=1e-4)
    assert both.total == pytest.approx(np.sqrt(45), rel=1e-4)
    signal = 3 * coloured(np.random.default_rng(0), (100_000, 1), pole)[:, 0]
    frequency, one_sided = welch(signal, 1 / Ts, nperseg=128)
    expected = 2 * Ts * 9 * colour(2 * np.pi * frequency, Ts, pole)
    np.testing.assert_allclose(one_sided[1:-1], expected[1:-1], rtol=0.2)


def test_around_another_plant(loop):
    """What one trial without learning does with an impulse in the measured outputs."""
    Q, omega = zero_phase_butterworth(), np.geomspace(1e-4, np.pi, 1000)
    other = minimal_realisation(midr(Rod(conductivity=150.0), degree=4), ["Q1", "Q3"])
    other = control.sample_system(other, 1.0, "zoh")
    noise = np.zeros((1, 3000, 2))
    noise[0, 0, 1] = 1
    run = run_trials(
        loop, Law(Q, None), noise[0] * 0, None, 1, noise=noise, plant=other
    )
    new = trial_noise(loop, omega, [0.0, 1.0], plant=other)
    np.testing.assert_allclose(
        new.measured.rms, np.sqrt((run.e**2).sum("time"))[0], rtol=1e-3
    )
    true = np.sqrt(((run.e + noise) ** 2).sum("time"))[0]
    np.testing.assert_allclose(new.true.rms, true, rtol=1e-3)
    np.testing.assert_allclose(new.P, loop.frequency_response(omega, other), atol=1e-9)
    assert np.abs(new.P - loop.frequency_response(omega)).max() > 0.01


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        (-1.0, "noise is no spectral density"),
        ([1.0, -1.0, 0.0], "noise is no spectral density"),
        (
            np.ones(2),
            r"noise has shape \(2,\), but must be a variance, shape \(\) or \(3,\)",
        ),
        (np.ones((4, 3)), r"noise has shape \(4, 3\)"),
        (
            np.full((500, 3, 3), np.triu(np.ones((3, 3)))),
            "noise is no spectral density",
        ),
        (np.full((500, 3, 3), 1 - np.eye(3)), "noise is no spectral density"),
        (1j, "noise is no spectral density"),
        (np.nan, "noise has 1 values that are not finite"),
    ],
)
def test_what_is_no_density_is_refused(noise, words):
    loop, _, omega, _ = case("tanks")
    with pytest.raises(ValueError, match=words):
        trial_noise(loop, omega, noise)


def test_what_does_not_fit_is_refused():
    loop, Q, omega, [L] = case("tanks")
    new = trial_noise(loop, omega, 1.0)
    without = current_trial_loop(tanks()[:, ["pump A", "pump B", "pump C"]])
    with pytest.raises(ValueError, match="disturbance must be None: the loop has none"):
        trial_noise(without, omega, 1.0, 1.0)
    with pytest.raises(ValueError, match=r"omega, of shape .* increasing"):
        trial_noise(loop, omega[::-1], 1.0)
    with pytest.raises(
        ValueError, match=r"L does not converge: M has an eigenvalue of modulus"
    ):
        converged_noise(new, Q, LearningFilter(-0.01 * L.coefficients, L.Ts))
    with pytest.raises(ValueError, match=r"step = 1.5 must be in \(0, 1\]"):
        converged_noise(new, Q, L, 1.5)
    with pytest.raises(ValueError, match=r"step\[1\] = .*0.0.* must be in \(0, 1\]"):
        noise_by_trial(new, Q, L, [1, 0])
    with pytest.raises(ValueError, match=r"noise\.Ts = 2.0 s, L\.Ts = 1.0 s"):
        converged_noise(new, Q, LearningFilter(L.coefficients, 1.0))
    with pytest.raises(ValueError, match="L acts on 1 channels, but must act on 3"):
        converged_noise(new, Q, LearningFilter([[[1.0]]], 2.0))
    with pytest.raises(ValueError, match=r"noise\.Ts = 2.0 s, Q\.Ts = 1.0 s"):
        converged_noise(new, zero_phase_butterworth(), L)
