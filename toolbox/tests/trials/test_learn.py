"""The loop of learning, whatever responds to w and however long the parts are."""

import numpy as np

from ilctools import ClosedLoop
from ilctools.trials.learn import learn


def test_a_reference_is_learned_in_parts_as_long_as_their_v():
    reference, asked = np.arange(10.0)[:, None], []

    def respond(w, now):
        asked.append((now.start, now.stop))
        return {"y": 2 * w}

    loop = ClosedLoop(Ts=1.0, outputs=["y"])
    v_after = lambda past, upcoming: np.full((4, 1), len(past))  # noqa: E731
    parts = learn(loop, respond, v_after, reference, past=[{}])
    assert asked == [(0, 4), (4, 8), (8, 10)]
    y = np.concatenate([part["y"] for part in parts])
    v = np.repeat([1, 2, 3], [4, 4, 2])[:, None]
    np.testing.assert_array_equal(y, 2 * (reference + v))  # (22)
