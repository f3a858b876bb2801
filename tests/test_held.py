import numpy as np
import pytest
from rods import modal_model

from rodlib import Rod, Specimen, exact_response, sampled_response


def aliased(rod, omega, Ts, most=3000):
    """Poisson's sum of the exact response behind a hold, over the aliases of omega.

    An entry falls as g / s for a sensor above the heated section; the sum of these is known.
    """
    s = 1j * (omega[:, None] + 2 * np.pi / Ts * np.arange(-most, most + 1))
    G = exact_response(rod, s.ravel()).reshape(*s.shape, len(rod.sensors), -1)
    section = rod.length / rod.sections
    above = np.clip(np.array(rod.sensors) // section, 0, rod.sections - 1)[:, None]
    g = (above == range(rod.sections)) / (rod.width * rod.height * section * rod.kappa_1)
    g = np.hstack([g, np.full((len(g), 1), rod.kappa_2 / rod.kappa_1)])
    s, z = s[:, :, None, None], np.exp(1j * omega * Ts)[:, None, None]
    aliases = (G / s - g / s**2).sum(axis=1)
    return (1 - 1 / z) / Ts * (aliases + g * Ts**2 * z / (z - 1) ** 2)


LARGE = Rod(length=1.3, conductivity=200.0, sections=6, sensors=(0.0, 0.3, 1.3))


@pytest.mark.parametrize(("rod", "Ts"), [(Rod(), 0.003), (Rod(), 30.0), (LARGE, 1.0)])
def test_sampled_response_is_the_sum_over_the_aliases(rod, Ts):
    omega = np.array([1e-3, 0.03, 0.4, 1.0]) * np.pi / Ts
    expected, found = aliased(rod, omega, Ts), sampled_response(rod, omega, Ts)
    assert found.shape == (4, len(rod.sensors), rod.sections + 1)
    for part in (slice(-1), slice(-1, None)):  # heat flows, K/W; the air, K/K
        error = np.abs(found - expected)[:, :, part].max(axis=(1, 2))
        assert np.all(error < 1e-10 * np.abs(expected[:, :, part]).max(axis=(1, 2)))


def test_the_sampled_rod_has_eight_zeros_outside_the_unit_circle():
    """docs/proofs.md: the winding number of the determinant of its pulse responses."""
    rod, n = Rod(), 2500
    model = modal_model(Specimen(rod, (1.0,) * 4), 1.0, 400)
    powers = np.diag(model.A) ** np.arange(n)[:, None]
    g = (powers[:, None] * model.C) @ model.B[:, [0, 2]]
    exact = exact_response(rod, [0.0])[0].real[:, [0, 2]]
    np.testing.assert_allclose(g.sum(axis=0), exact, rtol=1e-3)
    products = (np.convolve(g[:, 0, j], g[:, 1, 1 - j]) for j in (0, 1))
    determinant = np.subtract(*products)[:n]
    angle = np.linspace(0, 2 * np.pi, 100_001)
    on_circle = np.polynomial.polynomial.polyval(np.exp(1j * angle) / 1.02, determinant)
    assert abs(determinant[-1]) / 1.02**n < 1e-6 * np.abs(on_circle).min()
    assert round(np.diff(np.unwrap(np.angle(on_circle))).sum() / (2 * np.pi)) == 8
