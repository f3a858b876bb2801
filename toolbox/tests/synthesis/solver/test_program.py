import numpy as np
from plants import random_response

from ilctools.problem.pose import pose
from ilctools.synthesis.formulate import orthonormalise, whitened_basis


def test_the_basis_is_orthonormal_and_spans_the_powers_of_z():
    P, Q, omega = random_response(0, 2)
    problem = pose(P, Q, omega, 1.0, order=4, L_max=5.0, band=(0.01, 1))
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
