"""The worst case over plants and a radius, against closed forms, searches and samples."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from rodlib import LearningFilter
from rodlib.ilc import worst_case
from rodlib.ilc.alternatives import TwoSidedFilter
from rodlib.ilc.problem.pose import pose

sizes = st.integers(1, 3)
seeds = st.integers(0, 999)


def complex_normal(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def random_case(m, seed, n=5, others=0):
    """A problem with random responses, a real Q that is zero once, and a random filter."""
    rng = np.random.default_rng(seed)
    P = complex_normal(rng, 1 + others, n, m, m)
    Q = 0.5 * rng.standard_normal(n)
    Q[0] = 0
    radius = rng.uniform(0, 1, n)
    radius[1] = 0
    problem = pose(
        list(P),
        Q,
        np.linspace(0.1, 3, n),
        1.0,
        order=3,
        band=(0.1, 3),
        uncertainty=radius,
    )
    return problem, LearningFilter(rng.standard_normal((m, m, 3)), 1.0)


def sigma_max(problem, L, i, k=0, Delta=0):
    """At one frequency, by the book."""
    response = L.frequency_response(problem.omega)[i]
    P = problem.plants[k][i] + Delta
    return np.linalg.norm(problem.Q[i] * (np.eye(len(P)) - P @ response), 2)


@given(sizes, st.integers(0, 4), seeds)
def test_the_plant_and_the_Delta_that_are_named_reach_what_is_said(m, others, seed):
    problem, L = random_case(m, seed, others=others)
    worst = worst_case(problem, L)
    for i, Delta in enumerate(worst.Delta):
        reached = sigma_max(problem, L, i, worst.plant[i], Delta)
        assert reached == pytest.approx(worst.attained[i], rel=1e-12, abs=1e-15)
    np.testing.assert_allclose(worst.attained, worst.sigma, rtol=1e-12)
    size = np.linalg.norm(worst.Delta, 2, axis=(1, 2))
    assert np.all(size <= problem.radius * (1 + 1e-12))


@given(sizes, st.integers(0, 4), seeds)
def test_no_plant_within_the_radius_is_worse(m, others, seed):
    problem, L = random_case(m, seed, others=others)
    worst = worst_case(problem, L)
    rng = np.random.default_rng(seed)
    for i, k in np.ndindex(len(problem.omega), 1 + others):
        assert sigma_max(problem, L, i, k) <= worst.sigma[i] * (1 + 1e-12)
        assert sigma_max(problem, L, i, k) <= worst.peaks[k] * (1 + 1e-12)
        for _ in range(10):
            Delta = complex_normal(rng, m, m)
            Delta *= problem.radius[i] / np.linalg.norm(Delta, 2)
            assert sigma_max(problem, L, i, k, Delta) <= worst.sigma[i] * (1 + 1e-12)


@pytest.mark.parametrize("m", [2, 3])
def test_a_search_by_an_optimiser_ends_at_the_worst_case_and_not_above(m):
    problem, L = random_case(m, 7)
    worst = worst_case(problem, L)
    rng = np.random.default_rng(0)
    i = 2

    def negative(x):
        A, B = x.reshape(2, m, m)
        Delta = problem.radius[i] * (A + 1j * B) / np.linalg.norm(A + 1j * B, 2)
        return -sigma_max(problem, L, i, 0, Delta)

    ends = [
        minimize(negative, rng.standard_normal(2 * m * m), tol=1e-7) for _ in range(2)
    ]
    found = -min(end.fun for end in ends)
    assert worst.sigma[i] * (1 - 1e-6) < found <= worst.sigma[i] * (1 + 1e-12)


@given(seeds)
def test_for_one_channel_it_is_M_plus_rho_L(seed):
    problem, L = random_case(1, seed)
    response = L.frequency_response(problem.omega)
    rho_L = np.abs(problem.Q * response.ravel()) * problem.radius
    expected = np.abs(problem.M(response)).ravel() + rho_L
    np.testing.assert_allclose(worst_case(problem, L).sigma, expected, rtol=1e-12)


@given(sizes, st.integers(0, 4), seeds)
def test_a_radius_that_grows_makes_it_worse_and_none_is_that_of_the_plants(
    m, others, seed
):
    problem, L = random_case(m, seed, others=others)
    plants = worst_case(replace(problem, radius=None), L)
    assert plants.Delta is None
    levels = [
        worst_case(replace(problem, radius=factor * problem.radius), L).sigma
        for factor in (1e-13, 0.3, 1, 3)
    ]
    np.testing.assert_allclose(levels[0], plants.sigma, rtol=1e-10)
    grows = (problem.radius > 0) & (problem.Q != 0)
    for less, more in pairwise(levels):
        np.testing.assert_allclose(more[~grows], less[~grows], rtol=1e-10)
        assert np.all(more[grows] > less[grows])


def test_the_worst_of_many_plants_has_its_number():
    problem, L = random_case(2, 3, n=20, others=20)
    for radius in (
        None,
        problem.radius,
        20 * problem.radius,
    ):  # the last turns the order
        posed = replace(problem, radius=radius)
        worst = worst_case(posed, L)
        alone = [
            worst_case(replace(posed, plants=problem.plants[[k]]), L).sigma
            for k in range(21)
        ]
        np.testing.assert_allclose(worst.sigma, np.max(alone, axis=0), rtol=1e-12)
        named = np.array(alone)[worst.plant, np.arange(20)]
        np.testing.assert_allclose(named, worst.sigma, rtol=1e-12)


def given_as(L, problem):
    """A frequency response in the place of a filter."""
    return TwoSidedFilter(lambda omega: L, problem.channels, problem.Ts)


def test_a_Delta_is_found_where_two_directions_are_amplified_equally():
    """One is worst for M and the other for L, and only their sum is worst for both."""
    problem, _ = random_case(2, 0, n=4)
    M, L = np.diag([1.0, 0.2]), np.tile(np.diag([0.3, 0.9]), (4, 1, 1))
    P = np.tile((np.eye(2) - M) @ np.linalg.inv(L[0]), (4, 1, 1)).astype(complex)
    radius = np.array([0.5, 0.9, 1.0, 1.1])
    worst = worst_case(
        replace(problem, plants=P[None], Q=np.ones(4), radius=radius),
        given_as(L, problem),
    )
    np.testing.assert_allclose(worst.attained, worst.sigma, rtol=1e-12)
    x = np.linspace(0, np.pi / 2, 100_001)
    x = np.stack([np.cos(x), np.sin(x)])
    sums = np.linalg.norm(M @ x, axis=0) + np.outer(
        radius, np.linalg.norm(L[0] @ x, axis=0)
    )
    np.testing.assert_allclose(worst.sigma, sums.max(axis=1), rtol=1e-8)
