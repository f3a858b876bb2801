import numpy as np

from ilctools import load_log, save_log
from ilctools.law.notes import loop_of
from rodlib.paper import rig_logs
from rodlib.paper.repository import ROOT


def test_the_tracked_logs_are_recorded_again_alike(monkeypatch, tmp_path):
    """Two trials of each to the last digit, by the rig, the law and the loop of their notes.

    The bytes are those that are written, but for the loop, whose last digits a processor decides.
    """
    whole, again = rig_logs.experiment(), {}
    first = {"trials": 2, "disturbance": whole["disturbance"][:2]}
    monkeypatch.setattr(rig_logs, "experiment", lambda: whole | first)
    monkeypatch.setattr(rig_logs, "save_log", lambda log, path: again.update({path: log}))
    rig_logs.record_logs()
    assert [*again] == [ROOT / f"data/rig/{name}.csv" for name in ("learning", "no-learning")]
    for path, log in again.items():
        tracked = load_log(path)
        assert tracked.isel(trial=slice(2)).equals(log)
        assert tracked.attrs["rig"] == log.attrs["rig"]
        ours, theirs = loop_of(tracked).KL, loop_of(log).KL
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
        save_log(log, tmp_path / "log.csv")
        written = (tmp_path / "log.csv").read_bytes().splitlines(keepends=True)
        with open(path, "rb") as file:
            beside = [*zip(written, file, strict=False)]
        different = [line for line, other in beside if line != other]
        assert len(beside) == len(written) > 2 * 2500
        assert all(line.startswith(b"# loop: ") for line in different)
        assert {"applied", "actuators"}.isdisjoint({*tracked, *tracked.attrs})  # no limits
        flows = whole["disturbance"][..., 1:]
        np.testing.assert_allclose(tracked.disturbance[..., 1:], flows, rtol=0, atol=5e-5)
