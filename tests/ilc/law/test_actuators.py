"""What actuators make of commands."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import tanks

from rodlib import ClosedLoop, current_trial_loop
from rodlib.ilc.law.actuators import Actuators

LOOP = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
COMMANDS = st.lists(
    st.lists(st.floats(-9, 9), min_size=3, max_size=3), min_size=1, max_size=20
)


def test_they_are_those_of_the_commands_of_the_loop():
    own = Actuators.of("limits", {"pump C": (0, 5), "pump A": (-1, 1, 0.5)}, LOOP)
    np.testing.assert_array_equal(own.lowest, [-1, -np.inf, 0])
    np.testing.assert_array_equal(own.highest, [1, np.inf, 5])
    np.testing.assert_array_equal(
        own.step, [1, np.inf, np.inf]
    )  # 0.5 a second, two seconds each
    closed = ClosedLoop(LOOP.P)
    np.testing.assert_array_equal(
        Actuators.of("limits", {"w2": (0, 5)}, closed).highest, [np.inf, 5, np.inf]
    )
    for limits in (
        {"pump A": (1, 0)},
        {"pump A": (0, 1, 0)},
        {"leak": (0, 1)},
        {"pump A": 3},
    ):
        with pytest.raises(ValueError, match="limits"):
            Actuators.of("limits", limits, LOOP)


@given(COMMANDS, st.floats(-3, 3), st.floats(0.1, 4), st.floats(0.01, 2))
def test_what_is_applied_is_within_and_the_nearest_at_each_step(
    commands, low, width, rate
):
    commands = np.array(commands)
    own = Actuators.of(
        "limits", {"pump A": (low, low + width, rate), "pump B": (-1, 1)}, LOOP
    )
    applied = own.follow(commands)
    first, step = applied[:, 0], rate * LOOP.Ts
    assert first.min() >= low and first.max() <= low + width
    assert np.abs(np.diff(first)).max(initial=0) <= step * (1 + 1e-12)
    before = np.append(np.inf, first[:-1])
    for value, last, asked in zip(first, before, commands[:, 0], strict=True):
        inside = np.linspace(low, low + width, 201)  # of all that it could have been
        inside = inside[np.abs(inside - last) <= step] if np.isfinite(last) else inside
        assert abs(value - asked) <= np.abs(inside - asked).min(initial=np.inf) + 1e-12
    np.testing.assert_array_equal(applied[:, 1], np.clip(commands[:, 1], -1, 1))
    np.testing.assert_array_equal(applied[:, 2], commands[:, 2])
    assert own.can(applied) and own.can(commands) == np.allclose(
        applied, commands, 0, 1e-6 * width
    )
    np.testing.assert_array_equal(
        own.follow(np.stack([commands, applied])), [applied, applied]
    )
