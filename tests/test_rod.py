from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rods import BRASS, MATERIALS

from rodlib import Rod, exact_response, midr


def test_slow_modes_are_those_of_the_analytic_rod():
    rod = Rod()
    waves = np.arange(5) * np.pi / rod.length
    exact = -(rod.kappa_2 + rod.conductivity * waves**2) / rod.kappa_1
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
