"""Limits of outputs from the design to trials; the parts have tests of their own."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from limited import task
from plants import bump, lag, lags

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    load_law,
    load_log,
    record,
    replay,
    rms,
    run_trials,
    save_law,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.law.output_spread import Done

Q = zero_phase_butterworth(2, 0.5, 1.0)


@pytest.mark.parametrize(
    ("seed", "p", "m"), [(1, 1, 1), (3, 1, 1), (0, 2, 2), (13, 2, 2), (3, 3, 2), (5, 1, 2)]
)
def test_limits_are_kept_by_plants_within_the_radius(seed, p, m):
    """Units that differ, limits of time and of commands, rest, gain: see `limited`."""
    one = task(seed, p, m, errors=2)
    rng, size = np.random.default_rng(seed), np.abs(one.reference).max(axis=0)
    for truth in one.truths:
        noise = one.noise * rng.uniform(-1, 1, (6, *one.reference.shape))
        with warnings.catch_warnings(action="ignore"):  # commands are cut off
            run = run_trials(one.loop, one.law, one.reference, trials=6, plant=truth, noise=noise)
        for k, y in enumerate(run.y.values):
            assert not np.any(one.law.output_limits.beyond(y) > 1e-9 * size), k + 1
        errors = rms(run.e / size).values
        assert errors[-1] < errors[0]


def axis(limit=1.01, radius=0.1, **options):
    """A loop, its law within a limit, a reference, and a plant that is wrong by 0.08."""
    P = control.ss(control.sample_system(control.tf([400], [1, 20, 400]), 0.01))
    P.update_names(inputs=["w"], outputs=["x"])
    loop, lowpass = ClosedLoop(P), zero_phase_butterworth(2, 40.0, 0.01)
    design = synthesise(loop, lowpass, uncertainty=radius)
    wrong = control.ss(P.A, 1.08 * P.B, P.C, P.D, 0.01, inputs=["w"], outputs=["x"])
    return loop, design.law(limits={"x": (None, limit)}, **options), bump(200, [1.0]), wrong


class Rig:
    inputs = ("w",)

    def __init__(self, P):
        self.P = P

    def begin(self, trial):
        self.x = np.zeros(self.P.nstates)

    def read(self):
        return self.P.C @ self.x

    def apply(self, w):
        self.x = self.P.A @ self.x + self.P.B @ w


def test_a_rig_that_was_stopped_goes_on_with_the_same_v(tmp_path):
    loop, law, r, wrong = axis()
    whole = record(Rig(wrong), loop, law, r, trials=6, path=tmp_path / "whole.csv")
    record(Rig(wrong), loop, law, r, trials=3, path=tmp_path / "parts.csv")
    parts = record(Rig(wrong), loop, law, r, trials=6, path=tmp_path / "parts.csv")
    np.testing.assert_array_equal(parts.v, whole.v)
    assert parts.y.max() < 1.01
    replayed = replay(load_log(tmp_path / "parts.csv"))
    assert "the recorded v agrees with the law" in str(replayed)
    assert np.all(replayed.kept["x to its limit"] > 0) and replayed.kept.alpha.max() == 1
    save_law(tmp_path / "law.json", law)
    read = run_trials(loop, load_law(tmp_path / "law.json"), r, trials=4, plant=wrong)
    np.testing.assert_allclose(read.v, whole.v[:4], rtol=0, atol=1e-12)


def test_a_trial_beyond_a_limit_is_followed_by_the_share_that_keeps_it():
    loop, law, r, wrong = axis()
    with pytest.warns(UserWarning, match=r"x was beyond its limit by 0\.07.* 1, .* 0\.93"):
        run = run_trials(loop, law, r, trials=4, plant=wrong, pilot=1.0)
    assert run.y[0].max() > 1.01
    assert run.y[1:].max() < 1.01 and rms(run)[3] < 0.1 * rms(run)[0]
    wide = axis(radius=0.5)[1]  # no change is sure by P: back by the share
    with pytest.warns(UserWarning, match="beyond its limit"):
        run = run_trials(loop, wide, r, trials=2, plant=wrong, pilot=1.0)
    np.testing.assert_allclose(run.y[1].max(), 1.01, rtol=1e-9)
    alone = control.ss(wrong.A, wrong.B, wrong.C, 0, 0.01, inputs=["w"], outputs=["x"])
    fixed = ClosedLoop(loop.P, references={"w": "x"}, learned=["w"])
    assert fixed.one_for_one  # as by default
    both = control.ss(alone.A, np.hstack([alone.B] * 2), alone.C, 0, 0.01)
    both.update_names(inputs=["w", "F"], outputs=["x"])
    other = ClosedLoop(both, references={"w": "x"}, learned=["F"])
    design = synthesise(other, zero_phase_butterworth(2, 40.0, 0.01), uncertainty=0.5)
    with pytest.raises(ValueError, match=r"x was beyond its limit by .* take a smaller reference"):
        run_trials(other, design.law(limits={"x": (None, 1.01)}), r, trials=2)


def test_the_first_share_is_what_P_and_its_radius_let_through():
    loop, law, r, wrong = axis(limit=1.0)
    share = law.output_limits.first_share(r)
    with_radius = run_trials(loop, law, r, trials=1, plant=wrong)
    assert 0.6 < share < 0.95 and with_radius.y.max() <= 1.0
    np.testing.assert_allclose(with_radius.v[0], (share - 1) * r)
    pilot = run_trials(loop, law, r, trials=1, pilot=0.3)
    np.testing.assert_allclose(pilot.v[0], -0.7 * r)


def test_each_plant_of_a_list_keeps_the_limits():
    plants = [lag(), lag(0.85), lag(gain=1.1)]
    law = synthesise(plants, Q).law(limits={"y[0]": (None, 1.02)})
    loop, r = ClosedLoop(plants[0]), bump(150, [1.0])
    for plant in plants:
        run = run_trials(loop, law, r, trials=6, plant=plant)
        assert run.y.max() <= 1.02 and rms(run)[5] < 0.1 * rms(run)[0]


def test_what_is_promised_is_printed_with_its_conditions():
    P = lags()
    P.update_names(inputs=["w1", "w2"], outputs=["T1", "T2"])
    design = synthesise(P, Q, uncertainty=0.1)
    law = design.law(limits={"w1": (-5, 5), "T1": (None, 60)}, noise={"T1": 0.1})
    assert law.limits == {"w1": (-5, 5)}
    assert str(law.output_limits) == (
        "The measured T1 stays below 60 in every trial that follows a trial in which it was "
        "measured below 60 - 2 n\nThis holds for every stable linear plant within the radius. "
        "Conditions: trials start alike, disturbances repeat, and no actuator saturates. n = 0.1 "
        "bounds the non-repeating part of T1 in each sample, including noise"
    )
    exact = synthesise(P, Q).law(limits={"T2": (-1, np.full(50, 3.0))}).output_limits
    assert "The measured T2 stays below its limit at each sample and above -1" in f"{exact}"
    assert "for the model only" in f"{exact}"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limits": {"T3": (0, 1)}}, r"limits has the keys \['T3'\], but its keys must be some of"),
        ({"limits": {"T1": (2, 1)}}, r"limits\['T1'\] = \(2, 1\) must have a lower limit"),
        ({"limits": {"T1": 3}}, r"limits\['T1'\] = 3 must be two values"),
        ({"limits": {"T1": (None, [[1]])}}, "None, a number, or one number for each sample"),
        ({"limits": {"T1": (None, np.nan)}}, "None, a number, or one number for each sample"),
        ({"limits": {"T1": (np.zeros(3), np.ones(4))}}, "has 3 and 4"),
        ({"limits": {"T1": (None, np.ones(9))}}, "has 9 samples, but a trial has 60"),
        (
            {"limits": {"T1": (None, -1.0)}},
            r"\(-inf, -1.0\) leave no room at the start of a trial, .* is 0",
        ),
        ({"limits": {"T1": (None, 2.0)}, "noise": {"T1": -1}}, r"noise\['T1'\] = -1"),
        ({"limits": {"w1": (0, 2.0)}, "noise": {"T1": 1}}, "limits names none of the outputs"),
        ({"limits": {"T1": (None, 2.0)}, "noise": {"T3": 1}}, r"noise has the keys \['T3'\]"),
    ],
)
def test_what_cannot_be_kept_is_refused_before_any_trial(options, message):
    P = lags()
    P.update_names(inputs=["w1", "w2"], outputs=["T1", "T2"])
    design = synthesise(P, Q)
    with pytest.raises(ValueError, match=message):
        run_trials(ClosedLoop(P), design.law(**options), np.zeros((60, 2)), trials=1)


def test_limits_of_outputs_without_what_they_need_are_refused():
    P, r = lag(), bump(60, [1.0])
    loop, design = ClosedLoop(P, outputs=["T1"]), synthesise(lag(), Q)
    with pytest.raises(ValueError, match=r"limits\['T1'\] is a limit of an output, .* synthesise"):
        run_trials(loop, Law(Q, LearningFilter([[[0.5]]], 1.0), limits={"T1": (0, 1)}), r)
    law = design.law(limits={"y[0]": (None, 1.1)})
    with pytest.raises(ValueError, match=r"a plant with the outputs \['y\[0\]'\], but the loop"):
        run_trials(loop, law, r)
    own = ClosedLoop(P)
    with pytest.raises(ValueError, match="y = None, but with limits of outputs"):
        law.bound_to(own).next(0 * r, r)
    with pytest.raises(ValueError, match=r"law\.bound_to"):
        law.next(0 * r, r, y=r)
    with pytest.raises(ValueError, match="reset = False, but limits of outputs"):
        run_trials(own, synthesise(P, Q, base=None).law(limits={"y[0]": (None, 2)}), r, reset=False)
    P.update_names(inputs=["w"], outputs=["y"])
    omega = np.linspace(0.01, 3, 50)
    names = {"inputs": ["w"], "outputs": ["y"]}
    table = control.frd(np.full((1, 1, 50), 0.5 + 0.1j), omega, 1.0, **names)
    with pytest.raises(ValueError, match="P is known by samples"):
        synthesise(table, Q).law(limits={"y": (None, 2)})
    with pytest.raises(ValueError, match="the name of an output and of an input"):
        synthesise(np.full((50, 1, 1), 0.5), Q, omega).law(limits={"0": (None, 2)})


@pytest.mark.parametrize("before", [0.0, -0.2])
def test_trials_under_another_disturbance_do_not_count(before):
    """One comes in trial 3, or one that lowered y is gone: once below, y stays below the limit."""
    loop, law, r, wrong = axis(radius=0.3)
    disturbed = np.tile(0.06 * bump(200, [1.0]), (8, 1, 1))
    disturbed[:2] = before * bump(200, [1.0])
    with warnings.catch_warnings(action="ignore"):  # that a limit was not kept
        run = run_trials(loop, law, r, trials=8, plant=wrong, noise=disturbed)
    highest = run.y.max(("time", "channel")).values
    below = 3 + np.argmax(highest[3:] <= 1.01)  # a trial after the change, in any case
    assert np.all(highest[below:] <= 1.01 + 1e-9) and below < 6
    assert rms(run)[-1] < 0.3 * rms(run)[0]
    trials = [Done(r, level * r) for level in (0.9, 1.2, 0.8, 1.3, 0.7)]
    assert law.output_limits._comparable(trials) == trials[3:]
    assert law.output_limits._comparable(trials[2:3]) == trials[2:3]


def test_a_reference_that_changes_keeps_the_limits():
    loop, law, r, wrong = axis()
    each = np.array([share * r for share in (0.5, 1.0, 0.7, 1.0)])
    run = run_trials(loop, law, each, trials=4, plant=wrong)
    assert run.y.max() <= 1.01 and rms(run)[3] < 0.1
    both = (run.reference + run.v).values  # from w_k on, and not from v_k
    assert np.abs(both[1] - both[0]).max() > 0.3


def test_a_small_learning_gain_does_not_keep_the_share_of_the_first_trial():
    loop, law, r, wrong = axis(limit=1.2, gain=0.3)
    careful = run_trials(loop, law, r, trials=6, plant=wrong, pilot=0.5)
    whole = run_trials(loop, replace(law, output_limits=None), r, trials=6, plant=wrong)
    assert rms(careful)[5] < 1.3 * rms(whole)[5]
