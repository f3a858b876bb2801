"""One sample of a rig, step by step: read, check, command, limit, observe, apply, record."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from plants import LOOPS, TASK, Axis, bump

from ilctools import ClosedLoop, Law, LearningFilter, record, zero_phase_butterworth
from ilctools.errors import RigError
from ilctools.loop.closed import controller
from ilctools.rigs.controlled import ControlledRig
from ilctools.rigs.description import described

STAGE, TANKS = LOOPS["stage"](), LOOPS["tanks"]()


class Scripted:
    """Shows the outputs that it is given, one after the other, and notes what it is asked."""

    def __init__(self, shown, **attributes):
        self.shown, self.calls = iter(shown), []
        vars(self).update(attributes)

    def read(self):
        self.calls.append("read")
        return next(self.shown)

    def apply(self, inputs):
        self.calls.append(np.array(inputs))


def controlled(loop, shown, law=None, stop=None, decimals=None, **attributes):
    reference = bump(20, np.ones(len(loop.outputs)))[None]
    rig = Scripted(shown, **attributes)
    return rig, ControlledRig(described(rig, loop, reference, law, stop, decimals))


@pytest.mark.parametrize("loop", [STAGE, TANKS], ids=["stage", "tanks"])
@pytest.mark.parametrize("limited", [True, False])
def test_samples_are_those_of_observer_and_feedback(loop, limited):
    """By the matrices of (16) and (18), whose observer is informed of what was applied."""
    rng, m = np.random.default_rng(0), len(loop.outputs)
    y, w = rng.standard_normal((2, 12, m))
    limits = dict.fromkeys(loop.commands, (-0.3, 0.2)) if limited else {}
    law = Law(zero_phase_butterworth(2, 0.1 / loop.Ts, loop.Ts), None, limits=limits, loop=loop)
    free = dict.fromkeys([*loop.outputs, *loop.commands])  # no limits of stop
    rig, running = controlled(loop, y, law, free)
    A, B, K = controller(loop)
    state = np.zeros(len(A))
    for p in range(12):
        signals = running.sample(w[p], [])
        u = loop.N @ w[p] - K @ state  # (18)
        applied = np.clip(u, -0.3, 0.2) if limited else u
        scale = 1e-12 * np.abs(u).max()
        np.testing.assert_array_equal(signals["y"], y[p])
        np.testing.assert_allclose(signals["delta"], state[-m:], atol=1e-12 * np.abs(state).max())
        np.testing.assert_allclose(signals["u"], u, atol=scale)
        np.testing.assert_allclose(rig.calls[-1], applied, atol=scale)
        assert ("applied" in signals) == limited and "disturbance" not in signals
        state = A @ state + B @ applied + loop.KL @ y[p]  # (16)
    assert rig.calls[::2] == ["read"] * 12 and len(rig.calls) == 24


@pytest.mark.parametrize(("times", "late"), [
    ([0.0, 0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 0.0]),
    ([5.0, 5.1, 5.35, 5.3], [0.0, 0.0, 0.15, 0.0]),  # it does not wait for a late one
])  # fmt: skip
def test_samples_are_due_from_the_first_one_of_a_trial_on(times, late):
    loop, ticks = ClosedLoop(Ts=0.1, outputs=["x"]), iter(times)
    _, running = controlled(loop, [[0.0]] * 4, clock=lambda: next(ticks))

    class Bar:
        update = staticmethod(lambda: None)

    running.drive(1, np.zeros((4, 1)), np.zeros((4, 0)), Bar)
    np.testing.assert_allclose(running.late, late, atol=1e-12)
    assert running.place == "trial 1, sample 4"


def test_a_reading_of_one_output_may_be_a_number_and_of_several_may_not():
    """As `law.next` takes signals of one channel without an axis for it, but not of several."""
    law, plain, listed = TASK["law"], Axis(), record(Axis(), **TASK, trials=3)
    for number in (float, np.float64, lambda x: np.array([x])[0], np.array):
        plain.x, plain.read = 0.0, lambda number=number: number(plain.x)
        assert record(plain, **TASK, trials=3).identical(listed)
    v, e = (listed[name].values[0] for name in ("v", "e"))
    assert np.array_equal(law.next(v[:, 0], e[:, 0]), law.next(v, e)[:, 0])
    two = ClosedLoop(Ts=0.01, outputs=["x", "y"])
    law = Law(law.Q, LearningFilter(0.5 * np.eye(2)[..., None], 0.01))
    with pytest.raises(RigError, match=r"reading of x, y has shape \(\), but must have shape \(2,"):
        record(plain, two, law, np.ones((200, 2)))
    with pytest.raises(ValueError, match=r"v has shape \(200,\), but must have shape"):
        law.next(v[:, 0], e[:, 0])


@pytest.mark.parametrize(
    ("method", "bad", "name"),
    [
        *(("read", bad, "reading of x") for bad in ([np.nan], np.nan, [0.0, 0.0], None, "0.0")),
        ("clock", np.nan, "clock"),
        ("wind", np.nan, "wind"),
        ("wind", None, "wind"),
    ],
)
def test_an_error_of_a_reading_says_in_which_trial_and_sample(method, bad, name):
    """In its text, which a log of a service has without notes."""
    good = {"read": [[0.0]] * 206, "clock": np.arange(206) * 0.01, "wind": [0.0] * 207}
    given = {"wind": lambda: 0.0, method: partial(next, iter(good[method]), bad)}

    class Windy(Axis):
        measured = property(lambda axis: {"wind": axis.wind()})  # one more, to see if it is there

    loop = replace(TASK["loop"], disturbances=["wind"])
    with pytest.raises(RigError) as error:
        record(Windy(**given), **TASK | {"loop": loop}, pause=0)
    assert str(error.value).startswith(f"trial 2, sample 7: {name} ")
