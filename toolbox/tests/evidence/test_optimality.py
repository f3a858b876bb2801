"""The lower bound of robust problems, against their optima as CVXPY finds them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import optimum

from ilctools.evidence.optimality import dual_norm, lower_bound
from ilctools.problem.pose import pose

sizes = st.integers(1, 3)
seeds = st.integers(0, 999)


def random_problem(m, others, radius, M_max, objective, structure, seed=0):
    """A few lags with gains of their own, Q that falls, and a radius that grows."""
    rng = np.random.default_rng(seed)
    n = 6
    omega = np.linspace(0.1, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    gains = np.eye(m) + 0.1 * rng.standard_normal((1 + others, m, m))
    P = [0.5 / (z - 0.5) * K * (1 + 0.2 * rng.standard_normal()) for K in gains]
    size = 0.1 * omega * rng.uniform(0.5, 1, n)
    size[1] = 0
    Q = 1 / (1 + (omega / 1.5) ** 4)
    counted = {"band": (0.1, 1.0), "objective": objective}
    if objective == "weighted sum":
        counted = {"reference": np.cumsum(rng.standard_normal((20, m)), axis=0)}
    return pose(
        P, Q, omega, 1.0, order=3, M_max=M_max, L_max=1.5, structure=structure,
        uncertainty=size if radius else None, **counted,
    )  # fmt: skip


CASES = [
    (2, 2, False, 0.45, "sum", "full"), (2, 2, False, 0.45, "peak", "diagonal"),
    (1, 0, True, 0.29, "peak", "full"), (2, 1, True, 0.424, "sum", "diagonal"),
    (2, 1, True, 0.424, "peak", "full"), (2, 2, False, 0.45, "weighted sum", "full"),
    (2, 1, True, 0.424, "weighted sum", "diagonal"),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_bound_from_the_multipliers_of_cvxpy_is_its_optimum_and_others_are_below(case):
    problem = random_problem(*case)
    value, U, V, cuts = optimum(problem)
    bound = lower_bound(problem, U, V, cuts)
    assert value * (1 - 1e-5) < bound < value * (1 + 1e-7)
    assert lower_bound(problem, U, V) < value / 2  # what the cuts contribute is needed
    if problem.radius is not None:  # where it is zero, G has no rows below M
        N = cuts.N.copy()
        N[cuts.frequency == 1, problem.channels :] += 7
        other = lower_bound(problem, U, V, replace(cuts, N=N))
        assert other == pytest.approx(bound, rel=1e-6)
    rng = np.random.default_rng(0)

    def wrong(X, share):
        return X + share * np.abs(X).max() * complex_normal(rng, *X.shape)

    for share in [1e-3, 0.03, 1, 100] * 3:
        N = replace(cuts, N=wrong(cuts.N, share))
        bound = lower_bound(problem, wrong(U, share), wrong(V, share), N)
        assert bound < value * (1 + 1e-7)


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


@given(st.sampled_from([1, 10, 40]), st.sampled_from(["diagonal", "full"]), seeds)
def test_lower_bound_ignores_what_a_filter_could_do_to_the_multipliers(order, structure, seed):
    """T L for any L is projected out of U. These L have a given gain, and huge coefficients."""
    rng = np.random.default_rng(seed)
    angles = np.geomspace(1e-4, np.pi, 250)
    z = np.exp(1j * angles)
    P = np.eye(2) * (0.1 / (z - 0.9))[:, None, None] + 0.2 * rng.standard_normal((2, 2))
    Q = 1 / (1 + (angles / 0.1) ** 4)
    problem = pose(P, Q, angles, 1.0, order=order, L_max=None, structure=structure)
    U = complex_normal(rng, 250, 2, 2)
    bound = lower_bound(problem, U, None)
    pattern = np.eye(2) if structure == "diagonal" else np.ones((2, 2))
    L = z[:, None, None] * pattern
    for _ in range((order - 1) // 2):  # pairs of zeros on the circle: real coefficients
        zero = np.exp(1j * 10 ** rng.uniform(-3, 0, (2, 2)))
        L = L * (z[:, None, None] - zero) * (z[:, None, None] - zero.conj())
    change = -Q[:, None, None] * (P @ L)
    change *= np.linalg.norm(U) / np.linalg.norm(change)
    moved = lower_bound(problem, U + change, None)
    assert moved == pytest.approx(bound, rel=1e-11, abs=1e-11 * np.linalg.norm(U))
