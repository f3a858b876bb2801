"""The small matrix inequalities, against dense matrices one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import dense

from ilctools.synthesis.solver.inequalities import Slack, is_inside, longest_step, positive_definite


@given(st.integers(1, 4), st.integers(0, 2), st.integers(0, 999))
def test_what_a_slack_says_is_what_dense_matrices_say(q, more, seed):
    rng = np.random.default_rng(seed)
    p, n = q + more, 5
    G, D, Z = complex_normal(rng, 3, p, q, n)
    b = np.linalg.norm(G, 2, axis=(0, 1)) * rng.uniform(1.1, 2, n)
    d = rng.standard_normal(n)
    diagonal, dl = b * rng.uniform(1, 2, (p, n)), rng.standard_normal((p, n))
    slack, S, dS = Slack(diagonal, b, G), dense(diagonal, b, G), dense(dl, d, D)
    X = np.linalg.inv(S)
    np.testing.assert_allclose(np.moveaxis(slack.X, -1, 0), X, atol=1e-9 * np.abs(X).max())
    Y = dense(diagonal, b, Z) + 10 * b.max() * np.eye(p + q)
    product = Y @ dS @ X
    expected = (product + product.conj().swapaxes(1, 2)) / 2
    found = np.moveaxis(slack.sandwich(np.moveaxis(Y, 0, -1), dl, d, D), -1, 0)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    limit = longest_step(is_inside, (diagonal, b, G), (dl, d, D), 1.0, 1e-6)
    whole = longest_step(positive_definite, *([np.moveaxis(A, 0, -1)] for A in (S, dS)), 1.0, 1e-6)
    assert abs(limit - whole) <= 2e-6 * limit
    inside, outside = (np.linalg.eigvalsh(S + a * dS).min() for a in (limit, limit * (1 + 2e-6)))
    assert inside > 0 and (limit == 1.0 or outside < 1e-9 * b.max())
