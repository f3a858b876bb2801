"""The value of a bound, the largest singular value in the worst case, against a search."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import plant, posed

from ilctools.evidence.robustness import within_radius
from ilctools.synthesis.formulate import formulate


def bound_of(m, seed, radius=None):
    """A bound on M and its G for some filter."""
    P, Q, omega = plant(m, n=6, seed=seed)
    program = formulate(posed(P, Q, omega, "full", uncertainty=radius)).program
    x = np.random.default_rng(seed).standard_normal((len(program.rows), len(program.basis)))
    return program.bounds[-1], program.matrices(x)[-1]


@given(st.integers(1, 4), st.integers(0, 999))
def test_the_value_is_the_largest_singular_value(m, seed):
    bound, G = bound_of(m, seed)
    sigma = np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)[:, 0]
    np.testing.assert_allclose(bound.value(G, bound.first_share(G)), sigma, rtol=1e-12)


@given(st.integers(1, 3), st.integers(0, 999))
def test_for_a_radius_the_least_value_is_the_worst_case(m, seed):
    """max |M x| + |H x| over unit vectors, by a search; m = 1 in closed form."""
    radius, (P, Q, _) = np.linspace(0.05, 0.1, 6), plant(m, n=6, seed=seed)
    bound, G = bound_of(m, seed, radius)
    M, H = np.moveaxis(G[:m], -1, 0), np.moveaxis(G[m:], -1, 0)
    value = within_radius(P, Q, H / (np.abs(Q) * radius)[:, None, None], radius, 0.0)
    assert np.all(value <= bound.value(G, bound.first_share(G)) * (1 + 1e-12))

    def size(X, v):
        return np.linalg.norm(X @ v, axis=-2, keepdims=True)

    if m == 1:
        np.testing.assert_allclose(value, np.abs(M + 0 * H)[:, 0, 0] + np.abs(H)[:, 0, 0])
        return
    parts = [(X, X.conj().swapaxes(1, 2) @ X) for X in (M, H)]
    rng = np.random.default_rng(seed)
    v = complex_normal(rng, 5, len(M), m, 1)
    # the gradient of a convex function points to where it is larger
    for _ in range(1000):
        v = sum(XX @ v / size(X, v) for X, XX in parts)
        v /= np.linalg.norm(v, axis=-2, keepdims=True)
    best = (size(M, v) + size(H, v))[..., 0, 0].max(axis=0)
    assert np.all(best <= value * (1 + 1e-12))
    np.testing.assert_allclose(best, value, rtol=1e-6)
