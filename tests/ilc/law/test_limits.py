"""Learning within what the actuators follow, on a stage, three tanks and a furnace with a delay."""

import control
import cvxpy as cp
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import furnace, stage, tanks
from scipy.linalg import eigh
from scipy.optimize import lsq_linear

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    current_trial_loop,
    rate,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.law.limits import WEIGHT, Actuators, realised
from rodlib.ilc.models import impulse_response


def bump(samples, heights):
    """Forth and back between rests."""
    phase = np.clip((np.arange(samples) / samples - 0.2) / 0.5, 0, 1)[:, None]
    return np.sin(np.pi * phase) ** 2 * heights


def made(loop, cutoff, samples, heights, limits):
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    omega = np.geomspace(1e-3, 1, 100) * np.pi / loop.Ts
    bounds = {"M_max": 0.95, "L_max": 20.0, "band": (omega[0], cutoff / 3)}
    L = synthesise(loop, Q, omega, order=16, **bounds).filter
    return loop, Q, L, bump(samples, heights), limits


PUMPS = ["pump A", "pump B", "pump C"]
CASES = {
    "stage": made(  # mm and N
        current_trial_loop(stage(), ["F"], sizes={"x": 1.0, "F": 3.0}), 300.0, 120, [2.0],
        {"F": (-9.0, 6.0)}),
    "tanks": made(  # cm and ml/s
        current_trial_loop(tanks(), PUMPS), 0.4, 60, [3.0, 2.0, 4.0],
        dict.fromkeys(PUMPS, (-10.0, 25.0))),
    "furnace": made(
        current_trial_loop(furnace(12)), 0.5, 100, [4.0], {"valve": (0.0, 1.2)}),
}  # fmt: skip
CASES["stage, rates"] = (*CASES["stage"][:4], {"F": (-9.0, 9.0, 400.0)})
ON_W = ClosedLoop(CASES["tanks"][0].P)
CASES["not our controller"] = (
    ON_W,
    *CASES["tanks"][1:4],
    {"w1": (0.0, 2.5), "w3": (-0.5, 4.2)},
)
EACH = pytest.mark.parametrize("case", CASES)


def lifted(system, samples):
    """The matrix of a whole trial, from its impulse response."""
    h = impulse_response(system, samples)
    p, m = h.shape[1:]
    G = np.zeros((samples, p, samples, m))
    for k in range(samples):
        G[k:, :, k] = h[: samples - k]
    return G.reshape(samples * p, samples * m)


def to_commands(loop):
    """From w to the commands."""
    if isinstance(loop, ClosedLoop):
        return control.ss([], [], [], np.eye(len(loop.outputs)), loop.Ts)
    P = loop.P
    return control.ss(P.A, P.B, -loop.Ks, loop.N, loop.Ts)


def trial(case):
    """A trial that was cut off, and the limits as arrays."""
    loop, Q, L, reference, limits = CASES[case]
    run = run_trials(loop, Law(Q, L, limits=limits), reference, trials=1)
    u = (run.reference + run.v if isinstance(loop, ClosedLoop) else run.u).values[0]
    return run.v.values[0], run.e.values[0], u, Actuators.of(limits, loop)


