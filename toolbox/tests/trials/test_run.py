"""Trials against law and loop written out, and what they promise."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from plants import random_plant
from written_out import another, mixed, simulated

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    run_trials,
    trial_map,
    zero_phase_butterworth,
)

pytestmark = pytest.mark.filterwarnings("ignore:commands were", "ignore:the reference")
L = LearningFilter(0.4 * np.eye(2)[..., None] * [0, 0, 1], 1.0)


@pytest.mark.parametrize(("other", "learning"), [(False, True), (True, True), (True, False)])
def test_trials_are_those_of_the_law_and_the_loop_written_out(other, learning):
    """Around the model of the design, or a plant of another order, its signals in another one.

    With feedthrough, noise, a state and a v to begin with, and references that differ.
    """
    rng = np.random.default_rng(0)
    loop, reach = current_trial_loop(random_plant(rng), ["u1", "u2"]), 0.1 * rng.random((2, 2, 3))
    plant = another(loop.plant, rng) if other else loop.plant
    around = mixed(plant, rng) if other else None
    r, noise = rng.standard_normal((2, 3, 60, 2))
    d, x, v = rng.standard_normal((3, 60, 1)), np.ones(plant.nstates), r[0]
    law = Law(zero_phase_butterworth(2, 1.0, 1.0), LearningFilter(reach, 1.0), 5, 0.7)
    law = law if learning else replace(law, L=None)
    run = run_trials(loop, law, r, d, 3, plant=around, initial_state=x, noise=noise, v=v)
    v = v * (np.arange(60) < 55)[:, None]  # it rests
    for k in range(3):
        y, u, delta = simulated(loop, plant, r[k] + v, d[k], noise[k], x)
        expected = {"reference": r[k], "v": v, "y": y, "u": u, "delta": delta, "e": r[k] - y}
        for name, signal in expected.items():
            np.testing.assert_allclose(run[name][k], signal, atol=1e-9)
        if learning:
            v = 0.3 * v + 0.7 * law.Q.apply(v + law.L.apply(r[k] - y))  # (23), and it rests
            v[55:] = 0


def test_v_rests_and_converges_as_the_finite_trials_map_says(loop, Q):
    """v_{k+1} - v_k follows T of the certificate, which knows nothing of trials."""
    rest, reference = 15, np.random.default_rng(4).standard_normal((120, 2))
    v = run_trials(loop, Law(Q, L, rest=rest), reference, None, 5).v.values
    assert not v[:, 120 - rest :].any() and v[1:, 119 - rest].all()
    steps = np.diff(v.reshape(5, -1), axis=0)
    T, size = trial_map(loop.P, Q, L, 120, rest), np.abs(steps).max()
    for before, after in pairwise(steps):
        np.testing.assert_allclose(T.matvec(before), after, atol=1e-9 * size)
