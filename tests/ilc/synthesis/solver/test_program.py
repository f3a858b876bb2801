import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import LearningFilter
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.synthesis.formulate import (
    formulate,
    orthonormalise,
    whitened_basis,
)


def plant(m, n=20, seed=0):
    rng = np.random.default_rng(seed)
    omega = np.geomspace(1e-3, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    P = (np.eye(m) + 0.2 * rng.standard_normal((m, m))) * 0.2 / (z - 0.8)
    return P, 1 / (1 + omega**4), omega


def posed(
    P, Q, omega, structure, objective="sum", L_max=5.0, M_max=0.9, uncertainty=None
):
    kind = {"structure": structure, "objective": objective, "uncertainty": uncertainty}
    return pose(
        P, Q, omega, 1.0, order=4, M_max=M_max, L_max=L_max, band=(1e-3, 1), **kind
    )


@given(st.integers(1, 4), st.sampled_from(["diagonal", "full"]), st.integers(0, 99))
def test_matrices_are_those_of_the_filter(m, structure, seed):
    """G of the bounds are M and L / L_max of (39) for the filter that the unknowns stand for."""
    P, Q, omega = plant(m, seed=seed)
    problem = formulate(posed(P, Q, omega, structure))
    C = np.random.default_rng(seed).standard_normal((m, m, 4))
    if structure == "diagonal":
        C *= np.eye(m)[:, :, None]
    L = LearningFilter(C, 1.0).frequency_response(omega)
    M = Q[:, None, None] * (np.eye(m) - P @ L)
    x = problem.unknowns(C)
    G = [np.moveaxis(A, -1, 0) for A in problem.matrices(x)]
    np.testing.assert_allclose(G[0], M, atol=1e-10)
    if structure == "full":
        np.testing.assert_allclose(G[1], L / 5, atol=1e-10)
    else:
        entries = np.concatenate(G[1:], axis=1)[:, :, 0]
        np.testing.assert_allclose(entries, L[:, range(m), range(m)] / 5)
    multipliers = [0 * A for A in problem.matrices(x)]
    splits = [np.zeros((0, A.shape[2])) for A in multipliers]
    solution = problem.solution(x, multipliers, splits, "none", 0)
    np.testing.assert_allclose(solution.coefficients, C, atol=1e-10)
    assert solution.largest == pytest.approx(np.linalg.norm(M, 2, axis=(1, 2)).max())


def test_the_basis_is_orthonormal_and_spans_the_powers_of_z():
    P, Q, omega = plant(2)
    problem = posed(P, Q, omega, "full")
    basis, R = whitened_basis(problem)
    z = np.exp(1j * omega) ** np.arange(1, 5)[:, None]
    np.testing.assert_allclose(R.T.astype(float) @ basis, z, atol=1e-12)
    size = np.linalg.norm(Q[:, None, None] * P, axis=(1, 2)) / Q.max()
    weighted = np.hypot(size, 1 / 5) * basis
    gram = (weighted @ weighted.conj().T).real
    np.testing.assert_allclose(gram, np.eye(4), atol=1e-12)


def test_orthonormalisation_keeps_more_digits_than_doubles():
    """Q^T Q = I and Q R = A for a matrix of condition 1e15."""
    A = np.vander(np.linspace(0.99, 1, 200, dtype=np.longdouble), 8)
    Q, R = orthonormalise(A)
    assert np.abs(Q.T @ Q - np.eye(8)).max() < 1e-15
    assert np.abs(Q @ R - A).max() < 1e-15
    assert np.linalg.cond(A.astype(float)) > 1e14
