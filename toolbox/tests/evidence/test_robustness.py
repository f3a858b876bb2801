"""The worst case over plants and a radius, against samples; that it is attained: test_formulate."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import complex_normal, sigma_of_M
from problems import posed

from ilctools import LearningFilter, worst_case


@given(st.integers(1, 3), st.integers(1, 5), st.integers(0, 999))
def test_no_plant_within_the_radius_is_worse(m, plants, seed):
    """Of random plants; Q and the radius are zero once each."""
    rng, omega = np.random.default_rng(seed), np.linspace(0.1, 3, 5)
    P, L = complex_normal(rng, plants, 5, m, m), LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    Q, radius = rng.uniform(-1, 1, 5), rng.uniform(0, 1, 5)
    Q[0] = radius[1] = 0
    problem = posed([*P], Q, omega, 1.0, uncertainty=radius, order=3, band=(0.1, 3))
    worst = worst_case(problem, L)
    assert worst.sigma[worst.frequency] == worst.sigma.max() and worst.plant in range(plants)
    Delta = complex_normal(rng, 10, *P.shape)
    Delta *= (radius / np.linalg.matrix_norm(Delta, ord=2))[..., None, None]
    sigma = sigma_of_M(omega, P + Delta, Q, L)
    assert np.all(sigma <= worst.sigma * (1 + 1e-12))
    if m == 1:
        added = np.abs(Q * radius * L.frequency_response(omega)[:, 0, 0])
        expected = sigma_of_M(omega, P, Q, L).max(axis=0) + added
        assert_allclose(worst.sigma, expected, rtol=1e-6)
