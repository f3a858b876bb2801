from rodlib import data, load_log
from rodlib.published import ROOT


def test_the_logs_are_recorded_in_data_rig(monkeypatch):
    saved = []
    log = load_log(ROOT / "data/rig/no-learning.csv")
    monkeypatch.setattr(data, "record", lambda *_, **__: log)
    monkeypatch.setattr(data, "save_log", lambda log, path: saved.append(path))
    data.main()
    assert saved == [ROOT / "data/rig/learning.csv", ROOT / "data/rig/no-learning.csv"]