@EACH
@pytest.mark.parametrize("rest", [0, 5])
def test_it_is_the_nearest_of_all_that_can_be_followed(case, rest):
    """By CVXPY, on whole-trial matrices: no states, another solver."""
    loop, Q, L, _, limits = CASES[case]
    v, e, u, own = trial(case)
    applied = own.follow(u)
    assert np.abs(applied - u).max() > 0.01 * np.abs(u).max()
    found = Law(Q, L, rest=rest, limits=limits, loop=loop).next(v, e, u)
    v_done = realised(loop, v, u, applied)
    wanted = Law(Q, L, rest=rest).next(v_done, e)
    samples, m = v.shape
    P, S = lifted(loop.P, samples), lifted(to_commands(loop), samples)
    z = cp.Variable(samples * m)
    commands = cp.reshape(
        applied.ravel() + S @ (z - v_done.ravel()), (samples, m), order="C"
    )
    off, kept, end = z - wanted.ravel(), [], samples - rest
    for j in range(m):
        if np.isfinite(own.lowest[j]):
            kept += [
                commands[:end, j] >= own.lowest[j],
                commands[:end, j] <= own.highest[j],
            ]
        if np.isfinite(own.step[j]):
            kept += [cp.abs(cp.diff(commands[:end, j])) <= own.step[j]]
    kept += [z[end * m :] == 0] if rest else []
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(P @ off) + WEIGHT * cp.sum_squares(off)), kept
    )
    problem.solve(cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-10)
    gone = (found - wanted).ravel()
    cost = np.sum((P @ gone) ** 2) + WEIGHT * gone @ gone
    assert cost == pytest.approx(
        problem.value, rel=1e-4
    )  # it stays inside by a millionth
    assert np.abs(found.ravel() - z.value).max() < 2e-3 * np.abs(found).max()
    will = (applied.ravel() + S @ (found - v_done).ravel()).reshape(samples, m)
    assert own.can(will[:end]) and not np.any(found[end:])


@EACH
def test_where_nothing_is_cut_off_it_is_the_law(case):
    loop, Q, L, reference, limits = CASES[case]
    wide = {name: (-1e3, 1e3) for name in limits}
    v, e, u, _ = trial(case)
    np.testing.assert_array_equal(
        Law(Q, L, rest=3, gain=0.7, limits=wide, loop=loop).next(v, e, u),
        Law(Q, L, rest=3, gain=0.7).next(v, e),
    )
    plain = run_trials(loop, Law(Q, L), reference, trials=3)
    same = run_trials(loop, Law(Q, L, limits=wide), reference, trials=3)
    assert same.drop_vars("applied", errors="ignore").identical(plain)
    assert "applied" not in same or same.applied.equals(same.u)


@pytest.mark.parametrize("case", ["stage", "tanks", "furnace", "stage, rates"])
def test_a_trial_cut_off_is_one_of_the_v_that_was_realised(case):
    """Around another plant, with noise and a disturbance."""
    loop, Q, _, reference, limits = CASES[case]
    random = np.random.default_rng(1)
    plant = loop.plant
    other = control.ss(0.98 * plant.A, 1.1 * plant.B, plant.C, 0, plant.dt,
                       inputs=plant.input_labels, outputs=plant.output_labels)  # fmt: skip
    disturbance = 0.1 * random.standard_normal((len(reference), len(loop.disturbances)))
    noise = 0.01 * random.standard_normal((1, *reference.shape))
    given = {"disturbance": disturbance, "plant": other, "noise": noise, "trials": 1}
    cut = run_trials(loop, Law(Q, None, limits=limits), reference, **given)
    assert np.abs(cut.applied - cut.u).max() > 0
    v = realised(loop, cut.v[0], cut.u[0].values, cut.applied[0].values)
    free = run_trials(loop, Law(Q, None), reference, **given, v=v)
    size = np.abs(cut.u.values).max()
    np.testing.assert_allclose(free.y, cut.y, atol=1e-9 * np.abs(cut.y).max())
    np.testing.assert_allclose(free.u, cut.applied, atol=1e-9 * size)
    np.testing.assert_allclose(free.delta, cut.delta, atol=1e-9 * size)


@EACH
def test_an_observer_that_is_told_estimates_no_disturbance_where_there_is_none(case):
    loop, Q, L, reference, limits = CASES[case]
    run = run_trials(loop, Law(Q, L, limits=limits), reference, trials=4)
    if "u" not in run:
        return
    own = Actuators.of(limits, loop)
    assert not own.can(run.u.values[0]) and own.can(run.applied.values)
    assert np.abs(run.delta).max() < 1e-8 * np.abs(run.u).max()
    for k in (
        1,
        2,
        3,
    ):  # the model is exact, so the next trials keep what was asked of them
        assert own.can(run.u.values[k])
        np.testing.assert_allclose(
            run.applied[k], run.u[k], atol=1e-7 * np.abs(run.u).max()
        )


