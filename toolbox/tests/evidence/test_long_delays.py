"""The norm of a trial, where its two ends decide: plants that delay for long, and gains alone."""

import control
import numpy as np
import pytest

from ilctools import LearningFilter, synthesise, trial_norm, zero_phase_butterworth
from ilctools.models import frequency_response, impulse_response


def delayed(samples, gain=1.0):
    """A pure delay."""
    return control.tf([gain], [1.0, *np.zeros(samples)], 1.0)


@pytest.mark.parametrize("samples, delay", [(60, 100), (200, 90)])
def test_directions_that_grow_alike_have_a_norm(samples, delay):
    """A trial in which a delay acts on many samples of v not at all; T written out, entry by entry.

    Its largest singular values are 1 - 1e-6 and closer: a Lanczos iteration cannot separate them.
    """
    Q, L = zero_phase_butterworth(2, 2.8, 1.0), LearningFilter([[[0.5]]], 1.0, first=delay)
    norm, before, after = trial_norm(delayed(delay), Q, L, samples)
    lag = np.arange(samples)
    P_N = 1.0 * (lag[:, None] - lag == delay)
    theta = np.linspace(0, np.pi, 2**16 + 1)  # Q by its Fourier series
    taps = np.fft.irfft(Q.frequency_response(theta))
    T = taps[np.abs(lag[:, None] - lag)] @ (np.eye(samples) - 0.5 * P_N.T @ P_N)
    assert abs(norm - np.linalg.norm(T, 2)) < 1e-9  # Q is realised to 1e-12 in its recursion
    assert np.allclose(T @ before[:, 0], after[:, 0], rtol=0, atol=1e-9)


def test_a_pure_delay_of_500_samples_is_learned():
    """Without Q. P L is what 500 samples of delay leave of L, at all frequencies."""
    design = synthesise(delayed(500))
    samples, norm = design.certificate.trial
    assert samples > 500 and norm < 1
    theta = np.linspace(0.001, np.pi, 4000)
    P, Q = np.exp(-500j * theta), design.Q.frequency_response(theta)
    M = np.abs(Q * (1 - P * design.filter.frequency_response(theta)[:, 0, 0]))
    assert M.max() <= design.rate * (1 + 1e-6) < 0.01


def test_a_gain_without_states_is_learned():
    model = control.ss([], [], [], [[2.0, 0.5], [0.0, 1.0]], 0.1)
    for Q in (None, zero_phase_butterworth(2, 3.0, 0.1)):
        design = synthesise(model, Q)
        b = 1 / (2 * design.problem.L_max)
        P = model.D
        B = np.linalg.solve(P.T @ P + b**2 * np.eye(2), P.T)  # of norm-optimal learning
        assert np.allclose(design.filter.frequency_response([0.1, 5.0]), B, rtol=1e-9, atol=0)


@pytest.mark.parametrize("states", [30, 300])
def test_a_long_delay_has_the_response_of_its_impulse_response(states):
    """Where most of a triangular matrix is zero, substitution leaves it out."""
    rest = control.ss([[0.9, 0.2], [0.0, 0.5]], [[0.1], [1.0]], [[1.0, 0.3]], 0, 1.0)
    model = control.ss(delayed(states)) * rest
    theta = np.linspace(0.01, np.pi, 50)
    h = impulse_response(model, states + 500)[:, 0, 0]  # 0.9^500 is 1e-23
    exact = np.exp(-1j * np.outer(theta, np.arange(len(h)))) @ h
    # rounding of 1e-16 in sums of a thousand terms whose sizes sum to 7
    assert np.allclose(frequency_response(model, theta)[:, 0, 0], exact, rtol=0, atol=1e-12)
