import json
import os
from io import StringIO

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rodlib import Law, LogError, load_log, run_trials, save_log
from rodlib.ilc.logs import log
from rodlib.ilc.trials.run import dataset
from rodlib.paper.repository import ROOT

SIGNALS = """{"outputs": {"depth": "mm"}, "controls": {"valve, left": "l/min"},
"disturbances": {"rain": ""}}""".replace("\n", " ")
HEAD = f"# format: rodlib trial log 2\n# Ts: 1.0 s\n# signals: {SIGNALS}\n"
COLUMNS = (
    'trial,time,reference_depth,v_depth,"u_valve, left",y_depth,disturbance_rain\n'
)
ROWS = [f"{k},{p},1.0,0.5,{p}.25,0.75,2.0\n" for k in (1, 2, 3) for p in range(4)]
GOOD = HEAD + COLUMNS + "".join(ROWS)


NAMES = st.text(min_size=1, max_size=8).filter(str.isprintable) | st.sampled_from(
    [
        "v1",
        "time",
        "delta",
        "reference_y1",
        "2nd, left",
        'the "hot" end',
        "#1",
        " ",
        "ϑ",
    ]
)
ALIKE = st.sampled_from(
    ["K", "mK", "degC", "°C", "mm", "µm", "N", "l/min", "%", "1/s**2", ""]
)
FLOATS = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [-0.0, 5e-324, -5e-324, 1e300, -1e300, 1e-300, 2.2250738585072011e-308, 0.1 + 0.2]
)


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


@settings(max_examples=100)
@given(st.integers(0, len(GOOD) - 1), st.text(max_size=3), st.integers(0, 3))
@example(GOOD.index("1.0 s"), "1e400 ", 4)
def test_a_log_with_an_accident_is_read_or_refused_in_words(
    tmp_path_factory, start, text, length
):
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no table"),
        (HEAD + COLUMNS, "the table has no rows"),
        (GOOD.replace("log 2", "log 1"), "format is 'rodlib trial log 1'"),
        (GOOD.replace("# Ts: 1.0 s\n", ""), "Ts is None"),
        (GOOD.replace("Ts: 1.0 s", "Ts: -1 s"), "Ts is '-1 s'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 1.0 K"), "Ts is '1.0 K'"),
        (GOOD.replace("Ts: 1.0 s", "Ts: 0_1 s"), "Ts is '0_1 s'"),
        (GOOD.replace("# Ts", "# Ts: 2.0 s\n# Ts"), "'Ts' is given twice, again in line 3"),
        (GOOD + "# Ts: 2.0 s\n", "'Ts' is given twice, again in line 17"),
        (GOOD.replace('"depth": "mm"}', '"depth": "mm", "depth": "m"}'), "stands there twice"),
        (GOOD.replace(",y_depth,", ",depth,"), "unknown column 'depth'; did you mean 'y_depth'?"),
        (GOOD.replace(",y_depth,", ",y_level,"), "missing columns ['y_depth']"),
        (GOOD.replace('"mm"', '"furlongs per lunch"'), "unit 'furlongs per lunch' of depth"),
        (GOOD.replace('"mm"', "1"), "unit of depth = 1 must be a str"),
        (GOOD.replace('"outputs"', '"exits"'), "outputs = None must be a dict"),
        (GOOD.replace('"controls": {', '"controls": {"fan": "", '), "one control for each output"),
        (GOOD.replace('"disturbances"', '"noises"'), "one control for each output"),
        (GOOD.replace("# signals: ", "# signals:" + "[" * 10000), "signals must be a JSON object"),
        (GOOD.replace('"rain": ""', '"depth": "m"'), "'depth' has two units"),
        (HEAD + COLUMNS + "".join(ROWS[:-1]), "different lengths: 3 samples in trial 3; 4 samples "
         "in trial 1, 2"),
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
        GOOD.replace(",2,1.0", ",2.0004,1.0"),  # as few digits leave of a step
    ],
)  # fmt: skip
def test_what_means_the_same_is_read_alike(tmp_path, good, text):
    trials = load_log(write(tmp_path, text))
    xr.testing.assert_allclose(trials, good, atol=1e-3)
    assert list(trials.attrs) == ["Ts"] and trials.attrs["Ts"] == 1.0