@given(st.integers(0, 10**6), st.floats(0.01, 10))
@settings(max_examples=20, deadline=None)
def test_no_two_signals_get_more_distant(seed, size):
    """In the norm of ||P v||^2 + weight ||v||^2, which the proof needs."""
    loop, Q, _, _, limits = CASES["tanks"]
    samples, random = 60, np.random.default_rng(seed)
    P = loop.P
    still = LearningFilter(
        np.zeros((3, 3, 1)), loop.Ts
    )  # so that Q v is what is asked for
    pair = size * np.cumsum(random.standard_normal((2, samples, 3)), axis=1)
    zero, at_rest = np.zeros((samples, 3)), np.zeros((samples, 3))
    wanted, kept = [], []
    for v in pair:
        u = (lifted(to_commands(loop), samples) @ v.ravel()).reshape(at_rest.shape)
        wanted.append(Q.apply(v))
        kept.append(Law(Q, still, limits=limits, loop=loop).next(v, zero, u, u))

    def norm(off):
        return np.sum((lifted(P, samples) @ off.ravel()) ** 2) + WEIGHT * np.sum(off**2)

    assert norm(kept[0] - kept[1]) <= norm(wanted[0] - wanted[1]) * (1 + 1e-4) + 1e-6


def test_the_rate_in_the_metric_is_a_generalised_eigenvalue():
    for case in ("stage", "tanks"):
        loop, Q, L, _, _ = CASES[case]
        omega = np.geomspace(1e-3, 1, 40) * np.pi / loop.Ts
        P, one = loop.frequency_response(omega), np.eye(len(loop.outputs))
        T = Q.frequency_response(omega)[:, None, None] * (
            one - L.frequency_response(omega) @ P
        )
        W = P.conj().swapaxes(1, 2) @ P + WEIGHT * one
        values = [
            eigh(t.conj().T @ w @ t, w, eigvals_only=True)[-1]
            for t, w in zip(T, W, strict=True)
        ]
        result = convergence(loop, Q, L, omega)
        assert result.within() == pytest.approx(np.sqrt(max(values)), rel=1e-9)
        assert result.within(1e-10) == pytest.approx(result.gamma, rel=1e-5)
        several = convergence([P, 2 * P], Q, L, omega).within()
        assert several[0] == pytest.approx(result.within(), rel=1e-9) != several[1]


def test_the_outputs_converge_at_the_rate_of_lemma_1_and_the_law_alone_does_not():
    loop, Q, L, _, limits = CASES["tanks"]
    reference = bump(300, [3.0, 2.0, 4.0])  # at rest for long before and after
    gamma = rate(loop, Q, L, np.geomspace(1e-3, 1, 400) * np.pi / loop.Ts).gamma
    run = run_trials(loop, Law(Q, L, limits=limits), reference, trials=15)
    moved = np.sqrt((run.y.diff("trial") ** 2).sum(["time", "channel"])).values[1:]
    assert np.all(moved[1:8] < gamma * moved[:7]) and moved[7] > 1e-6


@pytest.mark.parametrize("case", ["tanks", "furnace"])
def test_norm_optimal_learning_falls_to_what_no_v_within_the_limits_can_beat(case):
    """The best by scipy, in the commands: there the limits are a box, the matrix is the plant's."""
    loop, _, _, reference, limits = CASES[case]
    samples = len(reference)
    L, Q = (
        NormOptimal(loop.P, 1e-3, samples),
        zero_phase_butterworth(1, 3.1415 / loop.Ts, loop.Ts),
    )
    run = run_trials(loop, Law(Q, L, limits=limits), reference, trials=8)
    own = Actuators.of(limits, loop)
    G = lifted(loop.plant[:, loop.controls], samples)
    box = [np.tile(bound, samples) for bound in (own.lowest, own.highest)]
    best = 2 * lsq_linear(G, reference.ravel(), box, tol=1e-12).cost
    reached = (run.e.values**2).sum(axis=(1, 2))
    assert np.all(
        np.diff(reached[1:]) < 1e-6 * reached[0]
    )  # the first was cut off as it came
    assert best * (1 - 1e-9) <= reached[-1] < best + 2e-4 * reached[0]


