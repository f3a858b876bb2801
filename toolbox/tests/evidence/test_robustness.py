"""The worst case over plants and a radius, against searches and samples."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from plants import complex_normal
from problems import posed

from ilctools import LearningFilter, worst_case
from ilctools.evidence.robustness import within_radius

sizes = st.integers(1, 3)
seeds = st.integers(0, 999)


def random_case(m, seed, n=5, others=0):
    """A problem with random responses, a real Q that is zero once, and a random filter."""
    rng = np.random.default_rng(seed)
    P = complex_normal(rng, 1 + others, n, m, m)
    Q = np.clip(0.5 * rng.standard_normal(n), -1, 1)
    Q[0] = 0
    radius = rng.uniform(0, 1, n)
    radius[1] = 0
    omega, asked = np.linspace(0.1, 3, n), {"order": 3, "band": (0.1, 3)}
    problem = posed(list(P), Q, omega, 1.0, uncertainty=radius, **asked)
    return problem, LearningFilter(rng.standard_normal((m, m, 3)), 1.0)


def sigma_max(problem, L, i, k=0, Delta=0):
    """At one frequency, by the book."""
    response = L.frequency_response(problem.omega)[i]
    P = problem.plants[k][i] + Delta
    return np.linalg.norm(problem.Q[i] * (np.eye(len(P)) - P @ response), 2)


@given(sizes, st.integers(0, 4), seeds)
def test_no_plant_within_the_radius_is_worse(m, others, seed):
    """Of one channel the worst is |M| + |Q| radius |L|."""
    problem, L = random_case(m, seed, others=others)
    worst = worst_case(problem, L)
    plant, at = worst.plant, worst.frequency
    assert worst.sigma[at] == worst.sigma.max() and plant in range(1 + others)
    exact = worst_case(replace(problem, response=replace(problem.response, radius=None)), L)
    nominal = [[sigma_max(problem, L, i, k) for i in range(5)] for k in range(1 + others)]
    np.testing.assert_allclose(exact.sigma, np.max(nominal, axis=0), rtol=1e-12)
    if m == 1:
        added = np.abs(problem.Q * problem.radius * L.frequency_response(problem.omega)[:, 0, 0])
        np.testing.assert_allclose(worst.sigma, exact.sigma + added, rtol=1e-6)
    rng = np.random.default_rng(seed)
    for k in range(1 + others):
        for i, _ in np.ndindex(5, 10):
            Delta = complex_normal(rng, m, m)
            Delta *= problem.radius[i] / np.linalg.norm(Delta, 2)
            assert sigma_max(problem, L, i, k, Delta) <= worst.sigma[i] * (1 + 1e-12)


def test_the_bound_is_attained_where_two_directions_are_amplified_equally():
    """One is worst for M and the other for L, and only their sum is worst for both."""
    M, L, every = np.diag([1.0, 0.2]), np.diag([0.3, 0.9]), np.ones((4, 1, 1))
    P, radius = (np.eye(2) - M) @ np.linalg.inv(L), np.array([0.5, 0.9, 1.0, 1.1])
    worst = within_radius(every * P, np.ones(4), every * L, radius, level=0.0)
    angle = np.linspace(0, np.pi / 2, 100_001)
    x = np.stack([np.cos(angle), np.sin(angle)])
    of_M, of_L = np.linalg.norm(M @ x, axis=0), np.linalg.norm(L @ x, axis=0)
    sums = of_M + np.outer(radius, of_L)
    np.testing.assert_allclose(worst, sums.max(axis=1), rtol=1e-8)
