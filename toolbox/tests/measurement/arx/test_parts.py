"""Slow and resonant parts: by difference equations and by sums."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ilctools.measurement.arx.parts import LARGER_THAN_SLOW, Parts

N, ANGLE = 400, 0.7
PARTS = Parts.of(N, np.array([ANGLE]))


def test_parts_answer_as_difference_equations_do():
    """One unknown of each slow part; the cosines of three rates, and then the sines."""
    u = np.random.default_rng(0).standard_normal(N)
    found = PARTS.answers(u)
    assert PARTS.size == len(found) == 2 + 2 * 3
    for row, rate in zip(found, (1, 3), strict=False):
        p = np.exp(-rate / N)
        np.testing.assert_allclose(row, lfilter([0, 1 - p], [1, -p], u), atol=1e-12)
    for k, rate in enumerate((2, 4, 8)):
        r = np.exp(-rate / N)
        g, a = 40 * (1 - r), [1, -2 * r * np.cos(ANGLE), r**2]
        cosine = lfilter([0, g, -g * r * np.cos(ANGLE)], a, u)
        sine = lfilter([0, 0, g * r * np.sin(ANGLE)], a, u)
        np.testing.assert_allclose(found[[2 + k, 5 + k]], [cosine, sine], atol=1e-9)


def test_impulse_and_frequency_responses_are_those_of_the_answers():
    omega, long = np.linspace(0, np.pi, 30), 40 * N
    pulse = np.eye(1, long)[0]
    impulses = PARTS.impulses(long - 1)
    np.testing.assert_allclose(impulses, PARTS.answers(pulse)[:, 1:], atol=1e-12)
    sums = np.exp(-1j * np.outer(omega, np.arange(1, long))) @ impulses.T
    np.testing.assert_allclose(PARTS.waves(omega), sums, atol=1e-9)


def test_the_peaks_are_as_large_as_stated():
    """One at rest; for resonant parts, the size of the output relative to that of a slow part."""
    at_rest, at_peak = np.abs(PARTS.waves(np.array([0.0, ANGLE])))
    np.testing.assert_allclose(at_rest[:2], 1.0)
    assert at_peak[2:] == pytest.approx(LARGER_THAN_SLOW, rel=0.05)