def test_what_the_rest_asks_for_does_not_bind_what_is_before_it():
    """Where v is zero, it cannot: here the reference itself needs more than there is."""
    loop, Q, L, _, _ = CASES["furnace"]
    reference, limits = (
        np.full((80, 1), 4.0),
        {"valve": (0.0, 0.6)},
    )  # it needs 1, to the end
    run = run_trials(loop, Law(Q, L, rest=30, limits=limits), reference, trials=3)
    assert not run.v.values[:, -30:].any()
    assert run.u.values[1:, :50].max() <= 0.6 + 1e-6 < run.u.values[1:, 50:].min()
    np.testing.assert_allclose(run.applied, np.clip(run.u, 0.0, 0.6), atol=1e-6)


def test_without_a_model_commands_are_cut_off():
    _, Q, L, reference, limits = CASES["not our controller"]
    named = ClosedLoop(Ts=ON_W.Ts, outputs=ON_W.outputs)
    e, zero = 0.2 * reference, np.zeros_like(reference)
    v = Law(Q, L, rest=4, limits=limits, loop=named).next(zero, e, reference)
    low, high = [0, -np.inf, -0.5], [2.5, np.inf, 4.2]
    first = np.clip(reference, low, high) - reference  # what trial 1 had for v
    w = np.clip(reference + Law(Q, L, rest=4).next(first, e), low, high)
    np.testing.assert_allclose(v[:-4], (w - reference)[:-4], atol=1e-12)
    assert not v[-4:].any()


def test_signals_are_matched_by_name_and_one_channel_needs_no_second_axis():
    loop, Q, L, _, limits = CASES["tanks"]
    v, e, u, own = trial("tanks")
    expected = Law(Q, L, limits=limits, loop=loop).next(v, e, u)
    tables = [pd.DataFrame(s, columns=n)[n[::-1]] for s, n in
              ((v, loop.outputs), (e, loop.outputs), (u, loop.controls),
               (own.follow(u), loop.controls))]  # fmt: skip
    law = Law(Q, L, limits=limits, loop=loop)
    v_table, e_table, u_table, applied = tables
    labelled = law.next(v_table, e_table, u_table, applied)
    np.testing.assert_array_equal(labelled, expected)
    loop, Q, L, _, limits = CASES["furnace"]
    v, e, u, _ = trial("furnace")
    row = Law(Q, L, limits=limits, loop=loop).next(v[:, 0], e[:, 0], u[:, 0])
    np.testing.assert_array_equal(
        row, Law(Q, L, limits=limits, loop=loop).next(v, e, u)[:, 0]
    )
    assert row.shape == (len(v),)
    with pytest.raises(ValueError, match="u has shape"):
        Law(Q, L, limits=limits, loop=loop).next(v, e, u[1:])


LOOP, Q = CASES["tanks"][:2]
COMMANDS = st.lists(
    st.lists(st.floats(-9, 9), min_size=3, max_size=3), min_size=1, max_size=20
)


def test_actuators_are_those_of_the_commands_of_the_loop():
    own = Law(Q, None, limits={"pump C": (0, 5), "pump A": (-1, 1, 0.5)}, loop=LOOP)
    np.testing.assert_array_equal(own.actuators.lowest, [-1, -np.inf, 0])
    np.testing.assert_array_equal(own.actuators.highest, [1, np.inf, 5])
    # 0.5 a second, two seconds each
    np.testing.assert_array_equal(own.actuators.step, [1, np.inf, np.inf])
    closed = Law(Q, None, limits={"w2": (0, 5)}, loop=ON_W)
    np.testing.assert_array_equal(closed.actuators.highest, [np.inf, 5, np.inf])
    for limits in ({"pump A": (0, 1, 0)}, {"leak": (0, 1)}, {"pump A": 3}):
        with pytest.raises(ValueError, match="limits"):
            Law(Q, None, limits=limits, loop=LOOP)


@given(COMMANDS, st.floats(-3, 3), st.floats(0.1, 4), st.floats(0.01, 2))
def test_what_is_applied_is_within_and_the_nearest_at_each_step(
    commands, low, width, rate
):
    commands = np.array(commands)
    own = Actuators.of({"pump A": (low, low + width, rate), "pump B": (-1, 1)}, LOOP)
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
