import control
import numpy as np
import pytest
from limited import error
from numpy.testing import assert_allclose
from plants import bump, lag

from ilctools.law.error_bound import ErrorBound
from ilctools.models import from_rest


@pytest.mark.parametrize("samples", [1, 2, 7, 100, 211])
def test_no_error_within_the_radius_moves_an_output_further(samples):
    """Errors of P's own dynamics and of rank one; a radius that jumps, and one that falls."""
    rng, angles = np.random.default_rng(samples), np.linspace(0.01, np.pi, 300)
    P = control.append(lag(), lag(0.5))
    for radius in (np.where(angles < 0.5, 0.3, 0.05), 0.1 / (1 + 20 * angles)):
        bound, reached = ErrorBound(angles, radius, samples), 0
        for kind in (0, 1, 1, 1):
            Delta = error(rng, kind, P, angles, radius)
            d = rng.normal(size=(samples, 2)) * bump(samples, np.ones(2)) + 1e-3
            moved, rho = np.abs(from_rest(Delta, d)).max(axis=1), bound.over_time(d)
            assert np.all(moved <= rho * (1 + 1e-12))
            reached = max(reached, np.max(moved / rho))
        assert reached > 0.05 or samples < 7


def test_the_bound_is_that_of_the_integral_but_for_some_percent():
    """(Ts / 2 pi) integral of r ||D||, by ever finer sums, for a radius without corners."""
    samples, d = 200, bump(200, [1.0, -0.3])
    angles = np.linspace(0, np.pi, 500)
    bound = ErrorBound(angles, 0.2 + 0.1 * np.cos(angles), samples)
    points = 2 * np.pi * np.arange(2**18) / 2**18
    D = np.linalg.norm(np.fft.fft(d, 2**18, axis=0), axis=1)
    integral = np.mean((0.2 + 0.1 * np.cos(points)) * D)
    assert integral <= bound.of(d) <= 1.04 * integral
    constant = ErrorBound(np.zeros(1), np.ones(1), samples)
    h, M = (samples - 1) // 2, constant.padded
    n, m = samples - 1 - h, M - samples - h
    assert_allclose(constant.of(d), (m + n) / (m - n) * np.mean(D), rtol=1e-3)


def test_what_comes_later_does_not_count():
    bound, d = ErrorBound(np.zeros(1), np.full(1, 0.2), 160), np.zeros((160, 1))
    d[40:] = bump(120, [1.0])
    rho = bound.over_time(d)
    assert not rho[:41].any() and np.all(np.diff(rho[41:]) >= -1e-15)
    assert rho[-1] == pytest.approx(bound.of(d)) and rho[50] < 0.8 * rho[-1]
    assert not bound.over_time(0 * d).any()
