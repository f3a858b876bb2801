import json
import os

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from rodlib import LearningFilter, LogError, load_log, logs, run_trials, save_log
from rodlib.logs import law_of, rest_of, with_law
from rodlib.published import ROOT
from rodlib.trials import dataset

UNITS = "time s; reference1 K; v1 K; u1 W; y1 K; Q2 W"
HEAD = f"# format: rodlib trial log 1\n# Ts: 1.0 s\n# units: {UNITS}\n"
COLUMNS = "trial,time,reference1,v1,u1,y1,Q2\n"
ROWS = [f"{k},{p},1.0,0.5,{p}.25,0.75,2.0\n" for k in (1, 2, 3) for p in range(4)]
GOOD = HEAD + COLUMNS + "".join(ROWS)


def write(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def test_a_log_written_by_hand_is_read(tmp_path):
    trials = load_log(write(tmp_path, GOOD))
    assert dict(trials.sizes) == {"trial": 3, "time": 4, "channel": 1, "source": 1}
    assert trials.u[1, 2, 0] == 2.25
    assert trials.e[0, 0, 0] == 0.25
    assert list(trials.source.values) == ["Q2"]
    assert "delta" not in trials


@given(st.integers(1, 3), st.integers(1, 4), st.integers(2, 9), st.integers(0, 2**32 - 1))
def test_save_and_load_give_the_same_trials(tmp_path_factory, m, trials, samples, seed):
    rng = np.random.default_rng(seed)
    shape = (trials, samples, m)
    signals = {name: rng.standard_normal(shape) for name in ("reference", "v", "u", "y", "delta")}
    signals["disturbance"] = rng.standard_normal((trials, samples, 2))
    outputs, controls = ([f"{name}{i + 1}" for i in range(m)] for name in "yu")
    sources, units = ["theta_a", "Q2"], dict.fromkeys(outputs, "K") | dict.fromkeys(controls, "W")
    units |= {"theta_a": "K", "Q2": "W"}
    saved = dataset(0.5, outputs, controls, sources, units, **signals)
    saved.attrs["origin"] = "synthetic: a test"
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    save_log(saved, path)
    loaded = load_log(path)
    xr.testing.assert_equal(loaded, saved)
    assert loaded.attrs == {"Ts": 0.5, "origin": "synthetic: a test"}
    again = path.with_name("again.csv")
    save_log(loaded, again)
    assert again.read_bytes() == path.read_bytes()


def test_other_units_are_converted(tmp_path):
    text = GOOD.replace("u1 W", "u1 kW").replace("y1 K", "y1 mK")
    trials = load_log(write(tmp_path, text))
    assert trials.u[0, 1, 0] == pytest.approx(1250)
    assert trials.y[0, 0, 0] == pytest.approx(0.75e-3)
    text = GOOD.replace("time s", "time min").replace("Ts: 1.0 s", "Ts: 60 s")
    assert load_log(write(tmp_path, text)).attrs["Ts"] == 60


def broken_row(index, text):
    return HEAD + COLUMNS + "".join([*ROWS[:index], text, *ROWS[index + 1 :]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no table"),
        (HEAD, "no table"),
        (HEAD + COLUMNS, "the table has no rows"),
        (GOOD.replace("log 1", "log 7"), "format is 'rodlib trial log 7'"),
        (GOOD.replace("# Ts: 1.0 s\n", ""), "Ts is None"),
        (GOOD.replace("Ts: 1.0 s", "Ts: -1 s"), "Ts is '-1 s'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: often"), "Ts is 'often'"),
        (GOOD.replace(",y1,", ",temp,"), "unknown column 'temp'"),
        (GOOD.replace(",y1,", ",temp,"), "missing columns ['y1']"),
        (GOOD.replace(",reference1,", ",refrence1,"), "did you mean 'reference1'"),
        (GOOD.replace(",y1,", ",y2,"), "missing columns"),
        (GOOD.replace("; u1 W", ""), "does not name the unit of 'u1'"),
        (GOOD.replace("y1 K", "y1 degF"), "unit 'degF' of 'y1' must be one of"),
        (broken_row(5, "2,1,1.0,0.5,1.25,,2.0\n"), "y1: entry is missing, in trial 2, row 10"),
        (broken_row(5, "2,1,1.0,0.5,nan,1,2.0\n"), "u1: entry is missing, in trial 2, row 10"),
        (broken_row(6, "2,2,1.0,0.5,off,1,2.0\n"), "u1: entry is 'off', not a finite number"),
        (broken_row(6, "2,2,1.0,inf,1,1,2.0\n"), "v1: entry is 'inf', not a finite number"),
        (HEAD + COLUMNS + "".join(ROWS[:2] + ROWS[3:]), "a gap in trial 1, row 7: a step of 2"),
        (broken_row(9, "3,1.3,1,0.5,1,1,2\n"), "irregular sampling in trial 3, row 14"),
        (broken_row(1, "1,0,1,0.5,1,1,2\n"), "irregular sampling in trial 1, row 6: a step of 0"),
        (HEAD + COLUMNS + "".join(ROWS[:-1]), "trial 3 has 3 samples, but others have 4"),
        (HEAD + COLUMNS + "".join(ROWS[4:]), "number 2 in row 5, where 1 was expected"),
        (HEAD + COLUMNS + "".join(ROWS[:4] + ROWS[8:]), "number 3 in row 9, where 2 was expected"),
        (HEAD + COLUMNS + "".join(ROWS[8:] + ROWS[:8]), "number 3 in row 5, where 1 was expected"),
        (
            GOOD.replace("Ts: 1.0 s", "Ts: 1000 ms").replace("time s", "time ms"),
            "a step of 1 where",
        ),
        (broken_row(0, "1,7,1,0.5,1,1,2\n"), "time: trial 1 begins at 7, row 5, not at 0"),
        (broken_row(4, "2,0,1,0.5,1,9999,2\n"), "y1: implausible value 9999 in trial 2, row 9"),
        (GOOD.replace("u1 W", "u1 kW").replace(".25,", "e4,"), "u1: implausible value"),
        (GOOD.replace("1,2,1.0,0.5", "1,2,1.0,0.5,0.5"), "no table"),
    ],
)
def test_broken_logs_say_what_is_wrong(tmp_path, text, message):
    with pytest.raises(LogError) as error:
        load_log(write(tmp_path, text))
    assert message in str(error.value)
    assert "log.csv" in str(error.value)


