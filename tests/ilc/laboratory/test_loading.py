import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rodlib import LogError, load_log, run_trials, save_log
from rodlib.ilc.laboratory import loading, tables
from rodlib.paper.repository import ROOT

SIGNALS = """{"outputs": {"depth": "mm"}, "controls": {"valve, left": "l/min"},
"disturbances": {"rain": ""}}""".replace("\n", " ")
HEAD = f"# format: rodlib trial log 2\n# Ts: 1.0 s\n# signals: {SIGNALS}\n"
COLUMNS = 'trial,time,reference_depth,v_depth,"u_valve, left",y_depth,disturbance_rain\n'
ROWS = [f"{k},{p},1.0,0.5,{p}.25,0.75,2.0\n" for k in (1, 2, 3) for p in range(4)]
GOOD = HEAD + COLUMNS + "".join(ROWS)


def write(tmp_path, text, **how):
    path = tmp_path / "log.csv"
    path.write_text(text, newline="", **{"encoding": "utf-8"} | how)
    return path


@pytest.fixture
def good(tmp_path):
    return load_log(write(tmp_path, GOOD))


def test_a_log_written_by_hand_is_read(good):
    assert dict(good.sizes) == {"trial": 3, "time": 4, "channel": 1, "source": 1}
    assert good.u[1, 2, 0] == 2.25
    assert good.e[0, 0, 0] == 0.25
    assert good.u.attrs["units"] == "l/min" and good.e.attrs["units"] == "mm"
    assert [*good.output.values, *good.control.values] == ["depth", "valve, left"]
    assert [*good.source.values, *good.source_unit.values] == ["rain", ""]
    assert "delta" not in good


def test_a_period_in_minutes_is_that_of_the_column_time(tmp_path):
    trials = load_log(write(tmp_path, GOOD.replace("1.0 s", "1.0 min")))
    assert trials.attrs["Ts"] == 60 and [*trials.time.values] == [0, 60, 120, 180]


@settings(max_examples=400)
@given(st.integers(0, len(GOOD) - 1), st.text(max_size=3), st.integers(0, 3))
@example(GOOD.index("1.0 s"), "1e400 ", 4)
def test_a_log_with_an_accident_is_read_or_refused_in_words(tmp_path_factory, start, text, length):
    """Nothing but a LogError of a few lines; what is read has finite values of one shape."""
    broken = GOOD[:start] + text + GOOD[start + length :]
    path = write(tmp_path_factory.mktemp("logs"), broken, errors="replace")
    try:
        trials = load_log(path)
    except LogError as error:
        assert len(str(error).splitlines()) <= 21
        assert len(str(error)) < 4000
    else:
        assert trials.y.size == trials.sizes["trial"] * trials.sizes["time"]
        assert all(np.isfinite(trials[name]).all() for name in trials.data_vars)


def replaced(index, text, rows=ROWS):
    return HEAD + COLUMNS + "".join([*rows[:index], text, *rows[index + 1 :]])