def test_a_real_clock_is_read_and_what_it_shows_is_said(tmp_path, good):
    late = GOOD.replace(",1,1.0", ",1.00128,1.0").replace(",3,1.0", ",3.05,1.0")
    trials = load_log(write(tmp_path, late))
    said = "steps from 0.9987 to 1.05 s, median 1.001, where Ts = 1; no sample is lost"
    assert trials.identical(good.assign_attrs(clock=said))
    save_log(trials, tmp_path / "again.csv")
    assert load_log(tmp_path / "again.csv").identical(trials)
    lost = (
        GOOD.replace("".join(ROWS[5:6]), "").replace(ROWS[1], "").replace(ROWS[9], "")
    )
    with pytest.raises(
        LogError, match=r"row 6 of trial 1 is 2 after .* 1 lost .3 such steps"
    ):
        load_log(write(tmp_path, lost))
    with pytest.warns(
        UserWarning, match="9 rows were resampled to 12 samples; near 3 of them"
    ):
        trials = load_log(tmp_path / "log.csv", resample=True)
    np.testing.assert_array_equal(trials.y, good.y)
    np.testing.assert_array_equal(trials.u[0, :, 0], [0.25, 0.25, 2.25, 3.25])


def test_a_record_of_commands_and_outputs_needs_no_reference(tmp_path, good):
    text = pd.read_csv(StringIO(HEAD + COLUMNS + "".join(ROWS)), comment="#")
    bare = text.drop(columns=["reference_depth", "v_depth"]).to_csv(index=False)
    trials = load_log(write(tmp_path, HEAD + bare))
    assert {*trials.data_vars} == {"u", "y", "disturbance"}
    save_log(
        good.drop_vars(["reference", "v"]), tmp_path / "again.csv"
    )  # e says nothing alone
    assert load_log(tmp_path / "again.csv").identical(trials)
    save_log(trials, tmp_path / "again.csv")
    assert load_log(tmp_path / "again.csv").identical(trials)
    with pytest.raises(LogError, match=r"missing columns \['v_depth'\]"):
        load_log(
            write(tmp_path, HEAD + text.drop(columns="v_depth").to_csv(index=False))
        )


def test_all_problems_are_reported_at_once_but_no_more_than_can_be_read(tmp_path):
    text = GOOD.replace("1.0 s", "0 s").replace("1,1.0", "1,x")
    text = text.replace('"l/min"', '"litres per fortnite"')
    with pytest.raises(LogError, match="3 problem") as error:
        load_log(write(tmp_path, text))
    for said in ("Ts is '0 s'", "entry is 'x'", "in row 6 (3 such entries)", "litres"):
        assert said in str(error.value)
    many = [f"{k},7,1,0.5,1,1,2\n" for k in range(1, 200)]
    with pytest.raises(LogError, match="199 problem") as error:
        load_log(write(tmp_path, HEAD + COLUMNS + "".join(many)))
    assert (
        str(error.value).endswith("\n- and 181 more")
        and str(error.value).count("\n") == 19
    )


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


def test_what_is_cut_off_anywhere_in_the_last_trial_is_read_without_it(tmp_path, good):
    path = tmp_path / "log.csv"
    save_log(good, path)
    whole = path.read_bytes()
    two = whole.index(b"\n3,0") + 1
    for end in range(two, len(whole), 7):
        path.write_bytes(whole[:end])
        assert log.load_ended(path).identical(good.isel(trial=[0, 1]))
    path.write_bytes(whole)
    assert log.load_ended(path).identical(good)
    path.write_text("")
    with pytest.raises(LogError, match="no table"):
        log.load_ended(path)


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
    assert log.FORMAT in example


@st.composite
def any_trials(draw):
    m, trials, samples = (
        draw(st.integers(1, 3)),
        draw(st.integers(1, 3)),
        draw(st.integers(1, 4)),
    )
    names = draw(st.lists(NAMES, min_size=2 * m, max_size=2 * m + 2, unique=True))
    units = {name: draw(ALIKE) for name in names}
    signals = {
        name: draw(arrays.arrays(float, (trials, samples, m), elements=FLOATS))
        for name in (
            "reference",
            "v",
            "u",
            "y",
            *(["delta"] if draw(st.booleans()) else []),
        )
    }
    sources = names[2 * m :]
    if sources:
        shape = (trials, samples, len(sources))
        signals["disturbance"] = draw(arrays.arrays(float, shape, elements=FLOATS))
    Ts = draw(st.floats(1e-9, 1e9))
    with np.errstate(over="ignore"):
        run = dataset(Ts, names[:m], names[m : 2 * m], sources, units, **signals)
    numbers = draw(
        st.lists(st.integers(1, 10**6), min_size=trials, max_size=trials, unique=True)
    )
    text = st.text().filter(lambda note: note.isprintable() and note == note.strip())
    return run.assign_coords(trial=numbers).assign_attrs(
        origin=draw(text), note="a: b # c"
    )


