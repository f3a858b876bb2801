"""The lower bound of robust problems, against their optima as CVXPY finds them."""

import warnings
from dataclasses import replace
from functools import cache

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rodlib import synthesise
from rodlib.ilc.evidence.optimality import dual_norm, lower_bound
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import Cuts

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
    return pose(
        P, Q, omega, 1.0, order=3, M_max=M_max, L_max=1.5, band=(0.1, 1.0), objective=objective,
        structure=structure, uncertainty=size if radius else None,
    )  # fmt: skip


@cache
def optimum(m, others, radius, M_max, objective, structure):
    """The problem as a semidefinite program, entry for entry; its value and its multipliers.

    The matrices are variables of their own, so that the multipliers are those of equations.
    """
    problem = random_problem(m, others, radius, M_max, objective, structure)
    n = len(problem.omega)
    full = structure == "full"
    C = [
        cp.Variable((m, m)) if full else cp.diag(cp.Variable(m))
        for _ in range(problem.order)
    ]
    subject_to, value = [], 0
    peak = cp.Variable()
    equations, plant, frequency = {"U": [], "V": [], "N": []}, [], []

    def named(kind, expression):
        variable = cp.Variable(expression.shape, complex=True)
        equations[kind].append(variable == expression)
        return variable

    def at_most(G, b):  # sigma_max(G) <= b
        rows, columns = G.shape
        block = cp.bmat([[b * np.eye(rows), G], [G.H, b * np.eye(columns)]])
        return block >> 0

    for i in range(n):
        q, z = problem.Q[i], np.exp(1j * problem.omega[i] * problem.Ts)
        L = sum(c * z ** (k + 1) for k, c in enumerate(C))
        M = [q * (np.eye(m) - problem.plants[k][i] @ L) for k in range(1 + others)]
        subject_to.append(at_most(named("V", L), problem.L_max))
        bound = peak if objective == "peak" else M_max
        t = cp.Variable()
        subject_to.append(at_most(named("U", M[0]), t))
        if not radius:
            subject_to.append(t <= bound)
        value += t if problem.in_band[i] else 0
        for k in range(not radius, 1 + others):
            plant.append(k), frequency.append(i)
            if not radius:
                subject_to.append(at_most(named("N", M[k]), bound))
                continue
            d = cp.Variable()
            G = named("N", cp.vstack([M[k], abs(q) * problem.radius[i] * L]))
            shares = cp.hstack([bound - d] * m + [d] * m)
            corner = bound * np.eye(m)
            subject_to.append(cp.bmat([[cp.diag(shares), G], [G.H, corner]]) >> 0)
    subject_to += [equation for kind in equations.values() for equation in kind]
    objective = peak if objective == "peak" else value
    program, tiny = cp.Problem(cp.Minimize(objective), subject_to), 1e-11
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # "may be inaccurate": the test is on what follows from it
        program.solve(
            solver=cp.CLARABEL, tol_gap_abs=tiny, tol_gap_rel=tiny, tol_feas=tiny
        )
    U, V, N = (-np.array([e.dual_value for e in equations[kind]]) for kind in "UVN")
    cuts = Cuts(np.array(plant), np.array(frequency), N, np.empty((len(N), 0)))
    return problem, program.value, U, V, cuts


