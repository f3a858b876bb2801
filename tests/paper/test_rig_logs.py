import json
from dataclasses import asdict

import numpy as np
import pytest

from rodlib import load_log, loop_of, paper_loop
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.paper import rig_logs
from rodlib.paper.repository import ROOT
from rodlib.rigs import VirtualRig


def test_the_logs_are_recorded_in_data_rig(monkeypatch):
    saved = []
    log = load_log(ROOT / "data/rig/no-learning.csv")
    monkeypatch.setattr(rig_logs, "record", lambda *_, **__: log)
    monkeypatch.setattr(rig_logs, "save_log", lambda log, path: saved.append(path))
    rig_logs.main()
    assert saved == [ROOT / "data/rig/learning.csv", ROOT / "data/rig/no-learning.csv"]


@pytest.mark.parametrize(("name", "seed"), [("learning", 1), ("no-learning", 2)])
def test_the_tracked_logs_are_of_the_assumed_experiment(name, seed):
    tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv")
    device = {"modes": 300, "noise": 0.02, "quantum": 0.01, "lag": 4.0, "limit": 60.0}
    device |= {"ambient_rate": 5e-5}
    assert device == asdict(VirtualRig().parameters)
    device |= {"seed": seed, "rod": json.loads(json.dumps(asdict(VirtualRig().rod)))}
    assert json.loads(tracked.attrs["rig"]) == device
    assert tracked.sizes["trial"] == 10
    np.testing.assert_allclose(loop_of(tracked).KL, paper_loop().KL, rtol=1e-9)
    flows = np.round(assumed_disturbance(), 6)[:, :, 1:]
    np.testing.assert_array_equal(tracked.disturbance[:, :, 1:], flows)
    for k in range(10):
        np.testing.assert_array_equal(tracked.reference[k], np.round(assumed_reference(), 6))
