"""Each design in a case whose answer is known, on the rod and on plants that are not."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_loop
from plants import LOOPS, lifted

from ilctools import NormOptimal, zero_phase_butterworth
from ilctools.alternatives import (
    full_information,
    generalised_plant,
    gradient,
    h_infinity,
    p_type,
    pd_type,
    stable_inversion,
    zero_phase_inversion,
)
from ilctools.alternatives.inversion import outer_zeros
from ilctools.models import frequency_response

PLANTS = {"rod": paper_loop} | LOOPS


@pytest.fixture(scope="module", params=["rod", "tanks", "furnace"])
def P(request):
    return PLANTS[request.param]().P


def grid(Ts, n=60):
    return np.geomspace(1e-4, 0.99, n) * np.pi / Ts


def as_matrix(L, samples):
    m = L.channels
    units = np.eye(samples * m).reshape(-1, samples, m)
    return L.apply(units).reshape(samples * m, -1).T


def random_stable(seed, n=4, m=2):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (m, n), (m, m)))
    return control.ss(A, B, C, D, 0.5)


def test_p_type_and_pd_type_add_the_error_and_its_slope():
    time = np.arange(50) * 0.1
    e = np.stack([np.sin(time), time**2], axis=1)
    np.testing.assert_allclose(p_type(0.5, 3, 2, 0.1).apply(e)[:-3], 0.5 * e[3:])
    slope = (e[4:] - e[3:-1]) / 0.1
    np.testing.assert_allclose(pd_type(0.5, 2.0, 4, 2, 0.1).apply(e)[:-4], 0.5 * e[4:] + 2 * slope)


def test_gradient_is_the_adjoint_of_a_trial_and_converges_at_its_rate(P):
    model, omega = random_stable(0), grid(P.dt)
    adjoint = as_matrix(gradient(model, 0.3), 40)
    np.testing.assert_allclose(adjoint, 0.3 * lifted(model, 40).T, atol=1e-9)
    response = frequency_response(P, omega)
    sigma = np.linalg.svd(response, compute_uv=False)
    step = 1.2 / sigma.max() ** 2
    M = np.eye(P.noutputs) - response @ gradient(P, step).frequency_response(omega)
    rate = np.abs(1 - step * sigma**2).max(axis=1)
    np.testing.assert_allclose(np.linalg.norm(M, 2, axis=(1, 2)), rate, atol=1e-12)


@given(st.integers(0, 99))
def test_of_a_minimum_phase_plant_it_is_the_inverse_of_a_trial(seed):
    """Two zeros inside the circle, no delay: the inverse runs forward, and no end is in its way."""
    zeros = np.random.default_rng(seed).uniform(-0.8, 0.8, 2)
    P = control.ss(control.tf(np.poly(zeros), np.poly([0.5, 0.9]), 1.0))
    product = as_matrix(stable_inversion(P), 50) @ lifted(P, 50)
    np.testing.assert_allclose(product, np.eye(50), atol=1e-6)


def test_both_inversions_are_what_they_are_called(P):
    """One inverts; the other has zero phase, and unit gain at zero, channel by channel."""
    omega, cutoff = np.append(0, grid(P.dt)), 0.2 / P.dt
    response = frequency_response(P, omega)
    whole = stable_inversion(P, 0.7).frequency_response(omega)
    one = np.broadcast_to(np.eye(P.noutputs), whole.shape)
    np.testing.assert_allclose(response @ whole, 0.7 * one, atol=1e-9)
    L = zero_phase_inversion(P).frequency_response(omega)
    PL = np.einsum("nii,nii->ni", response, L)
    np.testing.assert_allclose(PL[0], 1, atol=1e-9)
    np.testing.assert_allclose(PL.imag, 0, atol=1e-7 * np.abs(PL).max())
    assert PL.real.min() > 0 and not np.any(L * (1 - one))
    F = zero_phase_butterworth(2, cutoff, P.dt).frequency_response(omega)[:, None, None]
    cut = stable_inversion(P, 0.7, cutoff), zero_phase_inversion(P, cutoff=cutoff)
    for design, before in zip(cut, (whole, L), strict=True):
        np.testing.assert_allclose(design.frequency_response(omega), F * before)


def test_zero_phase_gain_and_reach_of_a_known_zero():
    """P = z^-2 (z - 2): one zero outside, so that L is (2 - z) (1 / 1) q^2 ... and finite."""
    P = control.ss(control.tf([1, -2], [1, 0, 0], 1.0))
    omega = grid(1.0)
    np.testing.assert_allclose(outer_zeros(P), 2, atol=1e-9)
    z = np.exp(1j * omega)
    L = zero_phase_inversion(P).frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(L, z**2 * (1 / z - 2), atol=1e-9)


def test_the_rods_model_has_the_zeros_of_the_paper_in_each_channel(loop):
    for i in range(2):
        np.testing.assert_allclose(outer_zeros(loop.P[i, i]), 1.1065, atol=5e-5)


def test_norm_optimal_solves_the_lifted_problem():
    """By dense algebra, for a plant with feedthrough, and for one with a delay."""
    weight = 0.03
    for P in (random_stable(1), LOOPS["furnace"]().P):
        G, L = lifted(P, 60), NormOptimal(P, weight, 60)
        dense = np.linalg.solve(G.T @ G + weight * np.eye(len(G)), G.T)
        np.testing.assert_allclose(as_matrix(L, 60), dense, atol=1e-9)


def test_norm_optimal_tends_to_its_response_far_from_the_ends():
    P = LOOPS["tanks"]().P
    samples, middle, m = 2000, 1000, P.noutputs
    L, pulse = NormOptimal(P, 0.1, samples), np.zeros((m, samples, m))
    pulse[range(m), middle, range(m)] = 1
    omega = grid(P.dt, 9)
    turns = np.exp(-1j * np.outer(omega * P.dt, np.arange(samples) - middle))
    response = np.einsum("nt,jti->nij", turns, L.apply(pulse))
    np.testing.assert_allclose(response, L.frequency_response(omega), atol=1e-6)


def test_h_infinity_keeps_its_level(P):
    Q = zero_phase_butterworth(2, 0.1 / P.dt, P.dt)
    omega, corner = np.append(0, grid(P.dt, 300)), 0.02 / P.dt
    q, response = Q.frequency_response(omega), frequency_response(P, omega)
    s = 1j * np.tan(omega * P.dt / 2) / np.tan(corner * P.dt / 2)
    for emphasis, W in ((1.0, np.ones(len(s))), (5.0, np.abs((s + 5) / (s + 1)))):
        L = h_infinity(P, Q, 2.0, 0.01, 6, emphasis, corner).frequency_response(omega)
        M = (W * q)[:, None, None] * (np.eye(P.noutputs) - response @ L)
        stacked = np.concatenate([M, 0.01 * L], axis=1)
        assert np.linalg.norm(stacked, 2, axis=(1, 2)).max() < 2.0


@pytest.mark.parametrize("preview", [1, 9])
def test_the_least_level_is_that_of_interpolation(preview):
    """P has a zero at 1.3, where K P is zero and z^-preview W is not: no level is below it.

    With one such zero, no delay and no price of K, that is the least level, by the maximum
    principle (G. Zames, Feedback and optimal sensitivity, 1981).
    """
    P = control.ss(control.tf([1, -1.3], [1, -0.6], 1.0))
    Q = zero_phase_butterworth(1, 0.3, 1.0)
    b, a = Q.sections[0, :3], Q.sections[0, 3:]
    W = (np.polyval(b, 1.3) / np.polyval(a, 1.3)) ** 2
    least = W * 1.3**-preview
    h_infinity(P, Q, 1.001 * least, 1e-7, preview)
    with pytest.raises(ValueError, match=r"level = .* is not reached by any filter"):
        h_infinity(P, Q, 0.999 * least, 1e-7, preview)


def test_the_least_level_is_that_of_hinfsyn():
    """In continuous time, after a bilinear transform, which keeps the norm.

    It does not always reach the level that it claims; for this plant it does.
    """
    pytest.importorskip("slycot")
    P = random_stable(5)
    Q = zero_phase_butterworth(1, 1.0, 0.5)
    plant = generalised_plant(P, Q, 0.3, 2)
    m, I = 2, np.eye(plant.nstates)  # noqa: E741
    C = np.vstack([plant.C, np.zeros((m, len(I)))])
    D = np.vstack([plant.D, np.eye(m, 2 * m)])  # e itself is what K sees
    X = np.linalg.inv(plant.A + I)
    B, C, D = np.sqrt(2) * X @ plant.B, np.sqrt(2) * C @ X, D - C @ X @ plant.B
    _, reached, least, _ = control.hinfsyn(control.ss(X @ (plant.A - I), B, C, D), m, m)
    sigma = np.linalg.norm(frequency_response(reached, np.geomspace(1e-4, 1e4, 2000)), 2, (1, 2))
    assert sigma.max() == pytest.approx(least, rel=1e-4)
    full_information(plant, m, 1.01 * least)
    with pytest.raises(ValueError, match="is not reached"):
        full_information(plant, m, 0.99 * least)


DIFFERENCE = control.ss(control.tf([1, -1], [1, 0], 1.0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda P, Q: pd_type(1.0, 1.0, 1, 1, 1.0), "ahead = 1"),
        (lambda P, Q: stable_inversion(P, 1.5), "gain = 1.5"),
        (lambda P, Q: stable_inversion(P[:, :1]), "P has 1 inputs"),
        (lambda P, Q: gradient(control.ss(2, 1, 1, 0, 1.0), 1), "modulus 2"),
        (lambda P, Q: NormOptimal(P, 1, 10).apply(np.ones((9, 2))), "signal"),
        (lambda P, Q: h_infinity(P, Q, 1, 1, 5, 2.0), "emphasis = 2.0"),
        (lambda P, Q: zero_phase_inversion(DIFFERENCE), "zero at frequency zero"),
    ],
)
def test_arguments_are_checked(loop, Q, call, message):
    with pytest.raises(ValueError, match=message):
        call(loop.P, Q)
