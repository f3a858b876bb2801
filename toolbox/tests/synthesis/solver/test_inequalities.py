"""The small matrix inequalities, against dense matrices one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ilctools.synthesis.solver.inequalities import Slack, cholesky, longest_step


def dense(diagonal, b, G):
    """S = [[Lambda, G], [G^H, b I]] for each frequency, frequency first."""
    G = np.moveaxis(G, -1, 0)
    n, p, q = G.shape
    Lambda = np.zeros((n, p, p))
    np.einsum("nii->ni", Lambda)[:] = np.broadcast_to(diagonal, (p, n)).T
    return np.block([[Lambda, G], [G.conj().swapaxes(1, 2), b[:, None, None] * np.eye(q)]])


@given(st.integers(1, 4), st.integers(0, 2), st.integers(0, 999))
def test_what_a_slack_says_is_what_dense_matrices_say(q, more, seed):
    """Plain, where Lambda is b I, and with further rows and numbers of their own in Lambda."""
    rng = np.random.default_rng(seed)
    p, n = q + more, 5
    G, D, Z = rng.standard_normal((3, p, q, n)) + 1j * rng.standard_normal((3, p, q, n))
    b = np.linalg.norm(G, 2, axis=(0, 1)) * rng.uniform(1.1, 2, n)
    d, steps = rng.standard_normal(n), rng.uniform(0, 0.3, 3)
    diagonal, dl = b[None], d[None]
    if more:
        diagonal, dl = b * rng.uniform(1, 2, (p, n)), rng.standard_normal((p, n))
    slack, S, dS = Slack(G, diagonal, b), dense(diagonal, b, G), dense(dl, d, D)
    X = np.linalg.inv(S)
    np.testing.assert_allclose(np.moveaxis(slack.X, -1, 0), X, atol=1e-9 * np.abs(X).max())
    Y = dense(diagonal, b, Z) + 10 * b.max() * np.eye(p + q)
    product = Y @ dS @ X
    expected = (product + product.conj().swapaxes(1, 2)) / 2
    found = np.moveaxis(slack.sandwich(np.moveaxis(Y, 0, -1), dl, d, D), -1, 0)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    C, _ = cholesky(np.moveaxis(Y, 0, -1), 0.0)
    root = np.moveaxis(slack.root(C, dl, d, D), -1, 0)
    square = np.linalg.norm(root, axis=(1, 2)) ** 2
    np.testing.assert_allclose(square, np.einsum("nij,nji->n", dS, product).real, rtol=1e-8)
    along = slack.along(dl, d, D)
    for a in steps:
        value = np.moveaxis(sum(term * a**k for k, term in enumerate(along)), -1, 0)
        moved = S + a * dS
        if not more:  # a Schur complement of it
            complement = (b + a * d)[:, None, None] * moved[:, p:, p:]
            moved = complement - moved[:, p:, :p] @ moved[:, :p, p:]
        np.testing.assert_allclose(value, moved, atol=1e-12 * np.abs(moved).max())
    limit = longest_step(along, 1.0, 1e-6)
    inside, outside = (np.linalg.eigvalsh(S + a * dS).min() for a in (limit, limit * (1 + 2e-6)))
    assert inside > 0 and (limit == 1.0 or outside < 1e-9 * b.max())
