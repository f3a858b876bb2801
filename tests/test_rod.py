from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rods import BRASS, MATERIALS

from ilctools.models import frequency_response
from rodlib import Rod, exact_response, midr
from rodlib.rod import bernstein_basis


def test_slow_modes_are_those_of_the_analytic_rod():
    rod = Rod()
    waves = np.arange(5) * np.pi / rod.length
    exact = -(rod.kappa_2 + rod.conductivity * waves**2) / rod.kappa_1
    model, fine = (np.sort(midr(rod, n).poles().real)[:-6:-1] for n in (3, 8))
    np.testing.assert_allclose(model, exact, rtol=0, atol=5e-5)  # four decimals
    np.testing.assert_allclose(fine, exact, rtol=1e-9)
    assert np.all(model <= exact * (1 - 1e-9))  # Rayleigh and Ritz: never to the right


@pytest.mark.parametrize("rod", [Rod(), BRASS], ids=["paper's", "brass"])
def test_model_converges_to_the_exact_response_with_the_degree(rod):
    omega = np.array([1e-4, 1e-2, 5e-2])
    exact = exact_response(rod, 1j * omega)
    errors = [
        np.abs(frequency_response(midr(rod, degree), omega) - exact).max()
        for degree in (1, 3, 5, 9)
    ]
    assert all(finer < coarser / 3 for coarser, finer in pairwise(errors))
    assert errors[-1] < 1e-7


def test_exact_response_neither_overflows_nor_misses_its_pole():
    rod = Rod()
    assert np.isfinite(exact_response(rod, [1e6j, 1e3, -1e3 + 1j])).all()
    with pytest.raises(ValueError, match=r"s contains -0\.00381563"):
        exact_response(rod, [-rod.kappa_2 / rod.kappa_1])


@given(MATERIALS, st.tuples(*[st.floats(0, 0.05)] * 3))
@example(BRASS, BRASS.sensors)
def test_exact_response_is_the_sum_over_the_modes(rod, sensors):
    """Any number of sections and sensors: the heat of each section, in cosines along the rod."""
    rod, s = replace(rod, sensors=sensors), 1j * np.array([1e-4, 1e-3, 1e-2])
    n = np.arange(1, 200_001)
    wave = n * np.pi / rod.length
    rate = rod.kappa_2 + rod.conductivity * wave**2
    shapes = np.cos(np.outer(sensors, wave))
    shares = 2 * np.diff(np.sin(np.outer(rod.edges, wave)), axis=0) / wave * rod.sections
    shares /= rod.width * rod.height * rod.length**2
    uniform = 1 / (rod.width * rod.height * rod.length * (rod.kappa_1 * s + rod.kappa_2))
    modes = np.array([(shapes / (rod.kappa_1 * at + rate)) @ shares.T for at in s])
    exact = exact_response(rod, s)[:, :, :-1]
    np.testing.assert_allclose(
        exact, uniform[:, None, None] + modes, rtol=0, atol=1e-9 * np.abs(exact).max()
    )


@given(MATERIALS, st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_energy_is_conserved_for_any_rod_state_and_input(rod, degree, seed):
    model = midr(rod, degree)
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal(model.nstates), rng.standard_normal(model.ninputs)
    volume = bernstein_basis(rod, degree).antiderivative()(rod.length) * rod.width * rod.height
    stored = rod.kappa_1 * volume @ (model.A @ x + model.B @ u)
    supplied = u[:-1].sum() + rod.kappa_2 * (volume.sum() * u[-1] - volume @ x)
    scale = rod.kappa_1 * np.abs(volume) @ (np.abs(model.A) @ np.abs(x) + np.abs(model.B @ u))
    assert abs(stored - supplied) < 1e-10 * scale


@given(MATERIALS, st.floats(-0.02, 1), st.floats(0.001, 1))
def test_determinant_of_the_papers_rod_is_that_of_the_proof(rod, real, imaginary):
    """From Q1 and Q3 to the paper's sensors, for any material; notebook 1 derives it."""
    rod = replace(rod, sections=4, sensors=(3 / 8 * rod.length, 7 / 8 * rod.length))
    s = complex(real, imaginary) * rod.kappa_2 / rod.kappa_1  # of the order of the slowest pole
    gamma = np.sqrt((rod.kappa_1 * s + rod.kappa_2) / rod.conductivity)
    g = 4 / (rod.width * rod.height * rod.length * rod.conductivity * gamma**2)
    X = gamma * rod.length / 4
    derived = g**2 * np.sinh(X) ** 2 / (4 * np.cosh(X) * np.cosh(2 * X))
    determinant = np.linalg.det(exact_response(rod, [s])[0][:, [0, 2]])
    scale = np.abs(exact_response(rod, [s])[0][:, [0, 2]]).max() ** 2
    assert abs(determinant - derived) < 1e-9 * scale


def test_the_rod_is_minimum_phase():
    """Along half disks the determinant winds as often as it has zeros in them; it has no poles."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20001)
    for radius in (1.0, 3.0):
        arc, diameter = (radius * np.exp(1j * angle), np.linspace(radius, -radius, 20001) * 1j)
        boundary = np.concatenate([arc, diameter])
        exact = np.linalg.det(exact_response(Rod(), boundary)[:, :, [0, 2]])
        model = midr(Rod())[:, ["Q1", "Q3"]]
        sI = boundary[:, None, None] * np.eye(model.nstates)
        cubic = np.linalg.det(model.C @ np.linalg.solve(sI - model.A, model.B.astype(complex)))
        for values, zeros in ((exact, 0), (cubic, 2)):  # the cubic model has its two
            steps = np.angle(values[1:] / values[:-1])
            assert np.abs(steps).max() < 1
            assert steps.sum() / (2 * np.pi) == pytest.approx(zeros, abs=1e-3)
