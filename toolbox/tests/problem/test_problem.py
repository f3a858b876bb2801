"""The problem as solver and evidence take it."""

import control
import numpy as np
from plants import random_response
from problems import posed

from ilctools import synthesise, zero_phase_butterworth
from ilctools.singular_values import largest_singular_values


def test_what_was_chosen_and_what_is_assumed_is_said_and_singular_plants_are_counted():
    P, Q, omega = random_response(1, 2)
    values = np.linalg.svdvals(P)[:, -1]
    problem = posed(P, Q, omega, 1.0, uncertainty=values * (omega > 1) + 1e-3)
    np.testing.assert_array_equal(problem.singular_within_radius, omega > 1)
    chosen, *_, of_Q, lost = map(str, problem.assumptions)
    assert chosen.startswith("chosen: order = ") and "; band = (" in chosen
    between = "assumed: Q is interpolated by splines between its samples"
    assert of_Q == f"{between}, and is {Q[-1]:.4g} above the last one"
    assert f"nothing can be learned at {np.sum(omega > 1)} frequencies from " in lost


def test_within_a_radius_the_gain_of_L_counts_and_not_that_of_K():
    """With more inputs than outputs H = |Q| r R K, B = U R, has the size of |Q| r L."""
    P = control.ss(0.5, [[1.0, 0.3, 2.0]], [[0.5], [0.2]], 0, 1.0)
    P = P + control.ss(0.8, [[0.1, 1.0, 0.2]], [[0.1], [0.6]], 0, 1.0)
    omega = np.linspace(0.05, 3.0, 9)
    Q = zero_phase_butterworth(2, 0.3, 1.0)
    design = synthesise(P, Q, omega, uncertainty=0.1, order=3)
    problem, at = design.problem, np.arange(9)
    _, T = problem.affine(0, at, problem.radius)
    random = np.random.default_rng(0)
    K = random.normal(size=(9, problem.channels, problem.channels))
    H = (T @ K)[:, problem.channels :]
    L = problem.base.frequency_response(omega) @ K
    expected = np.abs(problem.Q) * problem.radius * largest_singular_values(L)
    np.testing.assert_allclose(largest_singular_values(H), expected, rtol=1e-9)
