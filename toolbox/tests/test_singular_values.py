"""Largest singular values against numpy's, for all shapes, however large the numbers."""

import numpy as np
import pytest
from plants import complex_normal

from ilctools.singular_values import largest_singular_values, tied


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (3, 1), (2, 2), (2, 5), (4, 2), (3, 3)])
@pytest.mark.parametrize("unit", [1e-200, 1.0, 1e200])
def test_they_are_those_of_the_singular_value_decomposition(shape, unit):
    G = complex_normal(np.random.default_rng(0), 50, *shape)
    G[0] = 0
    expected = unit * np.linalg.svd(G, compute_uv=False)[:, 0]
    np.testing.assert_allclose(largest_singular_values(unit * G), expected, rtol=1e-12)


def test_values_are_tied_as_far_as_a_solver_decides():
    assert tied(np.array([1.0, 1 - 1e-7, 0.99])).tolist() == [True, True, False]
