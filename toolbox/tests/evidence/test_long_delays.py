"""The norm of a trial, where its two ends decide: plants that delay for long, and gains alone."""

import control
import numpy as np
from plants import lag, sigma_of_M

from ilctools import LearningFilter, synthesise, trial_map, trial_norm, zero_phase_butterworth
from ilctools.models import frequency_response


def delayed(samples):
    """A pure delay."""
    return control.ss(control.tf([1.0], [1.0, *np.zeros(samples)], 1.0))


def test_directions_that_grow_alike_have_a_norm():
    """A trial in which a delay acts on many samples of v not at all.

    Its largest singular values are 1 - 1e-6 and closer: a Lanczos iteration cannot separate them.
    """
    Q, L = zero_phase_butterworth(2, 2.8, 1.0), LearningFilter([[[0.5]]], 1.0, first=90)
    T = trial_map(delayed(90), Q, L, 200) @ np.eye(200)
    norm, before, after = trial_norm(delayed(90), Q, L, 200)
    assert abs(norm - np.linalg.norm(T, 2)) < 1e-12
    assert np.allclose(T @ before, after, rtol=0, atol=1e-12)


def test_a_pure_delay_of_200_samples_is_learned():
    design = synthesise(delayed(200))
    assert design.certificate.settled_trial.norm < 1
    M = sigma_of_M(np.linspace(0.001, np.pi, 4000), delayed(200), design.Q, design.filter)
    assert M.max() <= design.rate * (1 + 1e-6) < 0.01


def test_a_gain_without_states_is_learned():
    P = np.array([[2.0, 0.5], [0.0, 1.0]])
    design = synthesise(control.ss([], [], [], P, 0.1))
    b = 1 / (2 * design.problem.L_max)
    B = np.linalg.solve(P.T @ P + b**2 * np.eye(2), P.T)  # of norm-optimal learning
    assert np.allclose(design.filter.frequency_response([0.1, 5.0]), B, rtol=1e-9, atol=0)


def test_a_long_delay_turns_the_phase_of_what_follows():
    """Where most of a triangular matrix is zero, substitution leaves it out."""
    theta = np.linspace(0.01, np.pi, 50)
    exact = np.exp(-300j * theta) * 0.1 / (np.exp(1j * theta) - 0.9)
    response = frequency_response(delayed(300) * lag(), theta)[:, 0, 0]
    # rounding of 1e-16 in sums of some 300 terms whose sizes sum to one
    assert np.allclose(response, exact, rtol=0, atol=1e-12)
