from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rods import BRASS, MATERIALS

from ilctools.models import frequency_response
from rodlib import Rod, exact_response, finite_volumes, midr
from rodlib.rod import modes


def test_slow_modes_are_those_of_the_analytic_rod():
    rod = Rod()
    exact, _, _ = modes(rod, np.arange(5))
    model, fine = (np.sort(midr(rod, n).poles().real)[:-6:-1] for n in (3, 8))
    np.testing.assert_allclose(model, exact, rtol=0, atol=5e-5)  # four decimals
    np.testing.assert_allclose(fine, exact, rtol=1e-9)
    assert np.all(model <= exact * (1 - 1e-9))  # Rayleigh and Ritz: never to the right


def test_exact_response_neither_overflows_nor_misses_its_pole():
    rod = Rod()
    assert np.isfinite(exact_response(rod, [1e6j, 1e3, -1e3 + 1j])).all()
    with pytest.raises(ValueError, match=r"s contains -0\.00381563"):
        exact_response(rod, [-rod.kappa_2 / rod.kappa_1])


@given(MATERIALS, st.tuples(*[st.floats(0, 0.05)] * 3))
@example(BRASS, BRASS.sensors)
def test_exact_response_is_the_sum_over_the_modes(rod, sensors):
    """Any number of sections and sensors."""
    rod, s = replace(rod, sensors=sensors), 1j * np.array([1e-4, 1e-3, 1e-2])
    exact = exact_response(rod, s)
    rates, B, C = modes(rod, np.arange(200_001))
    expected = np.array([C @ (B / (at - rates)[:, None]) for at in s])
    np.testing.assert_allclose(exact, expected, rtol=0, atol=1e-9 * np.abs(exact).max())


PAIR = Rod(sections=2, sensors=(0.0, 0.08, 0.16, 0.32))  # at both ends and on an edge


@pytest.mark.parametrize("rod", [BRASS, PAIR], ids=["brass", "pair"])
def test_error_falls_with_the_square_of_the_cells_and_at_once_with_the_degree(rod):
    omega = np.geomspace(1e-4, 1e-1, 30)
    exact = exact_response(rod, 1j * omega)[:, :, :-1]
    coarse, fine, polynomials = (
        np.abs(frequency_response(model, omega)[:, :, :-1] - exact).max() / np.abs(exact).max()
        for model in (finite_volumes(rod, 4), finite_volumes(rod, 8), midr(rod, 10))
    )
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.1)
    assert polynomials < 1e-5


@given(MATERIALS, st.tuples(*[st.floats(0, 0.05)] * 3), st.integers(1, 4))
def test_any_rod_is_stable_has_its_names_and_follows_the_air(rod, sensors, count):
    """And volumes never cool what is heated: off the diagonal of A, in B, C nothing is negative."""
    rod = replace(rod, sensors=sensors)
    np.testing.assert_allclose(exact_response(rod, [0.0])[0].real[:, -1], 1, rtol=1e-12)
    volumes = finite_volumes(rod, count)
    for model in (volumes, midr(rod, count)):
        assert model.input_labels == rod.inputs and model.output_labels == rod.outputs
        assert model.poles().real.max() < 0
        np.testing.assert_allclose(frequency_response(model, [0.0])[0][:, -1], 1, rtol=1e-8)
    volumes.A[np.diag_indices(volumes.nstates)] = 0
    assert min(volumes.A.min(), volumes.B.min(), volumes.C.min()) >= 0
