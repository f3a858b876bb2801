"""Noise of samples: how often it is found, and how often without being there."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ilctools import synthesise, zero_phase_butterworth
from ilctools.response.roughness import FALSE_ALARM, scatter

OMEGA = np.geomspace(1e-3, np.pi, 120)


def test_false_alarms_are_as_rare_as_stated():
    """Samples whose fourth differences are white have signs as the null hypothesis says."""
    rng, alarms, draws = np.random.default_rng(1), 0, 1500
    for _ in range(draws):
        P = rng.standard_normal((60, 2)) @ [1, 1j]
        for _ in range(4):
            P = np.cumsum(P)
        alarms += scatter(np.arange(60.0), P[:, None, None], np.abs(P)) > 0
    assert 0 < alarms <= 3 * FALSE_ALARM * draws


@given(st.integers(0, 9999))
def test_a_smooth_plant_does_not_scatter_and_noise_does(seed):
    """Two resonances that the lines show and a gain of any size; of noise, the RMS."""
    rng = np.random.default_rng(seed)
    s = 1j * OMEGA
    place, damping = 10 ** rng.uniform(-2, 0, (2, 2)), rng.uniform(0.2, 1, (2, 2))
    P = 10.0 ** rng.integers(-9, 9) / (s + 0.1)[:, None, None]
    P = P / (1 + 2 * damping * s[:, None, None] / place + (s[:, None, None] / place) ** 2)
    assert scatter(OMEGA, P) == 0
    size = np.linalg.norm(P, 2, axis=(1, 2))[:, None, None]
    noise = rng.standard_normal((*P.shape, 2)) @ [1, 1j] * 0.02
    expected = np.sqrt(np.mean(np.linalg.norm(noise, 2, axis=(1, 2)) ** 2))
    assert scatter(OMEGA, P + size * noise) == pytest.approx(expected, rel=0.2)
    assert scatter(OMEGA, P + size * noise, np.zeros(120)) == 0
    rounded = size * (np.round(P / size, 3))
    assert scatter(OMEGA, rounded) == 0
    assert scatter(OMEGA[:5], P[:5] + size[:5] * noise[:5]) == 0


def test_a_noisy_table_warns_and_one_with_a_radius_does_not():
    Q, lag = zero_phase_butterworth(2, 0.3, 1.0), control.ss(0.9, 0.1, 1, 0, 1.0)
    exact = lag(np.exp(1j * OMEGA))
    noise = 0.03 * np.random.default_rng(2).standard_normal((120, 2)) @ [1, 1j]
    P = (exact * (1 + noise))[:, None, None]
    asked = {"objective": "peak", "L_max": 20.0, "order": 5}
    with pytest.warns(match="P scatters from line to line by 0.03"):
        synthesise(P, Q, OMEGA, 1.0, **asked)
    sure = synthesise(P, Q, OMEGA, 1.0, uncertainty=0.12 * np.abs(exact), **asked)
    assert not sure.certificate.warnings
