"""Combinations against least squares, and learning on them."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import lifted

from ilctools import Law, NormOptimal, combinations, run_trials, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response


def tall(seed, p, m, n=5):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return control.ss(A, B, C, 0, 0.5), rng


@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(0, 3))
def test_combinations_are_those_of_weighted_least_squares_at_rest(seed, m, more):
    P, rng = tall(seed, m + more, m)
    W = rng.uniform(0.2, 5, m + more)
    G, r = P.dcgain().reshape(m + more, m), rng.standard_normal(m + more)
    if np.linalg.cond(G) > 1e3:
        return
    for weights, root in ((None, np.ones(m + more)), (W, np.sqrt(W))):
        T, loop = combinations(P, weights)
        best = np.linalg.lstsq(root[:, None] * G, root * r, rcond=None)[0]
        np.testing.assert_allclose(T @ r, best, rtol=1e-6, atol=1e-8)  # as T P(1) = I
    omega = np.linspace(0, 6, 7)
    response, expected = loop.frequency_response(omega), frequency_response(P, omega)
    np.testing.assert_allclose(response[0], np.eye(m), atol=1e-9)
    np.testing.assert_allclose(response, T @ expected, rtol=1e-9, atol=1e-12)


WIDE, TALL = tall(0, 1, 2)[0], tall(0, 3, 2)[0]
REFUSALS = [  # P, weights, and what the error names
    (WIDE, None, "P has 1 outputs for 2 inputs"),
    (control.ss(0.5, [[1.0, 2.0]], [[1.0], [3.0]], 0, 1.0), None, "condition"),
    (TALL, [1.0, 0.0, 0.0], "condition"),
    (TALL, [1.0, 1.0, -1.0], "weights reach -1"),
    (control.ss(1.1, 1, [[1.0], [1.0]], 0, 1.0), None, "P is unstable"),
]


@pytest.mark.parametrize(("P", "weights", "message"), REFUSALS)
def test_combinations_that_are_not_determined_are_refused(P, weights, message):
    with pytest.raises(ValueError, match=message):
        combinations(P, weights)


def test_the_best_input_for_more_outputs_than_inputs_is_that_of_a_dense_solution():
    P, rng = tall(3, 4, 2)
    samples, weight, e = 25, 1e-3, rng.standard_normal((25, 4))
    G = lifted(P, samples)
    right = np.linalg.solve(G.T @ G + weight * np.eye(2 * samples), G.T @ e.ravel())
    u = NormOptimal(P, weight, samples).apply(e)
    np.testing.assert_allclose(u.ravel(), right, atol=1e-9)


def test_learning_on_combinations_comes_to_what_no_constant_input_betters():
    """Three sensors, two inputs, a controller that is not ours: the end of a trial at rest."""
    A = np.diag([0.9, 0.8, 0.6])
    B = [[0.1, 0.0], [0.05, 0.15], [0.0, 0.4]]
    C = [[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, 0.4, 1.0]]
    P = control.ss(A, B, C, 0, 1.0, inputs=["a", "b"], outputs=["x", "y", "z"])
    T, loop = combinations(P, [1.0, 2.0, 1.0])
    Q = zero_phase_butterworth(2, 0.5, 1.0)
    design = synthesise(loop, Q, order=10)
    assert design.sigma_M.max() <= 0.9 + 1e-9 and loop.references == ["a", "b"]
    r = np.minimum(np.arange(400)[:, None] / 100, 1) * [1.0, -0.5, 2.0]
    run = run_trials(loop, Law(Q, design.filter), r @ T.T, trials=8)
    w = (run.reference + run.v).values[-1]
    z = control.forced_response(P, inputs=w.T).outputs.T[200]
    root = np.sqrt([1.0, 2.0, 1.0])
    _, (least,), *_ = np.linalg.lstsq(root[:, None] * P.dcgain(), root * r[200])
    assert np.sum((root * (r[200] - z)) ** 2) == pytest.approx(least, rel=1e-3)