def stretched(rows):
    """By a clock that runs 0.09 % slow."""
    return [f"1,{1.0009 * p:.6f},1,0.5,1,1,2\n" for p in range(rows)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no table"),
        (HEAD, "no table"),
        (HEAD + COLUMNS, "the table has no rows"),
        (GOOD.replace("log 2", "log 7"), "format is 'rodlib trial log 7'"),
        (GOOD.replace("# Ts: 1.0 s\n", ""), "Ts is None"),
        (GOOD.replace("Ts: 1.0 s", "Ts: -1 s"), "Ts is '-1 s'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: often"), "Ts is 'often'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1e400 s"), "Ts is '1e400 s'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1.0 K"), "Ts is '1.0 K'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1.0 s*1"), "Ts is '1.0 s*1'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1.0 $s$"), "Ts is '1.0 $s$'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: １.0 s"), "Ts is '１.0 s'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 0_1 s"), "Ts is '0_1 s'"),
        (GOOD.replace('"mm"', '"mm*1"'), "unit 'mm*1' of depth is not understood"),
        (replaced(6, "2,2,1.0,１,1,1,2.0\n"), "v_depth: entry is '１', not a finite"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1e9 s"), "irregular sampling in trial 1, row 6"),
        (GOOD.replace("# Ts", "# Ts: 2.0 s\n# Ts"), "'Ts' is given twice, again in line 3"),
        (GOOD + "# Ts: 2.0 s\n", "'Ts' is given twice, again in line 17"),
        (GOOD.replace('"depth": "mm"}', '"depth": "mm", "depth": "m"}'), "stands there twice"),
        (GOOD.replace(',y_depth,', ",depth,"), "unknown column 'depth'; did you mean 'y_depth'?"),
        (GOOD.replace(",reference_", ",refrence_"), "did you mean 'reference_depth'"),
        (GOOD.replace(",y_depth,", ",y_level,"), "missing columns ['y_depth']"),
        (GOOD.replace(",y_depth,", ",v_depth,"), "column 'v_depth' stands there 2 times"),
        (GOOD.replace(",y_depth,", ",delta_depth,"), "unknown column 'delta_depth'"),
        (GOOD.replace('"mm"', '"furlongs per lunch"'), "unit 'furlongs per lunch' of depth"),
        (GOOD.replace('"mm"', "1"), "unit of depth = 1 must be a str"),
        (GOOD.replace('"outputs"', '"exits"'), "one control for each output"),
        (GOOD.replace('{"depth": "mm"}', "[]"), "outputs = [] must be a dict"),
        (GOOD.replace("# signals: ", "# signals: ["), "signals must be a JSON object"),
        (GOOD.replace("# signals: ", "# signals:" + "[" * 10000), "signals must be a JSON object"),
        (GOOD.replace('"rain": ""', '"depth": "m"'), "'depth' has two units"),
        (replaced(5, "2,1,1.0,0.5,1.25,,2.0\n"), "y_depth: entry is missing, in trial 2, row 10"),
        (replaced(5, "2,1,1,0.5,nan,1,2\n"), "left: entry is 'nan', not a finite number, in tr"),
        (replaced(6, "2,2,1.0,0.5,off,1,2.0\n"), "u_valve, left: entry is 'off', not a finite"),
        (replaced(6, "2,2,1.0,inf,1,1,2.0\n"), "v_depth: entry is 'inf', not a finite number"),
        (replaced(6, "2,2,1.0,1e400,1,1,2.0\n"), "v_depth: entry is '1e400', not a finite"),
        (replaced(6, "2,2,1.0,1_0,1,1,2.0\n"), "v_depth: entry is '1_0', not a finite"),
        (replaced(11, "3,3,1.0,0.5,3.25,0.75,1#5\n"), "disturbance_rain: entry is '1#5', not a"),
        (replaced(1, "# a note\n\n1,1,1.0,0.5,off,1,2\n"), "entry is 'off', not a finite number,"
         " in trial 1, row 8"),
        (replaced(2, "1,2,1.0,0.5,2.25,0.75\n"), "row 7 has 6 entries, but the header has 7"),
        (replaced(2, "1,2,1.0,0.5,2.25,0.75,2,\n"), "row 7 has 8 entries, but the header has 7"),
        (GOOD.replace("\n1", ",\n1").replace("\n2", ",\n2"), "ends with a comma: remove it"),
        (HEAD + (COLUMNS + "".join(ROWS)).replace(",", ";"), "separated by semicolons"),
        (HEAD + (COLUMNS + "".join(ROWS)).replace(",", "\t"), "separated by tabs"),
        (HEAD + COLUMNS + "".join(ROWS[:2] + ROWS[3:]), "a gap in trial 1, row 7: a step of 2"),
        (replaced(9, "3,1.3,1,0.5,1,1,2\n"), "irregular sampling in trial 3, row 14"),
        (replaced(1, "1,0,1,0.5,1,1,2\n"), "irregular sampling in trial 1, row 6: a step of 0"),
        (replaced(5, "# a note\n\n2,1.3,1,0.5,1,1,2\n"), "irregular sampling in trial 2, row 12"),
        (HEAD + COLUMNS + "".join(stretched(8)), "the clock is off, in trial 1, row 7: sample 2 "
         "is at 2.0018, but due at 2"),
        (HEAD + COLUMNS + "".join(ROWS[:-1]), "different lengths: 3 samples in trial 3; 4 samples "
         "in trial 1, 2"),
        (HEAD + COLUMNS + "".join(ROWS[:2] + ROWS[4:8]), "2 samples in trial 1; 4 samples in tria"),
        (HEAD + COLUMNS + "".join(ROWS[8:] + ROWS[:8] + ROWS[8:]), "3 goes on in row 17, after "
         "trial 2: the rows of a trial must stand together (4 pieces of 3 trials)"),
        (GOOD.replace("\n3,", "\n0,"), "0 in row 13 is no whole number, 1 or more"),
        (GOOD.replace("\n3,", "\n2.5,"), "2.5 in row 13 is no whole number, 1 or more"),
        (replaced(0, "1,7,1,0.5,1,1,2\n"), "trial 1, row 5, the first of its trial, is at 7"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": [0, 0.5]}\n# Ts'),
         "y_depth: implausible value 0.75 in trial 1, row 6: not from 0 to 0.5 mm; wrong uni"),
        (GOOD.replace("# Ts", '# limits: {"y": [0, 0.5]}\n# Ts'), "for ['y'], which are no col"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": [1, 0]}\n# Ts'), "two numbers, [low, high]"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": ["0", 1]}\n# Ts'), "cannot be understood"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": ["0", "1"]}\n# Ts'),
         "limits of 'y_depth' = ['0', '1'] holds values of type <U1, but must hold numbers"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": "09"}\n# Ts'), "limits of 'y_depth' = '09'"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": {}}\n# Ts'), "limits of 'y_depth' = {} holds"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": [false, 1.5]}\n# Ts'), "holds True or False"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": [0, 1e999]}\n# Ts'), "are not finite"),
        (GOOD.replace("# Ts", '# limits: {"y_depth": [-Infinity, 1]}\n# Ts'), "-Infinity is no n"),
        (GOOD.replace("log 2", "log 1"), "format is 'rodlib trial log 1'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1.0"), "Ts is '1.0'"),
    ],
)  # fmt: skip
def test_broken_logs_say_what_is_wrong(tmp_path, text, message):
    with pytest.raises(LogError) as error:
        load_log(write(tmp_path, text))
    assert message in str(error.value)
    assert "log.csv" in str(error.value)
    assert len(str(error.value).splitlines()) < 8


