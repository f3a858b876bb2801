"""The lower bound; CVXPY's multipliers try it in synthesis/test_formulate.py."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import posed

from ilctools.evidence.optimality import dual_norm, lower_bound


@given(st.sampled_from([1, 10, 40]), st.sampled_from(["diagonal", "full"]), st.integers(0, 999))
def test_lower_bound_ignores_what_a_filter_could_do_to_the_multipliers(order, structure, seed):
    """T L for any L is projected out of U. These L have a given gain, and huge coefficients."""
    rng = np.random.default_rng(seed)
    angles = np.geomspace(1e-4, np.pi, 250)
    z = np.exp(1j * angles)
    P = np.eye(2) * (0.1 / (z - 0.9))[:, None, None] + 0.2 * rng.standard_normal((2, 2))
    Q = 1 / (1 + (angles / 0.1) ** 4)
    asked = {"order": order, "L_max": None, "structure": structure, "objective": "peak"}
    problem, U = posed(P, Q, angles, 1.0, **asked), complex_normal(rng, 250, 2, 2)

    def bound_of(U):
        """Of U and -U one has a bound above zero, by as much as is left of U."""
        return lower_bound(problem, U, None) + lower_bound(problem, -U, None)

    bound = bound_of(U)
    pattern = np.eye(2) if structure == "diagonal" else np.ones((2, 2))
    L = (z * (z - 1) ** (order - 1))[:, None, None] * pattern * rng.standard_normal((2, 2))
    change = -Q[:, None, None] * (P @ L)
    change *= np.linalg.norm(U) / np.linalg.norm(change)
    moved = bound_of(U + change)
    assert bound > 0 and moved == pytest.approx(bound, rel=1e-11, abs=1e-11 * np.linalg.norm(U))


def test_the_dual_norm_is_the_nuclear_norm_with_the_best_shares():
    N = complex_normal(np.random.default_rng(0), 9, 2, 3, 3)
    N[0] = N[1, 0] = 0
    norm = dual_norm(N.reshape(9, 6, 3))
    shares = np.sqrt([(d, 1 - d) for d in np.linspace(0, 1, 401)])[:, None, :, None, None]
    nuclear = np.linalg.matrix_norm((shares * N).reshape(-1, 9, 6, 3), ord="nuc").max(axis=0)
    assert norm[0] == 0 and np.all(nuclear <= norm * (1 + 1e-12))
    np.testing.assert_allclose(nuclear, norm, rtol=1e-4)  # of a grid for the shares
