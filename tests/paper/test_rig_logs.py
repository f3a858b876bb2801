import json
from dataclasses import asdict

import numpy as np
import pytest

from ilctools import load_log
from ilctools.law.notes import loop_of
from rodlib import paper_loop
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.paper import rig_logs
from rodlib.paper.repository import ROOT
from rodlib.rigs import MISMATCHED


def test_the_logs_are_recorded_in_data_rig(monkeypatch):
    saved, recorded = [], []
    log = load_log(ROOT / "data/rig/no-learning.csv")

    def record(rig, law, **_):
        parameters = rig.parameters == rig_logs.PARAMETERS
        recorded.append((rig.seed, parameters, law.L is None))
        return log

    monkeypatch.setattr(rig_logs, "record", record)
    monkeypatch.setattr(rig_logs, "save_log", lambda log, path: saved.append(path))
    rig_logs.record_logs()
    assert saved == [ROOT / "data/rig/learning.csv", ROOT / "data/rig/no-learning.csv"]
    assert recorded == [(1, True, False), (2, True, True)]


@pytest.mark.parametrize(("name", "seed"), [("learning", 1), ("no-learning", 2)])
def test_the_tracked_logs_are_of_the_assumed_experiment(name, seed):
    tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv")
    device = json.loads(tracked.attrs["rig"])
    losses = device["rod"].pop("heat_transfer")  # through elements, and by radiation
    assert losses == pytest.approx(0.5 / (0.04 * 0.08) + 4.571, abs=1e-3)
    assert device["element"]["resistance"] == 2.0 and device["seed"] == seed
    assert device["known"]["resistance"] == 0.0 and device["cells"] == 16
    rod = json.loads(json.dumps(asdict(MISMATCHED)))
    assert device.pop("rod") | {"heat_transfer": MISMATCHED.heat_transfer} == rod
    assert device == asdict(rig_logs.PARAMETERS) | {"seed": seed}
    assert tracked.sizes["trial"] == 10
    # The law (23), which knows no limits, is all that made the log.
    assert {"applied", "actuators"}.isdisjoint({*tracked, *tracked.attrs})
    np.testing.assert_allclose(loop_of(tracked).KL, paper_loop().KL, rtol=1e-9)
    flows = np.round(assumed_disturbance(), 6)[:, :, 1:]
    np.testing.assert_array_equal(tracked.disturbance[:, :, 1:], flows)
    reference = np.round(assumed_reference(), 6)
    assert all(np.array_equal(trial, reference) for trial in tracked.reference)
