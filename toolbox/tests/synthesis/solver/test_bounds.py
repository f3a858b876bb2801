"""The value of a bound, the largest singular value in the worst case."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from plants import random_response
from scipy.special import expit

from ilctools.evidence.robustness import within_radius
from ilctools.problem.pose import pose
from ilctools.synthesis.formulate import formulate


def bound_of(m, seed, radius=None):
    """A problem, its bound on M and the G of some filter."""
    P, Q, omega = random_response(seed, m, 6)
    problem = pose(P, Q, omega, 1.0, order=4, band=(0.01, 1), uncertainty=radius)
    program = formulate(problem).program
    x = np.random.default_rng(seed).standard_normal((len(program.rows), len(program.basis)))
    return problem, program.bounds[-1], program.matrices(x)[-1]


@given(st.integers(1, 4), st.integers(0, 999))
def test_the_value_is_the_largest_singular_value(m, seed):
    _, bound, G = bound_of(m, seed)
    sigma = np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)[:, 0]
    np.testing.assert_allclose(bound.value(G, bound.first_share(G)), sigma, rtol=1e-12)


@given(st.integers(1, 3), st.integers(0, 999))
def test_for_a_radius_the_least_value_over_the_shares_is_the_worst_case(m, seed):
    """Which evidence/test_robustness.py compares with searches."""
    problem, bound, G = bound_of(m, seed, np.linspace(0.05, 0.1, 6))
    Q, radius = problem.Q, problem.radius
    L = np.moveaxis(G[m:], -1, 0) / (Q * radius)[:, None, None]
    worst = within_radius(problem.P, Q, L, radius, 0.0)
    shares = [bound.first_share(G), *expit(np.linspace(-10, 10, 801))]
    values = np.array([bound.value(G, share * np.ones(6)) for share in shares])
    assert np.all(worst <= values * (1 + 1e-12))
    np.testing.assert_allclose(values.min(axis=0), worst, rtol=1e-4)
