"""Experiments that begin with a signal, follow several references, go on by another law."""

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
from rodlib.ilc.logs.replay import replay

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
    replayed = replay(load_log(path))
    assert (
        replayed.departure.loc[1].isna().all()
        and replayed.departure.loc[2:].to_numpy().max() < 1e-6
    )
    np.testing.assert_allclose(replayed.simulated.y, more.y, atol=1e-5)
    assert "but in 1, without a trial before" in replayed.agreement
    kept = record(Model(PLANT), LOOP, Law(Q, None), R, trials=2, v=v)
    np.testing.assert_array_equal(kept.v, [v, v])


def test_each_trial_follows_a_reference_of_its_own(tmp_path):
    references, path = np.array([R, 2 * R, -R]), tmp_path / "log.csv"
    run = run_trials(LOOP, Law(Q, L), references, trials=3)
    record(Model(PLANT), LOOP, Law(Q, L), references[:2], trials=2, path=path)
    log = record(Model(PLANT), LOOP, Law(Q, L), references, trials=3, path=path)
    for name in ("reference", "v", "y", "e"):
        np.testing.assert_allclose(log[name], run[name], atol=1e-9)
    np.testing.assert_allclose(replay(load_log(path)).simulated.y, run.y, atol=1e-9)
    with pytest.raises(
        ValueError, match=r"reference has shape \(3, 80, 2\), but must have .*\(4,"
    ):
        record(Model(PLANT), LOOP, Law(Q, L), references, trials=4)
    with pytest.raises(ValueError, match="another experiment, see its reference"):
        record(Model(PLANT), LOOP, Law(Q, L), references[::-1], trials=3, path=path)
