"""Delays of inputs, which correlations show."""

import numpy as np
import pytest
from records import group_of, held, steps
from scipy.signal import lfilter

from ilctools.measurement.arx.delay import with_delays


def late_lag(seed, excite, N=600):
    """A lag of T samples behind a delay, under noise, and the delay."""
    rng = np.random.default_rng(seed)
    delay, T = rng.integers(60, 150), rng.uniform(10, 40)
    pole, u = np.exp(-1 / T), excite(rng, N)
    y = lfilter(np.append(np.zeros(delay), 1 - pole), [1, -pole], u)
    y = y + 0.03 * rng.standard_normal(N)
    return [group_of(y[None], u[None])], delay


@pytest.mark.parametrize(
    ("seed", "excite"),
    [
        (0, held),  # by the correlation of the moves alone: that of the signals is 3 samples late
        (8, steps),  # by that of the signals alone: the moves of y are noise
        (1, steps),  # by both
    ],
)
def test_a_long_delay_is_found(seed, excite):
    """Up to 10 % before the truth, or as much behind it as noise hides: a fiftieth."""
    groups, delay = late_lag(seed, excite)
    fit = with_delays(groups, True, np.zeros(1, int))
    assert 0.9 * delay < fit.data.layout.knots_of_B[0][0] < 1.02 * delay


def test_no_delay_is_looked_for_where_the_answer_is_at_once():
    """Nor one before that which is known."""
    rng = np.random.default_rng(0)
    u = held(rng, 300)
    y = lfilter([0, 0.3], [1, -0.7], u) + 0.03 * rng.standard_normal(300)
    groups = [group_of(y[None], u[None])]
    fit = with_delays(groups, True, np.zeros(1, int))
    assert fit.data.layout.knots_of_B[0][0] == 0
    known = with_delays(groups, True, np.ones(1, int))
    assert known.data.layout.knots_of_B[0][0] == 1
