"""Each kind of bound: value, derivatives, dual, worst case, against differences and a search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import plant, posed

from ilctools.synthesis.formulate import formulate

KINDS = ("M, diagonal", "W L, full", "entry of W L", "radius, full", "radius, diagonal")


def bound_of(kind, m, seed):
    """A bound of the kind, and the program that it belongs to."""
    P, Q, omega = plant(m, n=6, seed=seed)
    structure = "full" if kind.endswith("full") else "diagonal"
    radius = np.linspace(0.05, 0.1, 6) if "radius" in kind else None
    program = formulate(posed(P, Q, omega, structure, uncertainty=radius))
    return program.bounds[{"M": 0, "W": 1, "e": 1, "r": -1}[kind[0]]], program


def norm(G):
    """sigma_max by NumPy's singular values."""
    return np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)[:, 0]


def random_unknowns(program, seed):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, program.entries, len(program.basis)))


def smallest(bound, G):
    """The best split, and the smallest bound."""
    return bound.tighten(G, bound.first_split(G), 0.0)


def smooth(bound, G, split):
    """Where the largest singular value is apart from the next one, and hence has derivatives."""
    if bound.splits:
        G = G / np.sqrt(bound.diagonal(np.ones(G.shape[-1]), split))[:, None]
    s = np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)
    return np.flatnonzero(s[:, 1:2].max(axis=1, initial=0) < 0.97 * s[:, 0])


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=6)
@given(st.integers(1, 4), st.integers(0, 999))
def test_value_and_derivatives_against_differences(kind, m, seed):
    bound, program = bound_of(kind, m, seed)
    x, d = random_unknowns(program, seed)

    def sigma(step):
        return smallest(bound, bound.matrices((x + step * d) @ program.basis))[1][at]

    G = bound.matrices(x @ program.basis)
    split, value = smallest(bound, G)
    at = smooth(bound, G, split)
    e = bound.expand(G, split, at, program.basis, program.entries)
    first = (sigma(1e-5) - sigma(-1e-5)) / 2e-5
    second = (sigma(1e-4) - 2 * sigma(0) + sigma(-1e-4)) / 1e-8
    if not bound.splits:
        np.testing.assert_allclose(value, norm(G), rtol=1e-12)
    np.testing.assert_allclose(e.value, value[at], rtol=1e-12)
    size = np.abs(first).max(initial=0)
    np.testing.assert_allclose(e.gradient @ d.ravel(), first, rtol=1e-5, atol=1e-6 * (1 + size))
    curvature = ((e.curvature @ d.ravel()) ** 2).sum(axis=1)
    size = np.abs(curvature).max(initial=0)
    np.testing.assert_allclose(curvature, second, rtol=1e-3, atol=1e-3 * (1 + size))


@given(st.integers(1, 3), st.integers(0, 999))
def test_for_a_radius_the_value_is_the_worst_case(m, seed):
    """max |M x| + |H x| over unit vectors, by a search; m = 1 in closed form."""
    bound, program = bound_of("radius, full", m, seed)
    x, _ = random_unknowns(program, seed)
    G = bound.matrices(x @ program.basis)
    _, value = smallest(bound, G)
    M, H = np.moveaxis(G[:m], -1, 0), np.moveaxis(G[m:], -1, 0)

    def size(X, v):
        return np.linalg.norm(X @ v, axis=-2, keepdims=True)

    if m == 1:
        np.testing.assert_allclose(value, np.abs(M + 0 * H)[:, 0, 0] + np.abs(H)[:, 0, 0])
        return
    parts = [(X, X.conj().swapaxes(1, 2) @ X) for X in (M, H)]
    rng = np.random.default_rng(seed)
    v = np.array([1, 1j]) @ rng.standard_normal((5, len(M), m, 2, 1))
    # the gradient of a convex function points to where it is larger
    for _ in range(1000):
        v = sum(XX @ v / size(X, v) for X, XX in parts)
        v /= np.linalg.norm(v, axis=-2, keepdims=True)
    best = (size(M, v) + size(H, v))[..., 0, 0].max(axis=0)
    assert np.all(best <= value * (1 + 1e-12))
    np.testing.assert_allclose(best, value, rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=6)
@given(st.integers(1, 4), st.integers(0, 999))
def test_the_dual_attains_the_value_and_no_other_exceeds_it(kind, m, seed):
    """sigma_max(G) = Re tr(N^H G) for the N that is returned, and its nuclear norm is one."""
    bound, program = bound_of(kind, m, seed)
    x, _ = random_unknowns(program, seed)
    G = bound.matrices(x @ program.basis)
    split, value = smallest(bound, G)
    worst = bound.expand(G, split, np.arange(6), program.basis, program.entries).N
    np.testing.assert_allclose(bound.dual(worst, split), 1, rtol=1e-12)
    attained = np.einsum("ijn,ijn->n", worst.conj(), G).real
    np.testing.assert_allclose(attained, value, rtol=1e-10)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        N = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
        pairing = np.einsum("ijn,ijn->n", N.conj(), G).real
        assert np.all(pairing <= bound.dual(N, split) * value * (1 + 1e-12))
