"""Learning within what the actuators follow, on a drive, three tanks and a furnace with a delay."""

from dataclasses import replace

import control
import cvxpy as cp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from plants import LOOPS, PUMPS, bump, lifted
from scipy.optimize import lsq_linear

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    run_trials,
    zero_phase_butterworth,
)

pytestmark = pytest.mark.filterwarnings("ignore:commands were", "ignore:the reference")


def case_of(loop, cutoff, samples, heights, limits):
    """A law for a loop, and a reference that exceeds its limits."""
    L = LearningFilter(0.3 * np.eye(len(heights))[..., None], loop.Ts)
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    return Law(Q, L, limits=limits, loop=loop), bump(samples, heights)


TANKS = case_of(LOOPS["tanks"](), 0.4, 60, [3.0, 2.0, 4.0], dict.fromkeys(PUMPS, (-10.0, 25.0)))
ON_W = replace(
    TANKS[0], loop=ClosedLoop(TANKS[0].loop.P), limits={"w1": (0.0, 2.5), "w3": (-0.5, 4.2)}
)
DRIVE = control.ss([[0.98, 9e4], [-3.6e-7, 0.8]], [[0.02], [3.6e-7]], [[1, 0]], 0, 0.01)
CASES = {
    "a state of 1e-7": case_of(ClosedLoop(DRIVE), 40.0, 200, [1.0], {"u[0]": (-0.01, 0.01)}),
    "tanks": TANKS,
    "furnace": case_of(LOOPS["furnace"](), 0.5, 100, [4.0], {"valve": (0.0, 1.2)}),
    "not ours": (ON_W, TANKS[1]),
}


def to_commands(loop, samples):
    """The matrix from w to the commands."""
    P = loop.P
    if isinstance(loop, ClosedLoop):
        return np.eye(samples * P.ninputs)
    return lifted(control.ss(P.A, P.B, -loop.Ks, loop.N, loop.Ts), samples)


def trial(case):
    """The signals v, e, u of a trial that was cut off."""
    law, reference = CASES[case]
    run = run_trials(law.loop, law, reference, trials=1)
    u = run.reference + run.v if isinstance(law.loop, ClosedLoop) else run.u
    return run.v.values[0], run.e.values[0], u.values[0]


@pytest.mark.parametrize("case", CASES)
def test_it_is_the_nearest_of_all_that_can_be_followed(case):
    """By CVXPY, on whole-trial matrices: no states, another solver."""
    law, rest, (v, e, u) = CASES[case][0], 5, trial(case)
    loop, actuators = law.loop, law.actuators
    applied = actuators.follow(u)
    assert np.abs(applied - u).max() > 0.01 * np.abs(u).max()
    following = replace(law, rest=rest).next(v, e, u)
    v_applied = loop.realised(v, u, applied)
    target = replace(law, rest=rest, limits=None).next(v_applied, e)
    (samples, m), active = v.shape, len(v) - rest
    P, S = lifted(loop.P, samples), to_commands(loop, samples)

    def commands(v):
        change = S @ (v - v_applied.ravel())
        return cp.reshape(applied.ravel() + change, (samples, m), order="C")[:active]

    z = cp.Variable(samples * m)
    constraints = [z[active * m :] == 0]
    for j in np.flatnonzero(np.isfinite(actuators.lowest)):
        u_j = commands(z)[:, j]
        constraints += [u_j >= actuators.lowest[j], u_j <= actuators.highest[j]]
    off = z - target.ravel()
    cost = cp.sum_squares(P @ off) + law.L.weight_of_change * cp.sum_squares(off)
    problem = cp.Problem(cp.Minimize(cost), constraints)
    problem.solve(cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-10)
    least, best = problem.value, z.value
    z.value = following.ravel()
    assert cost.value == pytest.approx(least, rel=1e-4)  # inside by a millionth
    assert np.abs(z.value - best).max() < 2e-3 * np.abs(best).max()
    assert actuators.can(commands(z).value) and not np.any(following[active:])


def test_signals_of_a_millionth_are_learned_as_those_of_one():
    """The solver's tolerances are absolute."""
    law, reference = CASES["not ours"]
    limits = {name: (1e-6 * low, 1e-6 * high) for name, (low, high) in law.limits.items()}
    pairs = (law, reference), (replace(law, limits=limits), 1e-6 * reference)
    whole, small = (run_trials(each.loop, each, r, trials=3).e.values for each, r in pairs)
    np.testing.assert_allclose(1e6 * small, whole, rtol=0, atol=1e-5 * np.abs(whole).max())


@pytest.mark.parametrize("case", ["tanks", "not ours"])
def test_where_nothing_is_cut_off_it_is_the_law(case):
    law, reference = CASES[case]
    law = replace(law, rest=3, gain=0.7)
    run, same = (
        run_trials(law.loop, replace(law, limits=limits), reference, trials=3)
        for limits in (None, dict.fromkeys(law.limits, (-1e3, 1e3)))
    )
    for name in run:
        assert_array_equal(same[name], run[name])


def test_norm_optimal_learning_falls_to_what_no_v_within_the_limits_can_beat():
    """The best by scipy, in the commands: there the limits are a box, the matrix is the plant's."""
    law, reference = CASES["furnace"]
    loop, samples = law.loop, len(reference)
    L, Q = NormOptimal(loop.P, 1e-3, samples), zero_phase_butterworth(1, 3.1415, 1.0)
    run = run_trials(loop, replace(law, Q=Q, L=L), reference, trials=8)
    G = lifted(loop.plant[:, loop.controls], samples)
    best = 2 * lsq_linear(G, reference.ravel(), law.limits["valve"], tol=1e-12).cost
    power = (run.e.values**2).sum(axis=(1, 2))
    assert np.all(np.diff(power[1:]) < 1e-6 * power[0])  # the first was cut off
    assert best * (1 - 1e-9) <= power[-1] < best + 2e-4 * power[0]


def test_without_a_model_commands_are_cut_off():
    reference = TANKS[1]
    law = replace(ON_W, rest=4, loop=ClosedLoop(Ts=ON_W.Ts, outputs=ON_W.outputs))
    e = 0.2 * reference
    v = law.next(0 * reference, e, reference)
    low, high = [0, -np.inf, -0.5], [2.5, np.inf, 4.2]
    first = np.clip(reference, low, high) - reference  # what trial 1 had for v
    w = np.clip(reference + replace(law, limits=None).next(first, e), low, high)
    assert_allclose(v[:-4], (w - reference)[:-4], atol=1e-12)
    assert not v[-4:].any()


FOLLOWED = {"pump A": (-2.0, 2.0), "pump B": (-3.0, 3.0)}  # by a rig
OWN = {"pump A": (-1.0, 1.0)}
ON_RIG = [(None, FOLLOWED), ({}, {}), (OWN, FOLLOWED | OWN)]


@pytest.mark.parametrize(("limits", "expected"), ON_RIG)
def test_on_a_rig_its_limits_hold_where_the_law_states_none_and_never_for_none_at_all(
    limits, expected
):
    law = replace(TANKS[0], limits=limits)
    assert ("limits=the rig's" in repr(law)) == (limits is None)
    on_rig = law.on_rig(FOLLOWED)
    assert on_rig.limits == on_rig.known_limits == expected
    assert on_rig.on_rig(FOLLOWED).limits == expected
    assert law.on_rig({}).known_limits == law.known_limits == (limits or {})
    assert (law.actuators is None) == (not limits)
