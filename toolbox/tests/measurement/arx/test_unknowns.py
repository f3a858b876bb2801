"""The unknowns of a regression: their lags, and the responses that they make."""

from dataclasses import replace

import numpy as np
import pytest
from records import trials_of

from ilctools.measurement.arx import unknowns as module
from ilctools.measurement.arx.trials import SeriesKey
from ilctools.measurement.arx.unknowns import Kind, coefficients, knots_between, layout_of, waves


@pytest.mark.parametrize("direct", [True, False])
def test_lags_begin_at_the_delay_or_a_sample_later_but_not_of_a_disturbance(direct):
    group = replace(trials_of(1, m=3), known=1)
    layout = layout_of([group], direct, np.array([0, 7, 2]))
    later = 0 if direct else 1
    assert [knots[0] for knots in layout.knots_of_B] == [later, 7 + later, 2]
    assert layout.knots_of_A[0] == 1 and layout.lags == 15


def test_a_start_decays_from_the_latest_delay_on_or_is_left_out(monkeypatch):
    groups, delays = [trials_of(1)], np.array([0, 7])
    layout = layout_of(groups, True, delays)
    start = layout.where(Kind.START, SeriesKey(0, 0))
    np.testing.assert_array_equal(layout.lag[start][:9], [*[0] * 8, 1])
    np.testing.assert_array_equal(layout.knots_of_start[:9], range(9))
    assert layout.skipped == 0
    monkeypatch.setattr(module, "MOST_OF_STARTS", 3)
    layout = layout_of(groups, True, delays)
    assert Kind.START not in layout.kind and layout.skipped == layout.lags


def test_a_response_by_its_increments_is_that_of_its_coefficients():
    """Straight between knots that are up to 21 lags apart, and its spectrum."""
    knots = knots_between(3, 200, 40, 8)
    assert knots[0] == 3 and knots[-1] == 200 and np.diff(knots)[[0, -2]].tolist() == [1, 18]
    x = np.random.default_rng(0).standard_normal(len(knots))
    g = coefficients(x, knots, 230)
    corners = np.append(np.cumsum(x[::-1])[::-1], 0)  # zero after the last
    straight = np.interp(np.arange(230), np.append(knots, 201), corners, left=0, right=0)
    np.testing.assert_allclose(g, straight, atol=1e-12)
    omega = np.array([0.0, 0.01, 1.0, np.pi])
    spectrum = np.exp(-1j * np.outer(omega, np.arange(230))) @ g
    np.testing.assert_allclose(waves(knots, omega) @ x, spectrum, atol=1e-10)
