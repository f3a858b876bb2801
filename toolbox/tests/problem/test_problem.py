"""The problem as an object, and the singular values that it is about."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal

from ilctools.problem.pose import pose
from ilctools.singular_values import largest_singular_values


@pytest.mark.parametrize("gain", [1e-100, 1.0, 1e100])
def test_largest_singular_values_are_those_of_a_decomposition(gain):
    G = np.random.default_rng(0).standard_normal((5, 2, 3)) * (1 + 2j)
    mixed = np.concatenate([G, 1e-3 * gain * G, 0 * G])
    for matrices in (mixed, mixed[:, :1], mixed.swapaxes(1, 2)):
        expected = np.linalg.svd(matrices, compute_uv=False)[:, 0]
        sigma = largest_singular_values(matrices)
        np.testing.assert_allclose(sigma, expected, rtol=1e-14)


@given(st.integers(1, 3), st.sampled_from([1e-3, 1.0, 1e6]), st.integers(0, 999))
def test_without_a_bound_each_input_may_have_a_gain_of_ten_millions(m, unit, seed):
    """Of Q P L, at the frequency and with the phases of the outputs where it is largest."""
    rng = np.random.default_rng(seed)
    P = unit * complex_normal(rng, 5, m, m)
    Q, omega = rng.uniform(0.1, 1, 5), np.linspace(0.1, 3, 5)
    W = pose(P, Q, omega, 1.0, order=1, L_max=None, band=(0.1, 3)).weight
    assert np.all(W[0] == W)
    for k in range(m):
        L = np.zeros((m, m))
        L[k, 0] = 1 / W[0, k, k]  # as large as sigma_max(W L) <= 1 admits
        gains = np.linalg.norm(Q[:, None, None] * P @ L, 2, axis=(1, 2)) / Q.max()
        assert gains.max() == pytest.approx(1e7)