@pytest.mark.parametrize(
    ("second_trial", "message"),
    [
        ([0.002, 2.002, 4.002, 6.002], None),
        ([-0.002, 1.998, 3.998, 5.998], None),
        ([0.0, 2.0018, 4.0, 5.9982], None),
        ([0.0022, 2.0, 4.0, 6.0], "trial 2 begins at 0.0022, row 9, not at 0"),
        ([0.0, 2.0, 4.0022, 6.0], "irregular sampling in trial 2, row 11: a step of 2.0022"),
        ([0.0, 2.0, 4.0, 7.0], "irregular sampling in trial 2, row 12: a step of 3"),
        ([0.0, 2.0, 4.0, 7.01], "a gap in trial 2, row 12: a step of 3.01"),
    ],
)
def test_clocks_may_be_off_by_a_thousandth_of_a_period(tmp_path, second_trial, message):
    trials = [[0, 2, 4, 6], second_trial, [0, 2, 4, 6]]
    rows = [f"{k},{time},1,0.5,1,1,2\n" for k, times in enumerate(trials, 1) for time in times]
    text = HEAD.replace("Ts: 1.0 s", "Ts: 2.0 s") + COLUMNS + "".join(rows)
    if message is None:
        assert load_log(write(tmp_path, text)).attrs["Ts"] == 2
        return
    with pytest.raises(LogError) as error:
        load_log(write(tmp_path, text))
    assert message in str(error.value)


def test_all_problems_are_reported_at_once(tmp_path):
    text = GOOD.replace("log 1", "log 0").replace("u1 W", "u1 V").replace(",v1,", ",V,")
    with pytest.raises(LogError, match="4 problem") as error:
        load_log(write(tmp_path, text))
    for part in ("format", "unit 'V'", "unknown column 'V'", "missing columns ['v1']"):
        assert part in str(error.value)


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(LogError, match="cannot be read as text"):
        load_log(tmp_path / "nowhere.csv")
    (tmp_path / "picture").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(LogError, match="cannot be read as text"):
        load_log(tmp_path / "picture")


def test_an_interrupted_save_leaves_the_old_log(tmp_path, monkeypatch):
    path = write(tmp_path, GOOD)
    trials = load_log(path)
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        save_log(trials, path)
    assert path.read_text() == GOOD


def test_what_cannot_be_a_log_is_not_saved(tmp_path):
    trials = load_log(write(tmp_path, GOOD))
    with pytest.raises(ValueError, match=r"lacks \['u'\]"):
        save_log(trials.drop_vars("u"), tmp_path / "other.csv")
    trials["y"][0, 0, 0] = np.nan
    with pytest.raises(ValueError, match=r"not finite in \['y1'\]"):
        save_log(trials, tmp_path / "other.csv")
    assert not (tmp_path / "other.csv").exists()


def test_the_law_is_noted_and_found_again(loop, Q):
    rng = np.random.default_rng(0)
    L = LearningFilter(rng.standard_normal((2, 2, 3)), 1.0, "hold")
    run = run_trials(loop, Q, L, np.zeros((30, 2)), None, 2)
    noted_Q, noted_L = law_of(with_law(run, Q, L))
    assert noted_Q == Q
    np.testing.assert_array_equal(noted_L.coefficients, L.coefficients)
    assert noted_L.ends == "hold"
    assert law_of(with_law(run, Q, None))[1] is None
    assert law_of(run) is None
    with pytest.raises(LogError, match="Q or L cannot be understood"):
        law_of(run.assign_attrs(Q="{}", L="null"))


def test_the_rest_is_noted_and_found_again(loop, Q, tmp_path):
    run = run_trials(loop, Q, None, np.zeros((30, 2)), None, 2)
    assert rest_of(run) == rest_of(with_law(run, Q, None)) == 0
    assert with_law(run, Q, None).attrs.keys() == {"Ts", "Q", "L"}
    save_log(with_law(run, Q, None, rest=7), tmp_path / "log.csv")
    assert "# rest: 7\n" in (tmp_path / "log.csv").read_text()
    assert rest_of(load_log(tmp_path / "log.csv")) == 7
    assert rest_of(run.assign_attrs(rest="29")) == 29
    for note in ("30", "-1", "1.5", "soon", 3):
        with pytest.raises(LogError, match="rest cannot be understood"):
            rest_of(run.assign_attrs(rest=note))


def test_tracked_logs_are_read_by_pandas_alone_and_say_that_they_are_synthetic():
    for name in ("learning", "no-learning"):
        path = ROOT / "data" / "rig" / f"{name}.csv"
        table = pd.read_csv(path, comment="#")
        assert len(table) == 25000 and not table.isna().any().any()
        trials = load_log(path)
        assert trials.attrs["origin"].startswith("synthetic")
        assert json.loads(trials.attrs["rig"])["seed"] >= 0


def test_example_in_the_data_readme_is_a_log(tmp_path):
    text = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    example = text.split("```text\n")[1].split("```")[0]
    assert load_log(write(tmp_path, example)).sizes["time"] >= 2
    assert logs.FORMAT in example
