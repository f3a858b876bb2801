"""The problem as an object, and the singular values that it is about."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import largest_singular_values


@pytest.mark.parametrize("gain", [1e-300, 1e-170, 1e-150, 1.0, 1e150, 1e170, 1e300])
def test_singular_values_whose_squares_leave_the_doubles_are_found(gain):
    G = np.random.default_rng(0).standard_normal((5, 2, 3)) * (1 + 2j)
    scaled = np.concatenate([G, 1e-3 * gain * G, 0 * G])
    expected = np.linalg.svd(scaled, compute_uv=False)[:, 0]
    np.testing.assert_allclose(largest_singular_values(scaled), expected, rtol=1e-14)
    mixed = np.concatenate([G, gain * G])
    expected = np.linalg.svd(mixed, compute_uv=False)[:, 0]
    np.testing.assert_allclose(largest_singular_values(mixed), expected, rtol=1e-14)
    row = largest_singular_values(scaled[:, :1])
    np.testing.assert_allclose(row, np.linalg.svd(scaled[:, :1])[1][:, 0], rtol=1e-14)


@given(st.integers(1, 3), st.sampled_from([1e-3, 1.0, 1e6]), st.integers(0, 999))
def test_without_a_bound_each_input_may_have_a_gain_of_ten_millions(m, unit, seed):
    """Of Q P L, at the frequency and with the phases of the outputs where it is largest."""
    rng = np.random.default_rng(seed)
    P = unit * (rng.standard_normal((5, m, m)) + 1j * rng.standard_normal((5, m, m)))
    Q = rng.uniform(0.1, 2, 5)
    omega = np.linspace(0.1, 3, 5)
    W = pose(P, Q, omega, 1.0, order=1, L_max=None, band=(0.1, 3)).weight
    assert np.all(W[0] == W)
    for k in range(m):
        L = np.zeros((m, m))
        L[k, 0] = 1 / W[0, k, k]  # as large as sigma_max(W L) <= 1 admits
        gains = np.linalg.svd(Q[:, None, None] * P @ L / Q.max(), compute_uv=False)[
            :, 0
        ]
        assert gains.max() == pytest.approx(1e7)
