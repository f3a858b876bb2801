"""What every loop has in common, ours or a user's; what each is: test_closed."""

import pickle
from dataclasses import dataclass, replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from plants import LOOPS, altered, axes, bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    frequency_response,
    run_trials,
    zero_phase_butterworth,
)
from ilctools.loop.closed import Feedback, Loop, same_loop

pytestmark = pytest.mark.filterwarnings("ignore:commands were", "ignore:the reference")


SET_POINTS = ["set x", "set y"]


@dataclass(frozen=True)
class Halving:
    """A loop of a user's own, whose controller halves v before it adds it to the reference."""

    P: control.StateSpace
    Ts, one_for_one = 0.1, True
    outputs, controls, disturbances = ["x", "y"], [], []
    inputs = learned = commands = SET_POINTS
    units = dict.fromkeys(outputs + inputs, "mm")

    @property
    def P_v(self):
        return self.P * 0.5

    @property
    def P_r(self):
        return self.P

    def w(self, reference, v):
        return reference + v / 2

    def asked(self, signals):
        return self.w(signals["reference"], signals["v"])

    def realised(self, v, u, applied):
        return v + 2 * (applied - u)

    def feedback(self):
        return Feedback(np.zeros((2, 2)), np.eye(2) / 2)

    def model(self, plant=None):
        return self.P if plant is None else plant

    def frequency_response(self, omega, plant=None):
        return frequency_response(self.model(plant), omega) / 2


TORQUE = control.ss(
    axes().A, np.hstack([axes().B, np.ones((2, 1))]), axes().C, 0, 0.1,
    inputs=["set x", "set y", "torque"], outputs=["x", "y"],
)  # fmt: skip
CASES = {
    **{name: make() for name, make in LOOPS.items()},
    "not ours": ClosedLoop(axes()),
    "at an input of its own": ClosedLoop(
        TORQUE, references={"set x": "x", "set y": "y"}, learned=["torque"]
    ),
    "a user's": Halving(axes()),
}


@pytest.fixture(params=CASES)
def loop(request):
    return CASES[request.param]


def without_learning(loop, limits=None):
    Q = zero_phase_butterworth(2, 0.3 / loop.Ts, loop.Ts)
    return Law(Q, None, limits=limits, loop=loop)


def test_it_keeps_the_contract_and_travels(loop):
    there = pickle.loads(pickle.dumps(loop))
    assert isinstance(there, Loop) and same_loop(loop, there)
    assert sum(same_loop(there, other) for other in CASES.values()) == 1
    assert not isinstance(loop.P_v, Loop)
    assert {*loop.learned} <= {*loop.inputs}


def test_its_response_is_that_of_a_long_trial_also_around_another_plant(loop):
    """To a pulse in each channel of v, beside a reference."""
    ours = hasattr(loop, "plant")
    other = altered(loop.plant if ours else loop.P, A=0.99, B=1.1)
    samples, omega = 2500, np.linspace(0, np.pi / loop.Ts, 9)
    turns = np.exp(-1j * np.outer(omega * loop.Ts, np.arange(samples)))
    reference = bump(samples, np.ones(len(loop.outputs)))
    for plant in (None, other):
        G, law = loop.frequency_response(omega, plant), without_learning(loop)
        free = run_trials(loop, law, reference, None, 1, plant=plant).y.values[0]
        for j in range(len(loop.learned)):
            v = np.zeros((samples, len(loop.learned)))
            v[0, j] = 1.0
            y = run_trials(loop, law, reference, None, 1, v=v, plant=plant).y.values[0]
            assert_allclose(turns @ (y - free), G[..., j], rtol=0, atol=1e-6 * np.abs(G).max())


def test_a_trial_cut_off_is_one_of_the_v_that_was_realised(loop):
    """What is asked for with it is what was applied, around another plant and with noise, too."""
    random, samples = np.random.default_rng(1), 80
    other = altered(loop.plant, A=0.98, B=1.1) if hasattr(loop, "plant") else None
    reference = bump(samples, np.ones(len(loop.outputs)))
    v = bump(samples, np.full(len(loop.learned), 0.3))
    trials = {"plant": other, "noise": 0.01 * random.standard_normal((1, *reference.shape))}
    trials |= {"disturbance": 0.1 * random.standard_normal((samples, len(loop.disturbances)))}
    free = run_trials(loop, without_learning(loop), reference, trials=1, v=v, **trials)
    size = np.abs(np.asarray(loop.asked(free))[0]).max(axis=0)
    moved = [name for name in loop.commands if name in loop.learned or name in loop.controls]
    limits = {n: (-s / 2, s / 2) for n, s in zip(loop.commands, size, strict=True) if n in moved}
    cut = run_trials(loop, without_learning(loop, limits), reference, trials=1, v=v, **trials)
    law = without_learning(loop, limits)
    u = np.asarray(loop.asked(cut))[0]
    applied = law.actuators.follow(u)
    assert np.abs(applied - u).max() > 0.1 * size.min()
    v = loop.realised(cut.v[0].values, u, applied)
    again = run_trials(loop, without_learning(loop), reference, trials=1, v=v, **trials)
    assert_allclose(again.y, cut.y, rtol=0, atol=1e-9 * np.abs(cut.y).max().item())
    assert_allclose(np.asarray(loop.asked(again))[0], applied, rtol=0, atol=1e-9 * size.max())
    assert_array_equal(loop.realised(v, u, u), v)


@dataclass(frozen=True)
class Proportional:
    """A learning operator of a user's own."""

    gain: float
    Ts, rows, columns = 0.1, 2, 2
    weight_of_change = 0.0025

    def frequency_response(self, omega):
        return np.tile(self.gain * np.eye(2), (len(omega), 1, 1))

    def apply(self, signal):
        return self.gain * signal

    apply_transposed = apply


def test_a_loop_and_an_operator_of_a_users_own_learn_as_ours():
    """Its v is twice that of the same loop without halving, within limits, too."""
    own, ours = Halving(axes()), ClosedLoop(axes(), units={"x": "mm", "y": "mm"})
    Q, reference = zero_phase_butterworth(2, 3.0, 0.1), bump(150, [2.0, -1.0])
    L, half = Proportional(0.2), LearningFilter(0.1 * np.eye(2)[..., None], 0.1, first=0)
    for limits in ({}, {"set x": (-0.1, 0.5)}):
        law = Law(Q, L, limits=limits)
        run = run_trials(own, law, reference, trials=4)
        expected = run_trials(ours, replace(law, L=half), reference, trials=4)
        size = np.abs(expected.v).max().item()
        assert_allclose(run.v, 2 * expected.v, rtol=0, atol=1e-6 * size)
        assert_allclose(run.y, expected.y, rtol=0, atol=1e-6)
    rate = convergence(own, Q, L).rate
    assert rate == pytest.approx(convergence(ours, Q, half).rate) and rate < 1
