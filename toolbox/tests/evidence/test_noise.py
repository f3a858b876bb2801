"""What noise does, against trials simulated one after the other, closed forms and other solvers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import LOOPS, altered, complex_normal
from scipy.linalg import solve_discrete_lyapunov

from ilctools import (
    Law,
    LearningFilter,
    run_trials,
    synthesise,
    trial_noise,
    zero_phase_butterworth,
)
from ilctools.evidence.noise import learned_noise

pytestmark = [  # after an impulse, around another plant
    pytest.mark.filterwarnings("ignore:the error grows"),
    pytest.mark.filterwarnings("ignore:the convergence rate"),
]


@pytest.fixture(scope="module")
def on_tanks():
    """A loop with a law, and a grid."""
    loop = LOOPS["tanks"]()
    Q = zero_phase_butterworth(2, 0.3, loop.Ts)
    omega = np.geomspace(1e-4, 1, 500) * np.pi / loop.Ts
    L = synthesise(loop, Q, omega, loop.Ts, order=10, band=(1e-3, 0.1)).filter
    return loop, Law(Q, L), omega


TRIALS, SAMPLES, AT = 60, 900, 400


def after_one(loop, law, noise, plant):
    """True and measured error of trials of which the first is disturbed, (kind, trial, time, m)."""
    n = np.concatenate([noise[None], np.zeros((TRIALS - 1, *noise.shape))])
    e = run_trials(loop, law, 0 * noise, trials=TRIALS, noise=n, plant=plant).e.values
    return np.stack([e + n, e])


def test_a_single_impulse_through_the_trials_has_the_predicted_rms(on_tanks):
    """For white noise the variance is the sum of squares of what one impulse does, ever after.

    It is in the middle of the first trial, so that the ends of a trial do not matter.
    """
    loop, law, omega = on_tanks
    plant, variance, power = altered(loop.plant, A=0.97), np.array([1.0, 4.0, 9.0]), 0
    for impulse in np.diag(np.sqrt(variance)):
        noise = np.zeros((SAMPLES, 3))
        noise[AT] = impulse
        power = power + after_one(loop, law, noise, plant) ** 2
    for known, errors in ((None, power[:, :1]), (law, power)):
        noise = trial_noise(loop, omega, variance, law=known, plant=plant)
        predicted = [noise.rms(), noise.rms("measured")]
        expected = np.sqrt(errors.sum(axis=(1, 2)))
        np.testing.assert_allclose(predicted, expected, rtol=2e-3)


@given(st.integers(1, 4), st.integers(0, 9999), st.floats(0.01, 1))
def test_what_is_learned_solves_the_lyapunov_equation(m, seed, gain):
    rng = np.random.default_rng(seed)
    omega, Q = np.linspace(0.05, 3, 6), zero_phase_butterworth(1, 1.0, 1.0)
    L = LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    random = complex_normal(rng, 2, 6, m, m)
    change = 0.95 * random[0] / np.linalg.norm(random[0], 2, axis=(1, 2))[:, None, None]
    P = (np.eye(m) - change) @ np.linalg.inv(L.frequency_response(omega))
    x = random[1] @ random[1].conj().swapaxes(1, 2)
    found = learned_noise(P, Law(Q, L, gain=gain), omega, x)
    for i, q in enumerate(Q.frequency_response(omega)):
        PL = P[i] @ L.frequency_response(omega)[i]
        M = (1 - gain) * np.eye(m) + gain * q * (np.eye(m) - PL)
        added = (gain * q) ** 2 * PL @ x[i] @ PL.conj().T
        learned = solve_discrete_lyapunov(M, added)
        limit = 1e-8 * np.abs(learned).max()
        np.testing.assert_allclose(found[i], learned, atol=limit)
