import numpy as np
import pytest

from rodlib import Rod, exact_response, sampled_response


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
