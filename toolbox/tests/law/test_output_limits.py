"""Limits of outputs from the design to trials; the parts have tests of their own."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from limited import task
from plants import RestartingModel, altered, bump, copies, lag, lags

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


@pytest.mark.parametrize(("seed", "p", "m"), [(3, 1, 1), (13, 2, 2), (3, 3, 2), (5, 1, 2)])
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


LOWPASS = zero_phase_butterworth(2, 40.0, 0.01)
[AXIS] = copies(1)
AXIS.update_names(inputs=["w"], outputs=["x"])
WRONG = altered(AXIS, B=1.08)
LOOP, BUMP = ClosedLoop(AXIS), bump(200, [1.0])


def axis(limit=1.01, radius=0.1, **options):
    """The law of an axis within a limit."""
    design = synthesise(LOOP, LOWPASS, uncertainty=radius)
    return design.law(limits={"x": (None, limit)}, **options)


def test_a_rig_that_was_stopped_goes_on_with_the_same_v(tmp_path):
    law, path = axis(), tmp_path / "parts.csv"
    whole = record(RestartingModel(WRONG), LOOP, law, BUMP, trials=6)
    record(RestartingModel(WRONG), LOOP, law, BUMP, trials=3, path=path)
    parts = record(RestartingModel(WRONG), LOOP, law, BUMP, trials=6, path=path)
    np.testing.assert_array_equal(parts.v, whole.v)
    assert parts.y.max() < 1.01
    replayed = replay(load_log(path))
    assert "the recorded v agrees with the law" in str(replayed)
    assert np.all(replayed.kept["x to its limit"] > 0) and replayed.kept.alpha.max() == 1
    save_law(tmp_path / "law.json", law)
    read = run_trials(LOOP, load_law(tmp_path / "law.json"), BUMP, trials=4, plant=WRONG)
    np.testing.assert_allclose(read.v, whole.v[:4], rtol=0, atol=1e-12)


def test_noise_that_lowers_a_trial_and_raises_the_next_breaks_no_limit():
    noise = np.broadcast_to([[[0.02]], [[-0.02]], [[0.02]]], (3, 200, 1))
    run = run_trials(LOOP, axis(noise={"x": 0.02}), BUMP, trials=3, plant=WRONG, noise=noise)
    assert run.y.max() < 1.01


def test_a_trial_beyond_a_limit_is_followed_by_the_share_that_keeps_it():
    with pytest.warns(UserWarning, match=r"x was beyond its limit by 0\.07.* 1, .* 0\.93"):
        run = run_trials(LOOP, axis(), BUMP, trials=4, plant=WRONG, pilot=1.0)
    assert run.y[0].max() > 1.01
    assert run.y[1:].max() < 1.01 and rms(run)[3] < 0.1 * rms(run)[0]
    wide = axis(radius=0.5)  # no change is sure by P: back by the share
    with pytest.warns(UserWarning, match="beyond its limit"):
        run = run_trials(LOOP, wide, BUMP, trials=2, plant=WRONG, pilot=1.0)
    np.testing.assert_allclose(run.y[1].max(), 1.01, rtol=1e-9)
    both = WRONG * np.ones((1, 2))
    both.update_names(inputs=["w", "F"], outputs=["x"])
    other = ClosedLoop(both, references={"w": "x"}, learned=["F"])
    law = synthesise(other, LOWPASS, uncertainty=0.5).law(limits={"x": (None, 1.01)})
    with pytest.raises(ValueError, match=r"x was beyond its limit by .* take a smaller reference"):
        run_trials(other, law, BUMP, trials=2)


def test_the_first_share_is_what_P_and_its_radius_let_through():
    law = axis(limit=1.0)
    share = law.output_limits.first_share(BUMP)
    with_radius = run_trials(LOOP, law, BUMP, trials=1, plant=WRONG)
    assert 0.6 < share < 0.95 and with_radius.y.max() <= 1.0
    np.testing.assert_allclose(with_radius.v[0], (share - 1) * BUMP)
    pilot = run_trials(LOOP, law, BUMP, trials=1, pilot=0.3)
    np.testing.assert_allclose(pilot.v[0], -0.7 * BUMP)


def test_each_plant_of_a_list_keeps_the_limits():
    plants = [lag(), lag(0.85), lag(gain=1.1)]
    law = synthesise(plants, Q).law(limits={"y[0]": (None, 1.02)})
    loop, r = ClosedLoop(plants[0]), bump(150, [1.0])
    for plant in plants:
        run = run_trials(loop, law, r, trials=6, plant=plant)
        assert run.y.max() <= 1.02 and rms(run)[5] < 0.1 * rms(run)[0]


PAIR = lags()
PAIR.update_names(inputs=["w1", "w2"], outputs=["T1", "T2"])


def test_what_is_promised_is_printed_with_its_conditions():
    law = synthesise(PAIR, Q, uncertainty=0.1).law(
        limits={"w1": (-5, 5), "T1": (None, 60)}, noise={"T1": 0.1}
    )
    assert law.limits == {"w1": (-5, 5)}
    assert str(law.output_limits) == (
        "The measured T1 stays below 60 in every trial that follows a trial in which it was "
        "measured below 60 - 2 n\nThis holds for every stable linear plant within the radius. "
        "Conditions: trials start alike, disturbances repeat, and no actuator saturates. n = 0.1 "
        "bounds the non-repeating part of T1 in each sample, including noise"
    )
    exact = synthesise(PAIR, Q).law(limits={"T2": (-1, np.full(50, 3.0))}).output_limits
    assert "The measured T2 stays below its limit at each sample and above -1" in f"{exact}"
    assert "for the model only" in f"{exact}"


@pytest.mark.parametrize(
    ("limits", "noise", "message"),
    [
        ({"T3": (0, 1)}, None, r"limits has the keys \['T3'\], but its keys must be some of"),
        ({"T1": (2, 1)}, None, r"limits\['T1'\] = \(2, 1\) must have a lower limit"),
        ({"T1": 3}, None, r"limits\['T1'\] = 3 must be two values"),
        ({"T1": (None, [[1]])}, None, "None, a number, or one number for each sample"),
        ({"T1": (None, np.nan)}, None, "None, a number, or one number for each sample"),
        ({"T1": (np.zeros(3), np.ones(4))}, None, "has 3 and 4"),
        ({"T1": (None, np.ones(9))}, None, "has 9 samples, but a trial has 60"),
        ({"T1": (None, -1.0)}, None, r"\(-inf, -1.0\) leave no room at the start .* is 0"),
        ({"T1": (None, 2.0)}, {"T1": -1}, r"noise\['T1'\] = -1"),
        ({"w1": (0, 2.0)}, {"T1": 1}, "limits names none of the outputs"),
        ({"T1": (None, 2.0)}, {"T3": 1}, r"noise has the keys \['T3'\]"),
    ],
)
def test_what_cannot_be_kept_is_refused_before_any_trial(limits, noise, message):
    with pytest.raises(ValueError, match=message):
        run_trials(
            ClosedLoop(PAIR), synthesise(PAIR, Q).law(limits=limits, noise=noise), np.zeros((60, 2))
        )


def test_limits_of_outputs_without_what_they_need_are_refused():
    loop, limits = ClosedLoop(AXIS), {"x": (None, 1.1)}
    design = synthesise(AXIS, LOWPASS, base=None)
    law, other = design.law(limits=limits), ClosedLoop(AXIS, outputs=["T1"])
    own = Law(LOWPASS, LearningFilter([[[0.5]]], 0.01), limits={"T1": (0, 1)})
    table = control.frd(np.full((1, 1, 50), 0.5 + 0.1j), np.linspace(1, 300, 50), 0.01)
    numbers = np.full((50, 1, 1), 0.5)
    for refused, message in (
        (lambda: run_trials(other, own, BUMP), r"limits\['T1'\] is .* of an output, .* synthesise"),
        (lambda: run_trials(other, law, BUMP), r"plant with the outputs \['x'\], but the loop"),
        (lambda: law.bound_to(loop).next(0 * BUMP, BUMP), "y = None, but with limits of outputs"),
        (lambda: law.next(0 * BUMP, BUMP, y=BUMP), r"law\.bound_to"),
        (lambda: run_trials(loop, law, BUMP, reset=False), "reset = False, but limits of outputs"),
        (lambda: synthesise(table, LOWPASS).law(limits={"y[0]": (0, 1)}), "P is known by samples"),
        (
            lambda: synthesise(numbers, Q, np.linspace(0.01, 3, 50)).law(limits={"0": (0, 1)}),
            "the name of an output and of an input",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            refused()


@pytest.mark.parametrize("before", [0.0, -0.2])
def test_trials_under_another_disturbance_do_not_count(before):
    """One comes in trial 3, or one that lowered y is gone: once below, y stays below the limit."""
    law, disturbed = axis(radius=0.3), np.tile(0.06 * BUMP, (8, 1, 1))
    disturbed[:2] = before * BUMP
    with warnings.catch_warnings(action="ignore"):  # that a limit was not kept
        run = run_trials(LOOP, law, BUMP, trials=8, plant=WRONG, noise=disturbed)
    highest = run.y.max(("time", "channel")).values
    below = 3 + np.argmax(highest[3:] <= 1.01)  # a trial after the change, in any case
    assert np.all(highest[below:] <= 1.01 + 1e-9) and below < 6
    assert rms(run)[-1] < 0.3 * rms(run)[0]
    trials = [Done(BUMP, level * BUMP) for level in (0.9, 1.2, 0.8, 1.3, 0.7)]
    assert law.output_limits._comparable(trials) == trials[3:]
    assert law.output_limits._comparable(trials[2:3]) == trials[2:3]


def test_a_reference_that_changes_keeps_the_limits():
    each = np.array([share * BUMP for share in (0.5, 1.0, 0.7, 1.0)])
    run = run_trials(LOOP, axis(), each, trials=4, plant=WRONG)
    assert run.y.max() <= 1.01 and rms(run)[3] < 0.1
    both = (run.reference + run.v).values  # from w_k on, and not from v_k
    assert np.abs(both[1] - both[0]).max() > 0.3


def test_a_small_learning_gain_does_not_keep_the_share_of_the_first_trial():
    law, task = axis(limit=1.2, gain=0.3), (BUMP, None, 6)
    careful = run_trials(LOOP, law, *task, plant=WRONG, pilot=0.5)
    whole = run_trials(LOOP, replace(law, output_limits=None), *task, plant=WRONG)
    assert rms(careful)[5] < 1.3 * rms(whole)[5]
