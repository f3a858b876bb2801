"""The lower bound; CVXPY's multipliers try it in synthesis/test_robust.py."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import posed

from ilctools.evidence.optimality import dual_norm, lower_bound

sizes = st.integers(1, 3)
seeds = st.integers(0, 999)


@given(st.sampled_from([1, 10, 40]), st.sampled_from(["diagonal", "full"]), seeds)
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
    L = z[:, None, None] * pattern
    for _ in range((order - 1) // 2):  # pairs of zeros on the circle: real coefficients
        zero = np.exp(1j * 10 ** rng.uniform(-3, 0, (2, 2)))
        L = L * (z[:, None, None] - zero) * (z[:, None, None] - zero.conj())
    change = -Q[:, None, None] * (P @ L)
    change *= np.linalg.norm(U) / np.linalg.norm(change)
    moved = bound_of(U + change)
    assert bound > 0 and moved == pytest.approx(bound, rel=1e-11, abs=1e-11 * np.linalg.norm(U))


@given(sizes, st.integers(1, 2), seeds)
def test_the_dual_norm_is_above_the_product_with_whatever_is_bounded(m, parts, seed):
    """G is made from shares d and a contraction; the best for the best shares attains the norm."""
    N = complex_normal(np.random.default_rng(seed), 9, parts, m, m)
    N[0] = 0
    N[1, 0] = 0
    N[2, ..., 1:] = 0  # of rank one
    rows = N.reshape(9, -1, m)
    norm = dual_norm(rows)
    most = np.zeros(9)
    for d in np.linspace(0, 1, 401):
        shares = [d, 1 - d] if parts > 1 else [1]
        weighted = np.sqrt(shares)[:, None, None] * N
        nuclear = np.linalg.norm(weighted.reshape(9, -1, m), "nuc", axis=(1, 2))
        most = np.maximum(most, nuclear)
    assert norm[0] == 0 and np.all(most <= norm * (1 + 1e-12))
    np.testing.assert_allclose(most, norm, rtol=1e-4)
    np.testing.assert_allclose(dual_norm(1e-6j * rows), 1e-6 * norm, rtol=1e-8)
    if m == 1:  # of |M| + |rho L| <= 1
        np.testing.assert_allclose(norm, np.abs(rows[..., 0]).max(axis=1), rtol=1e-8)
