"""A log is replayed with the law and the loop that it names; what it lacks is left out."""

import warnings

import control
import numpy as np
import pytest
from plants import LEVELS, PUMPS, altered, bump, random_plant, stage, tanks

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    replay,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.law.notes import RESET, with_law
from ilctools.logs.replay import rms_by_trial

UNITS = dict.fromkeys([*PUMPS, "leak"], "ml/s") | dict.fromkeys(LEVELS, "cm")
LOOPS = {
    "stage": current_trial_loop(stage(), ["F"], {"x": 1.0, "F": 10.0}),
    "tanks": current_trial_loop(tanks(), PUMPS, units=UNITS),
    "feedthrough": current_trial_loop(random_plant(np.random.default_rng(3)), ["u1", "u2"]),
}

OMITTED = ["simulation", "prediction"]


def law_for(loop, rest=0, gain=1.0, learning=0.5):
    m = len(loop.outputs)
    L = LearningFilter(np.eye(m)[..., None] * [0, 0, 0, 0, 0, learning], loop.Ts)
    Q = zero_phase_butterworth(2, 0.06 / loop.Ts, loop.Ts)
    return Law(Q, L, rest, gain, loop=loop)


def trials_of(loop, law=None, trials=3, plant=None):
    """A smooth reference; disturbances that differ from trial to trial."""
    law, time = law or law_for(loop), np.arange(150)
    m, d = len(loop.outputs), len(loop.disturbances)
    r = bump(150, 1.0 + np.arange(m))
    waves = np.multiply.outer(1.0 + np.arange(trials), np.sin(0.05 * time)) + 1
    waves = np.repeat(waves[..., None], d, axis=2)
    with warnings.catch_warnings(action="ignore"):  # not all of them converge
        run = run_trials(loop, law, r, waves, trials, plant=plant)
    return with_law(run, law)


@pytest.mark.parametrize("name", LOOPS)
def test_with_the_right_model_simulation_and_prediction_are_the_log(name, tmp_path):
    run = trials_of(LOOPS[name], law_for(LOOPS[name], rest=20, gain=0.3))
    save_log(run, tmp_path / "log.csv")
    replayed = replay(load_log(tmp_path / "log.csv"))
    y = run.y.values
    atol = 1e-9 * np.abs(y).max()
    np.testing.assert_allclose(replayed.simulated.y.values, y, rtol=0, atol=atol)
    np.testing.assert_allclose(replayed.predicted, y, rtol=0, atol=atol)
    np.testing.assert_allclose(replayed.fit, 1, atol=1e-8)
    assert replayed.departure.to_numpy().max() < atol / 1000
    assert replayed.agreement == "the recorded v agrees with the law in every trial"
    assert replayed.omissions == []


def test_without_reset_the_model_goes_on_from_trial_to_trial():
    loop, r = LOOPS["stage"], 1 - bump(150, [1.0])
    law = Law(law_for(loop).Q, None, loop=loop)
    run = with_law(run_trials(loop, law, r, trials=3, reset=False), law)
    replayed = replay(run)
    np.testing.assert_allclose(replayed.predicted, run.y, rtol=0, atol=1e-9)
    del run.attrs[RESET]
    assert np.abs(replay(run).predicted - run.y).max() > 0.1


def test_the_fit_measures_how_wrong_a_model_is():
    plant = LOOPS["tanks"].plant
    replayed = replay(trials_of(LOOPS["tanks"], plant=altered(plant, B=[0.9, 0.9, 0.9, 1])))
    y = replayed.trials.y.values[1]
    squares = np.mean((y - replayed.predicted[1]) ** 2, axis=0)
    expected = 1 - np.sqrt(squares / y.var(axis=0))
    np.testing.assert_allclose(replayed.fit.loc[2], expected)
    assert np.all((expected > 0.3) & (expected < 0.95))
    still = replayed.trials.assign(y=0 * replayed.trials.y + 3.0)
    still["e"] = still.reference - still.y
    with pytest.warns(UserWarning, match=r"left, middle, right did not move in trial 2"):
        assert replay(still).fit.isna().all(axis=None)


