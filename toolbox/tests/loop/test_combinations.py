"""Combinations of more outputs than inputs, against least squares."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ilctools import combinations
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
    assert loop.references == P.input_labels


WIDE, TALL = tall(0, 1, 2)[0], tall(0, 3, 2)[0]
REFUSALS = [  # P, weights, and what the error names
    (WIDE, None, "P has 1 outputs for 2 inputs"),
    (control.ss(0.5, [[1.0, 2.0]], [[1.0], [3.0]], 0, 1.0), None, "condition"),
    (TALL, [1.0, 1.0, -1.0], "weights reach -1"),
    (control.ss(1.1, 1, [[1.0], [1.0]], 0, 1.0), None, "P is unstable"),
]


@pytest.mark.parametrize(("P", "weights", "message"), REFUSALS)
def test_combinations_that_are_not_determined_are_refused(P, weights, message):
    with pytest.raises(ValueError, match=message):
        combinations(P, weights)
