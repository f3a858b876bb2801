"""The gamma of Lemma 1, for plants in whatever form they are known."""

import numpy as np
import pytest
from plants import stage
from scipy.integrate import quad

from rodlib import (
    LearningFilter,
    convergence,
    current_trial_loop,
    rate,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.alternatives import p_type
from rodlib.paper import published


@pytest.fixture(scope="module")
def printed():
    return LearningFilter(published.matrix("L_diagonal"), 1.0)


def by_the_book(P, q, L):
    M = q[:, None, None] * (np.eye(P.shape[1]) - P @ L)
    return np.linalg.svd(M, compute_uv=False)[:, 0]


def test_the_printed_filter_converges_at_the_rate_that_it_is_designed_for(
    loop, Q, omega, printed
):
    P, q = loop.frequency_response(omega), Q.frequency_response(omega)
    expected = by_the_book(P, q, printed.frequency_response(omega))
    for plant in (loop, loop.P, P):
        result = convergence(plant, Q, printed, omega)
        np.testing.assert_allclose(result.sigma, expected, rtol=1e-9)
    gamma, where = rate(loop, q, printed, omega)
    assert gamma == pytest.approx(expected.max(), rel=1e-9)
    assert gamma.ndim == where.ndim == 0
    assert where == omega[np.flatnonzero(expected > gamma * (1 - 1e-6))[0]]


def test_of_several_plants_each_has_a_rate(loop, Q, omega, printed):
    P = loop.frequency_response(omega)
    several = convergence([loop, 1.2 * P, 0.5 * P], Q, printed, omega)
    for k, factor in enumerate((1, 1.2, 0.5)):
        alone = convergence(factor * P, Q, printed, omega)
        assert several.gamma[k] == pytest.approx(alone.gamma, rel=1e-9)
        assert several.at[k] == alone.at
    stacked = convergence(np.stack([P, 1.2 * P]), Q, printed, omega)
    assert stacked.sigma.shape == (2, 1000)
    assert rate([P], Q, printed, omega).gamma.shape == (1,)


def test_many_plants_are_computed_in_parts(loop, Q, printed):
    omega, factors = np.linspace(0.1, 3, 1700), np.linspace(0.5, 2, 7)
    P = loop.frequency_response(omega)
    every = convergence(factors[:, None, None, None] * P, Q, printed, omega)
    for k, factor in enumerate(factors):
        alone = convergence(factor * P, Q, printed, omega)
        np.testing.assert_allclose(every.sigma[k], alone.sigma, rtol=1e-12)
        assert every.spectral_radius[k] == pytest.approx(alone.spectral_radius)


def test_any_plant_and_any_learning_operator_have_one():
    loop = current_trial_loop(stage(), ["F"])
    Q, L = zero_phase_butterworth(Ts=loop.Ts), p_type(0.3, 2, 1, loop.Ts)
    omega = np.linspace(0, np.pi / loop.Ts, 50)
    P = loop.frequency_response(omega)
    expected = by_the_book(P, Q.frequency_response(omega), L.frequency_response(omega))
    result = convergence(loop, Q, L, omega)
    np.testing.assert_allclose(result.sigma, expected, rtol=1e-9)
    with pytest.raises(ValueError, match=r"P\.dt"):
        rate(loop, Q, p_type(0.3, 2, 1, loop.Ts / 2), omega)
    with pytest.raises(ValueError, match="L acts on 2 channels"):
        rate(loop, Q, p_type(0.3, 2, 2, loop.Ts), omega)


def test_the_mean_over_the_band_does_not_depend_on_the_grid(loop, Q, printed):
    """Against adaptive quadrature; a kink between corners costs the square of their distance."""
    band = (1e-4, 0.02)

    def sigma(place):
        return convergence(loop, Q, printed, [np.exp(place), 1.0]).sigma[0]

    area, _ = quad(sigma, *np.log(band), epsabs=1e-8, limit=200)
    exact = area / np.log(band[1] / band[0])
    for grid in (np.geomspace(1e-4, np.pi, 100), np.linspace(0, np.pi, 20001)):
        mean = convergence(loop, Q, printed, grid).mean(band)
        assert mean == pytest.approx(exact, abs=1e-3)
    fine = convergence(loop, Q, printed, np.geomspace(*band, 2001))
    assert fine.mean() == pytest.approx(exact, abs=1e-6)
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 100), 1.0)
    mean = convergence(loop, Q, design.filter, np.geomspace(*band, 4001)).mean()
    assert design.certificate.mean_M == pytest.approx(mean, abs=1e-3)
    assert f"over the band: {design.certificate.mean_M:.4f}" in repr(design)
    for wrong in [(0, 0.02), (0.02, 1e-4), (1e-5, 0.02)]:
        with pytest.raises(ValueError, match="band = "):
            fine.mean(wrong)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_the_spectral_radius_is_that_of_numpys_eigenvalues(m):
    rng = np.random.default_rng(m)
    omega, P = np.linspace(0.1, 3, 30), rng.standard_normal((4, 30, m, m, 2)) @ [1, 1j]
    L = LearningFilter(rng.standard_normal((m, m, 3)), 1.0)
    q = rng.uniform(size=30)
    M = q[:, None, None] * (np.eye(m) - P @ L.frequency_response(omega))
    expected = np.abs(np.linalg.eigvals(M)).max(axis=(1, 2))
    result = convergence(P, q, L, omega)
    np.testing.assert_allclose(result.spectral_radius, expected, rtol=1e-9)
    assert np.all(result.spectral_radius <= result.gamma * (1 + 1e-12))
    assert (m == 1) == np.allclose(result.spectral_radius, result.gamma, rtol=1e-9)


def test_trials_that_converge_may_grow_before():
    """One channel feeds the other: in the first trials, by hand, the error is 3 times as large."""
    M, omega = np.array([[0.5, 3.0], [0.0, 0.5]]), np.array([0.1, 0.2, 0.3, 0.4])
    P = np.exp(-1j * omega)[:, None, None] * (np.eye(2) - M)  # for L = q
    result = convergence(P, np.ones(4), p_type(1.0, 1, 2, 1.0), omega)
    assert result.spectral_radius == pytest.approx(0.5)
    assert result.gamma > np.linalg.norm(M @ [0, 1]) > 3
    assert np.linalg.norm(np.linalg.matrix_power(M, 20)) < 1e-3
