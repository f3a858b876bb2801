import json
from dataclasses import asdict

import numpy as np
import pytest

from rodlib import load_log, paper_loop
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.ilc.loop.notes import loop_of
from rodlib.paper import rig_logs
from rodlib.paper.repository import ROOT
from rodlib.peltier_rig import PeltierRig
from rodlib.rigs import MISMATCHED


def test_the_logs_are_recorded_in_data_rig(monkeypatch):
    saved, made = [], []
    log = load_log(ROOT / "data/rig/no-learning.csv")

    def record(rig, law, **_):
        made.append((rig.seed, rig.parameters == rig_logs.PARAMETERS, law.L is None))
        return log

    monkeypatch.setattr(rig_logs, "record", record)
    monkeypatch.setattr(rig_logs, "save_log", lambda log, path: saved.append(path))
    rig_logs.main()
    assert saved == [ROOT / "data/rig/learning.csv", ROOT / "data/rig/no-learning.csv"]
    assert made == [(1, True, False), (2, True, True)]


@pytest.mark.parametrize(("name", "seed"), [("learning", 1), ("no-learning", 2)])
def test_the_tracked_logs_are_of_the_assumed_experiment(name, seed):
    tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv")
    element = {"seebeck": 0.05, "resistance": 2.0, "conductance": 0.5, "limit": 6.0}
    device = {
        "element": element,
        "known": element | {"resistance": 0.0},
        "sinks_measured": False,
    }
    device |= {"sink_capacity": 400.0, "fan": 4.0, "convection": 3.8, "emissivity": 0.8}
    device |= {"temperature": 293.15, "lag": 2.0, "noise": 0.02, "quantum": 0.01}
    device |= {"ambient_rate": 5e-5, "cells": 16}
    assert device == asdict(rig_logs.PARAMETERS)
    rod = json.loads(tracked.attrs["rig"])["rod"]
    assert rod.pop("heat_transfer") == pytest.approx(
        0.5 / (0.04 * 0.08) + 4.571, abs=1e-3
    )
    device |= {"seed": seed, "rod": json.loads(json.dumps(asdict(MISMATCHED)))}
    del device["rod"]["heat_transfer"]  # which the rig does not use
    assert json.loads(tracked.attrs["rig"]) | {"rod": rod} == device
    assert tracked.sizes["trial"] == 10
    np.testing.assert_allclose(loop_of(tracked).KL, paper_loop().KL, rtol=1e-9)
    flows = np.round(assumed_disturbance(), 6)[:, :, 1:]
    np.testing.assert_array_equal(tracked.disturbance[:, :, 1:], flows)
    for k in range(10):
        np.testing.assert_array_equal(
            tracked.reference[k], np.round(assumed_reference(), 6)
        )


@pytest.mark.parametrize("name", ["learning", "no-learning"])
def test_what_was_asked_for_was_within_the_limits_of_the_elements(name):
    """So that the law (23), which knows no limits, is all that made the log; without warnings."""
    tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv")
    rig = PeltierRig(parameters=rig_logs.PARAMETERS)
    flows = np.concatenate(
        [tracked.u.values.ravel(), tracked.disturbance.values[..., 1:].ravel()]
    )
    largest = np.abs(flows).max()
    assert (
        20 < largest < 0.6 * min(np.abs(rig.limits["Q1"]))
    )  # more, where more still cools more
    current = largest / (0.05 * 293.15)
    assert current < 0.5 * 0.05 * 293.15 / 2.0
    assert {"applied", "actuators"}.isdisjoint({*tracked, *tracked.attrs})
