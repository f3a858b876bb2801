"""Experiments that begin with a signal, follow several references, go on by another law."""

import warnings

import numpy as np
import pytest
from test_experiment import PLANT
from test_stopping import Model, bump

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    record,
    run_trials,
    zero_phase_butterworth,
)
from rodlib.ilc import with_law
from rodlib.ilc.replay import replay_of
from rodlib.ilc.report import about_the_law, summary

LOOP, Q = (
    current_trial_loop(PLANT, PLANT.input_labels[:2]),
    zero_phase_butterworth(2, 0.5, 0.5),
)
L = LearningFilter(0.4 * np.eye(2)[..., None], 0.5)
R = bump(80, [2.0, 1.0])


def test_the_first_trial_begins_with_what_was_learned_elsewhere(tmp_path):
    v, path = 0.1 * R + 1e-9 / 3, tmp_path / "log.csv"
    made = {
        "loop": LOOP,
        "law": Law(Q, L, rest=4),
        "reference": R,
        "v": v,
        "path": path,
    }
    made["decimals"] = {"v": 6}
    log = record(Model(PLANT), trials=2, **made)
    run = run_trials(LOOP, Law(Q, L, rest=4), R, trials=2, v=v)
    np.testing.assert_allclose(log.y, run.y, atol=1e-5)
    assert not log.v[0, -4:].any() and log.v[0, 40].any()
    more = record(Model(PLANT), trials=3, **made)
    assert more.isel(trial=slice(2)).identical(log)
    with pytest.raises(ValueError, match="another experiment, see its v of trial 1"):
        record(Model(PLANT), trials=4, **made | {"v": 2 * v})
    replay = replay_of(load_log(path))
    assert (
        replay.departure.loc[1].isna().all()
        and replay.departure.loc[2:].to_numpy().max() < 1e-6
    )
    np.testing.assert_allclose(replay.simulated.y, more.y, atol=1e-5)
    assert "as far as the trials before 1 tell" in about_the_law(replay)
    kept = record(Model(PLANT), LOOP, Law(Q, None), R, trials=2, v=v)
    np.testing.assert_array_equal(kept.v, [v, v])


def test_each_trial_follows_a_reference_of_its_own(tmp_path):
    references, path = np.array([R, 2 * R, -R]), tmp_path / "log.csv"
    run = run_trials(LOOP, Law(Q, L), references, trials=3)
    record(Model(PLANT), LOOP, Law(Q, L), references[:2], trials=2, path=path)
    log = record(Model(PLANT), LOOP, Law(Q, L), references, trials=3, path=path)
    for name in ("reference", "v", "y", "e"):
        np.testing.assert_allclose(log[name], run[name], atol=1e-9)
    np.testing.assert_allclose(replay_of(load_log(path)).simulated.y, run.y, atol=1e-9)
    with pytest.raises(
        ValueError, match=r"reference has shape \(3, 80, 2\), but must have .*\(4,"
    ):
        record(Model(PLANT), LOOP, Law(Q, L), references, trials=4)
    with pytest.raises(ValueError, match="another experiment, see its reference"):
        record(Model(PLANT), LOOP, Law(Q, L), references[::-1], trials=3, path=path)


def test_a_replay_says_what_record_would_have_said():
    wrong = LearningFilter(-L.coefficients * 2, 0.5)
    with warnings.catch_warnings(action="ignore"):
        run = run_trials(LOOP, Law(Q, wrong), R, trials=6)
    log = with_law(run, Law(Q, wrong, loop=LOOP))
    with pytest.warns(UserWarning, match="the error grows") as told:
        replay = replay_of(log)
    assert told[0].filename == __file__ and len(told) == 1
    assert "WARNING: the error grows" in summary(replay) and len(replay.findings) == 1
    y = run.y.copy()
    y[2:, 0] += 1.0
    moved = with_law(run.assign(y=y), Law(Q, None, loop=LOOP))
    with pytest.warns(
        UserWarning, match="trial 3: it starts 1 in depth, 1 in heat from where"
    ):
        replay_of(moved)
    with warnings.catch_warnings(action="error"):
        assert replay_of(log.isel(trial=[0, 2, 5])).findings == ()
