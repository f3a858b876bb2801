"""The gamma of Lemma 1, for plants in whatever form they are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from ilctools import LearningFilter, convergence

# A filter with which the sigma of the paper's loop has a kink in the band
L_KINKED = LearningFilter(np.array([[[0.5], [0.1]], [[-0.1], [1.4]]]), 1.0)


def test_the_mean_over_the_band_does_not_depend_on_the_grid(loop, Q):
    """Against adaptive quadrature; a kink between corners costs the square of their distance."""
    band = (1e-4, 0.02)

    def sigma(place):
        return convergence(loop, Q, L_KINKED, [np.exp(place), 1.0]).sigma[0]

    area, _ = quad(sigma, *np.log(band), epsabs=1e-6, limit=200)
    exact = area / np.log(band[1] / band[0])
    for grid in (np.geomspace(1e-4, np.pi, 100), np.linspace(0, np.pi, 20001)):
        mean = convergence(loop, Q, L_KINKED, grid).mean(band)
        assert mean == pytest.approx(exact, abs=1e-3)
    fine = convergence(loop, Q, L_KINKED, np.geomspace(*band, 2001))
    assert fine.mean() == pytest.approx(exact, abs=1e-6)
    for wrong in [(0, 0.02), (0.02, 1e-4), (1e-5, 0.02)]:
        with pytest.raises(ValueError, match="band = "):
            fine.mean(wrong)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_rate_and_spectral_radius_are_those_of_numpy(m):
    rng = np.random.default_rng(m)
    omega, P = np.linspace(0.1, 3, 30), rng.standard_normal((4, 30, m, m, 2)) @ [1, 1j]
    L = LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    q = rng.uniform(size=30)
    M = q[:, None, None] * (np.eye(m) - P @ L.frequency_response(omega))  # by the book
    result = convergence(P, q, L, omega)
    radius = np.abs(np.linalg.eigvals(M)).max(axis=(1, 2))
    assert_allclose(result.spectral_radius, radius, rtol=1e-9)
    sigma = np.linalg.matrix_norm(M, ord=2)
    assert_allclose(result.sigma, sigma, rtol=1e-9)
    assert_allclose(result.rate, sigma.max(axis=1), rtol=1e-9)
    assert result.at[0] == omega[sigma[0].argmax()]