def test_without_a_loop_the_law_is_checked_and_without_a_law_the_model():
    whole = law_for(LOOPS["tanks"], rest=15, gain=0.4)
    trials = trials_of(LOOPS["tanks"], whole)
    law = {key: value for key, value in trials.attrs.items() if key != "loop"}
    replayed = replay(trials.drop_attrs().assign_attrs(law))
    assert replayed.simulated is replayed.predicted is replayed.fit is None
    assert replayed.agreement.endswith("in every trial")
    last = trials.isel(trial=-1)
    np.testing.assert_array_equal(replayed.following, whole.next(last.v.values, last.e.values))
    limited = trials.drop_attrs().assign_attrs(law | {"actuators": '{"P1": [-1, 1]}'})
    assert replay(limited).law is None  # its projection needs the loop
    assert [reason.partition(":")[0] for reason in replayed.omissions] == OMITTED
    assert f"left out: {replayed.omissions[0]}" in repr(replayed)
    del trials.attrs["L"]
    replayed = replay(trials)
    assert replayed.departure is replayed.following is replayed.simulated is None
    assert replayed.fit is not None and "the log does not name its law" in repr(replayed)


def test_disturbances_that_are_not_in_the_model_are_named():
    replayed = replay(trials_of(LOOPS["stage"]).assign_coords(source=["draught"]))
    assert not replayed.disturbance.any()
    (omission,) = replayed.omissions
    assert "draught" in omission


def test_trials_are_identified_by_their_numbers():
    trials = trials_of(LOOPS["stage"], trials=6)
    shuffled = trials.sel(trial=[3, 1, 2, 6, 5, 4])
    assert replay(shuffled).trials.identical(replay(trials).trials)
    some, last = replay(trials.sel(trial=[5, 2, 3])), replay(trials.sel(trial=[4, 5]))
    np.testing.assert_array_equal(some.following, last.following)
    assert some.departure.x.isna().tolist() == [True, False, True]
    assert "except in trials [2, 5], which have no trial before" in some.agreement
    assert some.simulated is None and some.predicted is not None
    assert "simulation" in some.omissions[0] and "[2, 3, 5]" in some.omissions[0]


def test_a_departure_from_the_law_is_found_in_a_small_unit():
    trials, unit = trials_of(LOOPS["tanks"]), 1e-9
    run = (unit * trials).assign_attrs(trials.attrs)
    largest = np.abs(run.v.values[..., 2]).max()
    assert np.all(replay(run).departure <= 1e-12 * unit)
    run["v"][2, 70, 2] += 1e-3 * largest
    replayed = replay(run)
    assert "from trial 3 on" in replayed.agreement
    assert replayed.departure.loc[3, "right"] == pytest.approx(1e-3 * largest, rel=1e-6)


def test_an_unstable_plant_is_simulated_but_not_predicted():
    plant = control.ss(1.2, 1.0, 1.0, 0, 0.1, inputs=["F"], outputs=["tilt"])
    replayed = replay(trials_of(current_trial_loop(plant)))
    assert replayed.predicted is replayed.fit is None
    assert replayed.simulated is not None and "fit" not in repr(replayed)
    (omission,) = replayed.omissions
    assert omission.startswith("prediction: it needs u, and a loop whose model is stable")


def test_errors_are_summed_over_channels_of_one_unit():
    e = trials_of(LOOPS["tanks"]).e.assign_coords(output_unit=("channel", ["cm", "", "cm"]))
    table, squares = rms_by_trial(e), (e.values**2).mean(axis=1)
    assert table.columns.tolist() == ["RMS of left, right (cm)", "RMS of middle"]
    expected = np.c_[squares[:, [0, 2]].sum(1), squares[:, 1]]
    np.testing.assert_allclose(table**2, expected)


def test_a_replay_is_printed_in_lines_and_warns():
    lines = repr(replay(trials_of(LOOPS["tanks"]))).splitlines()
    assert lines[1].endswith("in every trial") and "left 100 %" in lines[8] and len(lines) == 9
    run = trials_of(LOOPS["tanks"], law_for(LOOPS["tanks"], learning=-2.0), trials=6)
    with pytest.warns(UserWarning, match="the error grows") as caught:
        replayed = replay(run)
    assert caught[0].filename == __file__ and len(caught) == 1
    assert "WARNING: the error grows" in repr(replayed)
    assert replay(run.isel(trial=[0, 2, 5])).warnings == ()
