"""The singular values that the problem is about."""

import numpy as np
import pytest

from ilctools.singular_values import largest_singular_values


@pytest.mark.parametrize("gain", [1e-100, 1.0, 1e100])
def test_largest_singular_values_are_those_of_a_decomposition(gain):
    G = np.random.default_rng(0).standard_normal((5, 2, 3)) * (1 + 2j)
    mixed = np.concatenate([G, 1e-3 * gain * G, 0 * G])
    for matrices in (mixed, mixed[:, :1], mixed.swapaxes(1, 2)):
        expected = np.linalg.svd(matrices, compute_uv=False)[:, 0]
        sigma = largest_singular_values(matrices)
        np.testing.assert_allclose(sigma, expected, rtol=1e-14)
