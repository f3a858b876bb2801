"""Small Hermitian matrices, all at once, against numpy and scipy, one after the other."""

import numpy as np
import pytest
from plants import complex_normal
from scipy.linalg import eigvalsh

from ilctools.synthesis.solver import inequalities


@pytest.mark.parametrize("size", [1, 2, 5])
def test_they_are_those_of_numpy(size):
    A, B = complex_normal(np.random.default_rng(size), 2, 50, size, size)
    A, B = A @ np.conj(A).mT, B + np.conj(B).mT
    S, dS = np.moveaxis([A, B], 1, -1)
    X = np.moveaxis(inequalities.inverse(S), -1, 0)
    np.testing.assert_allclose(X @ A, np.broadcast_to(np.eye(size), A.shape), atol=1e-9)
    assert inequalities.inner(S, dS) == pytest.approx(np.trace(A @ B, axis1=1, axis2=2).sum().real)
    least = np.linalg.eigvalsh(B).min(axis=1)
    np.testing.assert_array_equal(inequalities.positive_definite(dS), least > 0)
    # S + a dS is singular where -1 / a is an eigenvalue of dS with respect to S
    end = -1 / min(eigvalsh(change, of).min() for change, of in zip(B, A, strict=True))
    found, accuracy = inequalities.longest_step(S, dS, 10 * end), inequalities.ACCURACY_OF_STEP
    assert end * (1 - accuracy) <= found < end
    assert inequalities.longest_step(S, dS, end / 2) == end / 2