CASES = [
    (m, others, radius, M_max, objective, structure)
    for m, others, radius, M_max in [
        (1, 2, False, 0.27), (2, 2, False, 0.45), (1, 0, True, 0.29), (2, 1, True, 0.424),
        (3, 0, True, 0.45),
    ]
    for objective, structure in [("sum", "full"), ("peak", "diagonal")]
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_bound_from_the_multipliers_of_cvxpy_is_its_optimum(case):
    problem, value, U, V, cuts = optimum(*case)
    bound = lower_bound(problem, U, V, cuts)
    assert value * (1 - 1e-5) < bound < value * (1 + 1e-7)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_no_multipliers_however_wrong_give_a_bound_above_the_optimum(case):
    problem, value, U, V, cuts = optimum(*case)
    rng = np.random.default_rng(0)

    def wrong(X, share):
        noise = rng.standard_normal(X.shape) + 1j * rng.standard_normal(X.shape)
        return X + share * np.abs(X).max() * noise

    for share in [1e-3, 0.03, 1, 100] * 3:
        N = wrong(cuts.N, share)
        bound = lower_bound(
            problem, wrong(U, share), wrong(V, share), replace(cuts, N=N)
        )
        assert bound < value * (1 + 1e-7)
    assert lower_bound(problem, U, V) < value / 2  # what the cuts contribute is needed


@settings(max_examples=10)
@given(sizes, seeds)
def test_multipliers_of_what_is_no_part_of_the_bound_do_not_count(m, seed):
    """Where the radius is zero, G has no rows below M."""
    rng = np.random.default_rng(seed)
    problem = random_problem(m, 1, True, 0.9, "sum", "full")
    U, V = rng.standard_normal((2, 6, m, m))
    N = rng.standard_normal((2, 2 * m, m)) + 0j
    cuts = Cuts(np.array([0, 1]), np.array([1, 1]), N, np.empty((2, 0)))
    bound = lower_bound(problem, U, V, cuts)
    N = N.copy()
    N[:, m:] += 7
    assert lower_bound(problem, U, V, replace(cuts, N=N)) == pytest.approx(
        bound, rel=1e-6
    )
    assert np.isfinite(bound)


@given(sizes, st.integers(1, 2), seeds)
def test_the_dual_norm_is_above_the_product_with_whatever_is_bounded(m, parts, seed):
    """G is made from shares d and a contraction; the best for the best shares attains the norm."""
    rng = np.random.default_rng(seed)
    N = rng.standard_normal((9, parts, m, m)) + 1j * rng.standard_normal(
        (9, parts, m, m)
    )
    N[0] = 0
    N[1, 0] = 0
    N[2, ..., 1:] = 0  # of rank one
    rows = N.reshape(9, -1, m)
    norm = dual_norm(rows)
    most = np.zeros(9)
    for d in np.linspace(0, 1, 401):
        weighted = np.sqrt([d, 1 - d][:parts] if parts > 1 else [1])[:, None, None] * N
        most = np.maximum(
            most, np.linalg.svd(weighted.reshape(9, -1, m))[1].sum(axis=1)
        )
    assert norm[0] == 0 and np.all(most <= norm * (1 + 1e-12))
    np.testing.assert_allclose(most, norm, rtol=1e-4)
    np.testing.assert_allclose(dual_norm(1e-6j * rows), 1e-6 * norm, rtol=1e-8)


@given(st.integers(1, 2), seeds)
def test_the_dual_norm_of_one_channel_is_that_of_the_larger_part(parts, seed):
    """Of |M| + |rho L| <= 1."""
    N = np.random.default_rng(seed).standard_normal((5, parts, 1)) * (1 + 2j)
    expected = np.abs(N).reshape(5, -1).max(axis=1)
    np.testing.assert_allclose(dual_norm(N), expected, rtol=1e-8)


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("L_max", [4.0, None])
def test_lower_bound_holds_for_any_multipliers(structure, objective, L_max):
    """Weak duality: no multipliers, however wrong, give a bound above a feasible value."""
    rng = np.random.default_rng(1)
    omega = np.linspace(0.05, np.pi, 40)
    z = np.exp(1j * omega)
    P = 0.5 / (z - 0.5)[:, None, None] * np.eye(2) + 0.1 * rng.standard_normal((2, 2))
    Q = 1 / (1 + omega**4)
    arguments = {"order": 3, "L_max": L_max, "band": (0.05, 1), "objective": objective}
    arguments["structure"] = structure
    design = synthesise(P, Q, omega, 1.0, **arguments)
    assert 0 <= design.certificate.gap + 1e-12 < 1e-8
    for _ in range(20):
        U, V = rng.standard_normal((2, 40, 2, 2)) + 1j * rng.standard_normal(
            (2, 40, 2, 2)
        )
        V = None if L_max is None else V
        bound = lower_bound(design.problem, U, V)
        assert bound <= design.value * (1 + 1e-9)


@given(
    st.sampled_from([1, 10, 40]),
    st.sampled_from(["diagonal", "full"]),
    st.integers(0, 999),
)
def test_lower_bound_ignores_what_a_filter_could_do_to_the_multipliers(
    order, structure, seed
):
    """T L for any L is projected out of U. These L have a given gain, and huge coefficients."""
    rng = np.random.default_rng(seed)
    angles = np.geomspace(1e-4, np.pi, 250)
    z = np.exp(1j * angles)
    P = np.eye(2) * (0.1 / (z - 0.9))[:, None, None] + 0.2 * rng.standard_normal((2, 2))
    Q = 1 / (1 + (angles / 0.1) ** 4)
    problem = pose(P, Q, angles, 1.0, order=order, L_max=None, structure=structure)
    U = rng.standard_normal((250, 2, 2)) + 1j * rng.standard_normal((250, 2, 2))
    bound = lower_bound(problem, U, None)

    L = np.zeros((250, 2, 2), dtype=complex)
    for i, j in np.ndindex(2, 2):
        if structure == "full" or i == j:
            L[:, i, j] = z
            for _ in range(
                (order - 1) // 2
            ):  # a pair of zeros on the circle: real coefficients
                zero = np.exp(1j * 10 ** rng.uniform(-3, 0))
                L[:, i, j] *= (z - zero) * (z - zero.conj())
    change = -Q[:, None, None] * (P @ L)
    change *= np.linalg.norm(U) / np.linalg.norm(change)
    moved = lower_bound(problem, U + change, None)
    assert moved == pytest.approx(bound, rel=1e-11, abs=1e-11 * np.linalg.norm(U))