@pytest.mark.parametrize(
    "text",
    [
        "\N{BOM}" + GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("1.0,", " +1.0 ,"),
        GOOD.replace("1.0,", '"1.0",'),
        GOOD.replace("\n2,0", "\n# a comment\n\n  \n# another: one\n2,0") + "\n\n",
        GOOD.removesuffix("\n"),
        GOOD.replace("trial,time,", "trial, time, "),
        GOOD.replace("1.0 s", "1e3 ms").replace(",1,1", ",1000,1").replace(",2,1", ",2e3,1")
        .replace(",3,1", ",3e+3,1"),
        GOOD.replace(",2,1.0", ",2.0009,1.0"),  # at most a thousandth of a sample
    ],
)  # fmt: skip
def test_what_means_the_same_is_read_alike(tmp_path, good, text):
    trials = load_log(write(tmp_path, text))
    xr.testing.assert_allclose(trials, good, atol=1e-3)
    assert list(trials.attrs) == ["Ts"] and trials.attrs["Ts"] == 1.0


@pytest.mark.parametrize(
    ("second_trial", "message"),
    [
        ([0.002, 2.002, 4.002, 6.002], None),
        ([-0.002, 1.998, 3.998, 5.998], None),
        ([0.0, 2.0018, 4.0, 5.9982], None),
        ([0.0022, 2.0, 4.0, 6.0], "trial 2, row 9, the first of its trial, is at 0.0022, not at 0"),
        ([0.0, 2.0, 4.0022, 6.0], "irregular sampling in trial 2, row 11: a step of 2.0022"),
        ([0.0, 2.0018, 4.0036, 6.0054], "the clock is off, in trial 2, row 11"),
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


def test_it_does_not_matter_where_the_pieces_are_cut_that_are_read(tmp_path, good, monkeypatch):
    broken = GOOD.replace("\n2,0", "\n# a comment\n\n2,0").replace("\n3,2,1.0", "\n3,2,on")
    for size in range(3, 90):
        monkeypatch.setattr(tables, "PIECE", size)
        assert load_log(write(tmp_path, GOOD)).identical(good)
        with pytest.raises(
            LogError, match="entry is 'on', not a finite number, in trial 3, row 17"
        ):
            load_log(write(tmp_path, broken))


def test_all_problems_are_reported_at_once_but_no_more_than_can_be_read(tmp_path):
    text = GOOD.replace("1.0 s", "0 s").replace("1,1.0", "1,x")
    text = text.replace('"l/min"', '"litres per fortnite"')
    with pytest.raises(LogError, match="3 problem") as error:
        load_log(write(tmp_path, text))
    for part in ("Ts is '0 s'", "entry is 'x'", "in trial 1, row 6 (3 such entries)", "litres"):
        assert part in str(error.value)
    many = [f"{k},7,1,0.5,1,1,2\n" for k in range(1, 200)]
    with pytest.raises(LogError, match="199 problem") as error:
        load_log(write(tmp_path, HEAD + COLUMNS + "".join(many)))
    assert str(error.value).endswith("\n- and 181 more") and str(error.value).count("\n") == 19


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(LogError, match="cannot be read"):
        load_log(tmp_path / "nowhere.csv")
    (tmp_path / "picture").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(LogError, match="cannot be read as text"):
        load_log(tmp_path / "picture")
    with pytest.raises(LogError, match="UTF-16: save it as UTF-8"):
        load_log(write(tmp_path, GOOD, encoding="utf-16"))
    with pytest.raises(ValueError, match="path = 3 must be the path of a file"):
        load_log(3)


def test_values_come_in_the_units_that_are_asked_for(tmp_path, good):
    path = write(tmp_path, GOOD)
    other = load_log(path, units={"depth": "m", "valve, left": "ml/s"})
    np.testing.assert_allclose(other.y, good.y / 1000, rtol=1e-15)
    np.testing.assert_allclose(other.u, good.u * 1000 / 60, rtol=1e-15)
    assert other.v.attrs["units"] == "m" and other.disturbance.identical(good.disturbance)
    with pytest.raises(ValueError, match="unit 'mm' of depth cannot be converted to 's'"):
        load_log(path, units={"depth": "s"})
    with pytest.raises(ValueError, match=r"units is about \['height'\]"):
        load_log(path, units={"height": "m"})


def test_readings_have_a_zero_and_differences_have_none(tmp_path):
    text = GOOD.replace('"mm"', '"degC"').replace("# Ts", '# limits: {"y_depth": [0, 50]}\n# Ts')
    trials = load_log(write(tmp_path, text), units={"depth": "degF"})
    np.testing.assert_allclose(trials.y, 0.75 * 1.8 + 32)
    np.testing.assert_allclose(trials.reference, 1.8 + 32)
    np.testing.assert_allclose(trials.v, 0.5 * 1.8)
    np.testing.assert_allclose(json.loads(trials.attrs["limits"])["y_depth"], [32, 122])
    with pytest.raises(ValueError, match="one counts from a zero of its own"):
        load_log(write(tmp_path, text), units={"depth": "K"})


def test_the_estimate_of_an_input_disturbance_is_a_difference(tmp_path, loop, Q):
    run = run_trials(loop, Q, None, np.ones((9, 2)), np.ones((9, 3)), 1)
    assert run.delta[0, -1, 0] != 0
    save_log(run.assign_coords(control_unit=("channel", ["degC", "W"])), tmp_path / "log.csv")
    other = load_log(tmp_path / "log.csv", units={"Q1": "degF"})
    np.testing.assert_allclose(other.delta[:, :, 0], 1.8 * run.delta[:, :, 0], atol=1e-12)
    np.testing.assert_allclose(other.u[:, :, 0], 1.8 * run.u[:, :, 0] + 32)


def test_what_is_cut_off_anywhere_in_the_last_trial_is_read_without_it(tmp_path, good):
    path = tmp_path / "log.csv"
    save_log(good, path)
    whole = path.read_bytes()
    two = whole.index(b"\n3,0") + 1
    for end in range(two, len(whole)):
        path.write_bytes(whole[:end])
        trials, size = loading.load_ended(path)
        assert size == two and trials.identical(good.isel(trial=[0, 1]))
    path.write_bytes(whole)
    trials, size = loading.load_ended(path)
    assert size == len(whole) and trials.identical(good)
    assert path.read_bytes() == whole


def test_tracked_logs_are_read_by_pandas_alone_and_say_that_they_are_synthetic():
    for name in ("learning", "no-learning"):
        path = ROOT / "data" / "rig" / f"{name}.csv"
        table = pd.read_csv(path, comment="#")
        assert len(table) == 25000 and not table.isna().any().any()
        trials = load_log(path)
        assert trials.attrs["origin"].startswith("synthetic")
        assert json.loads(trials.attrs["rig"])["seed"] >= 0
        columns = table.filter(regex="^y_")
        np.testing.assert_array_equal(trials.y.values.reshape(-1, 2), columns)
        sources = table.filter(regex="^disturbance_")
        np.testing.assert_array_equal(trials.disturbance.values.reshape(-1, 3), sources)


def test_example_in_the_data_readme_is_a_log(tmp_path):
    text = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    example = text.split("```text\n")[1].split("```")[0]
    assert load_log(write(tmp_path, example)).sizes["time"] >= 2
    assert loading.FORMAT in example
