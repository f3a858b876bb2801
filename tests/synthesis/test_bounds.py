"""Each kind of bound: value, derivatives, dual, worst case, against differences and a search."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.synthesis.bounds import adjoint, product
from rodlib.synthesis.program import formulate
from tests.synthesis.test_program import plant, posed

KINDS = ("M, full", "M, diagonal", "W L, full", "entry of W L")


def bound_of(kind, m, seed):
    """A bound of the kind, and the program that it belongs to."""
    P, Q, omega = plant(m, n=6, seed=seed)
    structure = "full" if kind.endswith("full") else "diagonal"
    program = formulate(posed(P, Q, omega, structure))
    return program.bounds[0 if kind.startswith("M") else 1], program


def norm(G):
    """sigma_max by NumPy's singular values."""
    return np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)[:, 0]


def random_unknowns(program, seed):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, program.entries, len(program.basis)))


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(1, 4), st.integers(0, 999))
def test_value_and_derivatives_against_differences(kind, m, seed):
    bound, program = bound_of(kind, m, seed)
    x, d = random_unknowns(program, seed)

    def sigma(step):
        return norm(bound.matrices((x + step * d) @ program.basis))

    G = bound.matrices(x @ program.basis)
    e = bound.expand(G, None, np.arange(6), program.basis, program.entries)
    first = (sigma(1e-5) - sigma(-1e-5)) / 2e-5
    second = (sigma(1e-4) - 2 * sigma(0) + sigma(-1e-4)) / 1e-8
    np.testing.assert_allclose(bound.value(G), sigma(0), rtol=1e-12)
    np.testing.assert_allclose(e.value, sigma(0), rtol=1e-12)
    np.testing.assert_allclose(e.gradient @ d.ravel(), first, rtol=1e-5, atol=1e-7)
    curvature = ((e.curvature @ d.ravel()) ** 2).sum(axis=1)
    np.testing.assert_allclose(curvature, second, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(1, 4), st.integers(0, 999))
def test_the_worst_case_attains_the_value_and_no_other_exceeds_it(kind, m, seed):
    """sigma_max(G) = Re tr(N^H G) for the N that is returned, and its nuclear norm is one."""
    bound, program = bound_of(kind, m, seed)
    x, _ = random_unknowns(program, seed)
    G = bound.matrices(x @ program.basis)
    worst = bound.expand(G, None, np.arange(6), program.basis, program.entries).N
    np.testing.assert_allclose(bound.dual(worst), 1, rtol=1e-12)
    attained = np.einsum("ijn,ijn->n", worst.conj(), G).real
    np.testing.assert_allclose(attained, norm(G), rtol=1e-10)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        N = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
        pairing = np.einsum("ijn,ijn->n", N.conj(), G).real
        assert np.all(pairing <= bound.dual(N) * norm(G) * (1 + 1e-12))


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(1, 4), st.integers(0, 999))
def test_gradient_is_the_adjoint_of_response_and_linear_its_matrix(kind, m, seed):
    bound, program = bound_of(kind, m, seed)
    rng = np.random.default_rng(seed)
    W = rng.standard_normal(bound.F.shape) + 1j * rng.standard_normal(bound.F.shape)
    x, _ = random_unknowns(program, seed)
    L = x @ program.basis
    change = bound.response(L)
    direct = np.einsum("ijn,jin->", W, change).real
    assert (bound.gradient(W) * L[bound.entries]).sum().real == pytest.approx(direct)
    linear = bound.linear(program.basis)
    shown = np.einsum("ijnek,ek->ijn", linear, x[: linear.shape[3]])
    np.testing.assert_allclose(shown, change, atol=1e-10 * np.abs(change).max())


@given(st.sampled_from([1, 2, 3, 7]), st.integers(0, 99))
def test_products_of_many_small_matrices(q, seed):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((2, q, q, 11)) + 1j * rng.standard_normal((2, q, q, 11))
    np.testing.assert_allclose(product(A, B), np.einsum("ijn,jkn->ikn", A, B), atol=1e-12)
    np.testing.assert_allclose(adjoint(A)[:, :, 3], A[:, :, 3].conj().T)
