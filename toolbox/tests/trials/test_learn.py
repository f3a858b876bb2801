"""The loop of learning, whatever responds to w and however long the parts are."""

import numpy as np

from ilctools import ClosedLoop, Law, LearningFilter, zero_phase_butterworth
from ilctools.trials.learn import learn, next_v

REFERENCE = np.arange(10.0)[:, None]


def test_a_reference_is_learned_in_parts_as_long_as_their_v():
    asked = []

    def respond(w, now):
        asked.append((now.start, now.stop))
        return {"y": 2 * w}

    loop = ClosedLoop(Ts=1.0, outputs=["y"])
    v_after = lambda past, upcoming: np.full((4, 1), len(past))  # noqa: E731
    parts = learn(loop, respond, v_after, REFERENCE, past=[{}])
    assert asked == [(0, 4), (4, 8), (8, 10)]
    y = np.concatenate([part["y"] for part in parts])
    v = np.repeat([1, 2, 3], [4, 4, 2])[:, None]
    np.testing.assert_array_equal(y, 2 * (REFERENCE + v))  # (22)


def test_after_a_reset_v_follows_from_the_last_trial_alone():
    law = Law(zero_phase_butterworth(2, 0.3, 1.0), LearningFilter([[[0.5]]], 1.0))
    first = np.ones((10, 1))
    assert next_v(law, first, True, "law", []) is first
    last = {"v": first, "reference": REFERENCE, "y": 0.3 * REFERENCE}
    expected = law.Q.apply(first + law.L.apply(0.7 * REFERENCE))  # (23)
    np.testing.assert_allclose(next_v(law, first, True, "law", [{}, last]), expected)
