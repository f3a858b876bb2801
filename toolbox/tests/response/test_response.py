"""What is known of P between its samples, and above the last one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

from ilctools.response.door import response_of


def test_between_the_samples_are_splines_and_the_radius_by_straight_lines(loop):
    omega, added = np.geomspace(1e-4, np.pi / 2, 40), np.array([1e-5, 0.2, 0.5, 3.0])
    first, at = loop.frequency_response(omega), loop.frequency_response(added)
    radius = 0.01 * omega
    response = response_of([first, loop, 1.1 * first], omega, 1.0, radius)
    lines = np.interp(np.log(added[1:3]), np.log(omega), radius)
    P, r = response.anywhere(1, added)
    assert_allclose(P, at, rtol=1e-12)
    assert_allclose(r, [0, *lines, 0], rtol=1e-12)
    inside = CubicSpline(np.log(omega), first)(np.log(added[1:3]))
    for k, gain in ((0, 1.0), (2, 1.1)):
        P, r = response.anywhere(k, added)
        assert_allclose(P[1:3], gain * inside, rtol=1e-12)
        assert not P[3].any() and r[3] == response.beyond  # where samples have ended
        assert np.all(r[1:3] >= lines)
    size = 1.1 * np.linalg.norm(first[-1], 2) + radius[-1]
    assert response.beyond == pytest.approx(size, rel=1e-12)


def test_what_the_radius_covers_counts_once(loop):
    omega = np.geomspace(1e-4, np.pi, 20)
    P, bent = loop.frequency_response(omega), np.linspace(0, 1, 20) ** 4
    alone = response_of(P, omega, 1.0).samples[0].missed
    for radius in (bent, 0.1 * alone):
        missed = response_of(P, omega, 1.0, radius).samples[0].missed
        assert_allclose(missed, np.maximum(alone - radius, 0), atol=1e-15)
    assert missed.max() > 0
