"""A bound on a largest singular value, against the eigenvalues of its matrix inequality."""

import numpy as np
import pytest
from plants import complex_normal

from ilctools.synthesis.solver.bounds import Bound

COLUMNS, CLOSE = 6, 1e-9


@pytest.mark.parametrize("within_radius", [False, True])
def test_the_value_is_the_least_b_at_which_S_is_positive(within_radius):
    q = 2
    p = 2 * q if within_radius else q
    G = complex_normal(np.random.default_rng(0), p, q, COLUMNS)
    bound = Bound(G, G, np.arange(COLUMNS), np.zeros(COLUMNS, int), within_radius)
    share = bound.first_share(G)
    assert np.all(share < 1) and np.all((share > 0) == within_radius)
    b = bound.value(G, share)
    for factor in (1 - CLOSE, 1 + CLOSE):
        S = bound.inequality(factor * b, factor * b * share, G)
        least = np.linalg.eigvalsh(np.moveaxis(S, -1, 0)).min(axis=1)
        assert np.all((least > 0) == (factor > 1))