@pytest.mark.filterwarnings(
    "ignore:.* missing between others"
)  # of numbers that are random
@given(any_trials())
def test_whatever_is_saved_is_loaded_bit_for_bit(tmp_path_factory, saved):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    save_log(saved, path)
    with np.errstate(over="ignore"):
        loaded = load_log(path)
    assert loaded.identical(saved)
    for name in saved.variables:
        if saved[name].dtype == float:
            assert loaded[name].values.tobytes() == saved[name].values.tobytes()
    again = path.with_name("again.csv")
    save_log(loaded, again)
    assert again.read_bytes() == path.read_bytes()
    titles = pd.read_csv(path, comment="#", nrows=0).columns
    assert (
        list(titles[:2]) == ["trial", "time"]
        and f"y_{saved.output.values[0]}" in titles
    )


def test_pandas_reads_a_name_that_looks_like_a_comment(tmp_path, good):
    odd = good.assign_coords(output=("channel", ["first #1"]))
    save_log(odd, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(odd)
    table = pd.read_csv(tmp_path / "log.csv", comment="#")
    np.testing.assert_array_equal(table["y_first #1"], good.y.values.ravel())


def test_an_interrupted_save_leaves_the_old_log(tmp_path, good, monkeypatch):
    path = tmp_path / "log.csv"
    save_log(good, path)
    before = path.read_bytes()
    monkeypatch.setattr(
        os, "replace", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        save_log(good.assign(y=2 * good.y), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_the_order_of_dimensions_does_not_matter(tmp_path, good):
    save_log(good.transpose("channel", "source", "time", "trial"), tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(good)


def test_a_selection_of_trials_keeps_their_numbers(tmp_path, good):
    save_log(good.sel(trial=[3, 1]), tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(good.sel(trial=[3, 1]))


def test_each_trial_keeps_its_own_reference(tmp_path, good):
    good["reference"][1] = 7.0
    good["e"] = (good.reference - good.y).assign_attrs(good.e.attrs)
    save_log(good, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(good)


def test_attributes_come_back_as_a_line_of_text(tmp_path, good):
    notes = {
        "seed": 3,
        "list": [1, 2.5],
        "lines": "one\ntwo",
        "when": np.datetime64("2024-02-29"),
    }
    save_log(good.assign_attrs(notes), tmp_path / "log.csv")
    assert {k: v for k, v in load_log(tmp_path / "log.csv").attrs.items() if k != "Ts"} == {
        "seed": "3", "list": "[1, 2.5]", "lines": r'"one\ntwo"', "when": "2024-02-29"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda t: None, "trials = None must be a Dataset"),
        (lambda t: t.drop_vars("v"), r"lack \['v'\]"),
        (lambda t: t.drop_vars("output"), r"lack \['output'\]"),
        (lambda t: t.drop_vars("source_unit"), r"lack \['source_unit'\]"),
        (lambda t: t.assign(y=t.y * np.nan), "not finite in 'y_depth'"),
        (lambda t: t.assign(y=t.y.where(t.time < 2)), "not finite in 'y_depth'"),
        (lambda t: t.assign_attrs(Ts=0), "Ts.* = 0 must be"),
        (lambda t: t.isel(time=slice(1, None)), "time must be 0, Ts, 2 Ts"),
        (lambda t: t.isel(time=slice(0, None, 2)), "time must be 0, Ts, 2 Ts"),
        (lambda t: t.isel(time=slice(0, 0)), "trials have no samples"),
        (lambda t: t.assign_coords(trial=[1, 2, 2]), "none of them twice"),
        (
            lambda t: t.assign_coords(trial=[0, 1, 2]),
            "trials.trial = .*0.* must be a whole number",
        ),
        (lambda t: t.assign_coords(output=("channel", ["a\nb"])), "printable"),
        (lambda t: t.assign_coords(output=("channel", [""])), "printable"),
        (lambda t: t.assign_coords(output=("channel", ["\ud800"])), "printable"),
        (
            lambda t: t.assign_coords(control=("channel", ["depth"])),
            "'depth' has two units",
        ),
        (
            lambda t: t.assign_coords(output_unit=("channel", ["cubit/fortnite"])),
            "not understood",
        ),
        (lambda t: t.assign_attrs(format="mine"), "attribute 'format' cannot be"),
        (lambda t: t.assign_attrs({"a: b": "mine"}), "attribute 'a: b' cannot be"),
    ],
)
def test_what_would_not_be_read_alike_is_not_saved(tmp_path, good, changed, message):
    with pytest.raises(ValueError, match=message):
        save_log(changed(good), tmp_path / "other.csv")
    assert not (tmp_path / "other.csv").exists()


def test_a_simulated_run_is_saved_and_loaded(tmp_path, loop, Q):
    run = run_trials(loop, Law(Q, None), np.ones((30, 2)), None, 2)
    save_log(run, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(run)
