"""Experiments within the limits of a rig: what is sent, told, recorded, gone on with, replayed."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from plants import furnace, stage, tanks
from test_own_loop import KNOWN, REFERENCE, Sampled, Whole
from test_own_loop import L as OWN_L
from test_own_loop import Q as OWN_Q
from test_stopping import bump

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    record,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from rodlib.ilc.logs.replay import replay
from rodlib.ilc.trials.run import rms

PUMPS = ["pump A", "pump B", "pump C"]
CASES = {
    "stage": (current_trial_loop(stage(), ["F"], sizes={"x": 1.0, "F": 3.0}), 300.0, [2.0],
              {"F": (-6.0, 4.0)}),
    "stage, rates": (current_trial_loop(stage(), ["F"], sizes={"x": 1.0, "F": 3.0}), 300.0, [2.0],
                     {"F": (-6.0, 4.0, 500.0)}),
    "tanks": (current_trial_loop(tanks(), PUMPS), 0.4, [3.0, 2.0, 4.0],
              dict.fromkeys(PUMPS, (-10.0, 25.0))),
    "furnace": (current_trial_loop(furnace(12)), 0.5, [4.0], {"valve": (-0.05, 1.0)}),
}  # fmt: skip
EACH = pytest.mark.parametrize("case", CASES)


class Limited:
    """The plant of a loop behind actuators; refuses what these cannot do."""

    def __init__(self, loop, limits):
        self.loop, self.limits = loop, limits
        self.begin(0)

    def begin(self, trial):
        self.x, self.sent = np.zeros(self.loop.plant.nstates), []

    def read(self):
        return self.loop.plant.C @ self.x

    def apply(self, u):
        for value, name in zip(u, self.loop.controls, strict=True):
            low, high, *_ = self.limits[name]
            assert low <= value <= high
        plant = self.loop.plant
        self.x = plant.A @ self.x + plant.B[:, : len(u)] @ u
        self.sent.append(u)

    def safe(self):
        pass


def experiment(case, trials=4):
    loop, cutoff, heights, limits = CASES[case]
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    L = LearningFilter(0.5 * np.eye(len(heights))[..., None], loop.Ts)
    return Limited(loop, limits), dict(
        loop=loop, law=Law(Q, L), reference=bump(80, heights), trials=trials
    )


def quietly(*given, **more):
    with warnings.catch_warnings(action="ignore"):
        return record(*given, **more)


@EACH
def test_the_rig_runs_as_the_simulation_does(case):
    """Sample by sample with the Controller, and from the matrices of the loop."""
    rig, given = experiment(case)
    with pytest.warns(
        UserWarning, match="trial 1: commands were beyond the limits"
    ) as told:
        log = record(rig, **given)
    assert len(told) == 1 and "v is learned within" in str(told[0].message)
    assert told[0].filename == __file__
    run = run_trials(**given | {"law": replace(given["law"], limits=rig.limits)})
    for name in ("v", "u", "applied", "y", "delta"):
        size = np.abs(run["u" if name == "delta" else name]).max()
        np.testing.assert_allclose(log[name], run[name], atol=2e-5 * size)
    np.testing.assert_array_equal(rig.sent, log.applied[-1])
    assert (
        np.abs(log.applied - log.u)[0].max() > 0.1
        and rms(log.e)[-1] < 0.9 * rms(log.e)[0]
    )
    without = quietly(rig_that_cuts_off(rig), **free(given))
    assert "applied" not in without and np.abs(without.u).max() > np.abs(log.u).max()


def free(given):
    """The same without limits."""
    return given | {"law": replace(given["law"], limits={})}


def rig_that_cuts_off(rig):
    """By itself, as actuators do."""
    apply = rig.apply
    low, high = np.array([rig.limits[name][:2] for name in rig.loop.controls]).T
    rig.apply = lambda u: apply(np.clip(u, low, high))
    return rig


@EACH
def test_a_log_keeps_asked_and_applied_is_gone_on_with_and_replays(case, tmp_path):
    rig, given = experiment(case)
    whole = quietly(rig, **given)
    quietly(rig, **given | {"trials": 2}, path=tmp_path / "log.csv")
    log = quietly(rig, **given, path=tmp_path / "log.csv")
    loaded = load_log(tmp_path / "log.csv")
    for name in ("u", "applied", "v", "y"):
        np.testing.assert_array_equal(loaded[name], whole[name])
        np.testing.assert_array_equal(loaded[name], log[name])
    replayed = replay(loaded)
    assert "the recorded v is that of the law in every trial" in repr(replayed)
    assert not replayed.warnings and not replayed.omissions
    np.testing.assert_allclose(replayed.simulated.y, loaded.y, atol=1e-4)
    assert replayed.fit.to_numpy().min() > 1 - 1e-6  # from what was applied
    v, e, u = (loaded[name].values[-1] for name in ("v", "e", "u"))
    law = replace(given["law"], limits=rig.limits, loop=given["loop"])
    following = law.next(v, e, u)
    np.testing.assert_array_equal(replayed.following, following)

    other = tmp_path / "other.csv"
    save_log(loaded.assign(v=loaded.v * 1.01), other)
    assert "v departs from the law from trial 2" in replay(load_log(other)).agreement


def test_limits_are_part_of_the_law_that_a_log_names(tmp_path):
    rig, given = experiment("tanks")
    path = tmp_path / "log.csv"
    quietly(rig_that_cuts_off(rig), **free(given) | {"trials": 2}, path=path)
    assert "applied" not in load_log(path) and "actuators" not in load_log(path).attrs
    rig, _ = experiment("tanks")
    with pytest.raises(ValueError, match="see its actuators"):
        record(rig, **given, path=path)


@pytest.mark.parametrize("device", [Sampled, Whole])
def test_a_loop_that_is_not_ours_is_sent_what_it_can_follow(device, tmp_path):
    rig = device()
    rig.limits = {"set x": (-1.0, 1.5)}
    w = []
    name = "apply" if device is Sampled else "run"
    own = getattr(rig, name)
    setattr(rig, name, lambda given: (w.append(np.array(given)), own(given))[1])
    log = quietly(
        rig, KNOWN, Law(OWN_Q, OWN_L), REFERENCE, trials=4, path=tmp_path / "log.csv"
    )
    sent = np.concatenate([np.atleast_2d(one) for one in w])
    assert sent[:, 0].max() == 1.5 and (log.reference + log.v)[0].max() > 1.9
    run = run_trials(KNOWN, Law(OWN_Q, OWN_L, limits=rig.limits), REFERENCE, trials=4)
    np.testing.assert_allclose(log.y, run.y, atol=1e-6)
    replayed = replay(load_log(tmp_path / "log.csv"))
    assert "that of the law in every trial" in repr(replayed)
    assert replayed.fit.to_numpy().min() > 1 - 1e-6
