import re

import pytest
import xarray as xr

from ilctools import load_log
from ilctools.errors import LogError
from rodlib.paper import ROOT

SIGNALS = (
    '{"outputs": {"depth": "mm"}, "controls": {"valve, left": "l/min"}, '
    '"disturbances": {"rain": ""}}'
)
HEAD = f"# format: rodlib trial log 2\n# Ts: 1.0 s\n# signals: {SIGNALS}\n"
COLUMNS = 'trial,time,reference_depth,v_depth,"u_valve, left",y_depth,disturbance_rain\n'
ROWS = [f"{k},{p},1.0,0.5,{p}.25,0.75,2.0\n" for k in (1, 2, 3) for p in range(4)]
GOOD = HEAD + COLUMNS + "".join(ROWS)


def write(folder, text, **how):
    path = folder / "log.csv"
    path.write_text(text, newline="", **{"encoding": "utf-8"} | how)
    return path


@pytest.fixture
def good(tmp_path):
    return load_log(write(tmp_path, GOOD))


def test_a_log_written_by_hand_is_read(good):
    assert dict(good.sizes) == {"trial": 3, "time": 4, "channel": 1, "source": 1}
    assert good.u[1, 2, 0] == 2.25 and good.e[0, 0, 0] == 0.25
    assert good.u.attrs["units"] == "l/min" and good.e.attrs["units"] == "mm"
    names = [*good.output.values, *good.control.values, *good.source.values]
    assert [*names, *good.source_unit.values] == ["depth", "valve, left", "rain", ""]
    assert "delta" not in good and good.attrs == {"Ts": 1.0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("log 2", "log 1", "format is 'rodlib trial log 1'"),
        ("Ts: 1.0 s", "Ts: -1 s", "Ts = -1.0 must be"),
        ("Ts: 1.0 s", "Ts: 1.0", "Ts is '1.0', but must be a number and a unit"),
        ("Ts: 1.0 s", "Ts: 1.0 s s", "Ts is '1.0 s s', but must be a number and a unit"),
        ("# Ts: 1.0 s\n", "", "Ts is '', but must be a number and a unit"),
        ("# Ts", "# Ts: 2.0 s\n# Ts", "'Ts' stands twice"),
        (",y_depth,", ",depth,", r"missing are \['y_depth'\] and unknown \['depth'\]"),
        ('"mm"', "1", "unit of 'depth' = 1"),
        ('"controls": {', '"controls": {"fan": "", ', "must be as many"),
        ("# signals: ", "# signals:" + "[" * 10000, "signals"),
        ('"rain": ""', '"depth": "m"', "'depth' has two units"),
        ("1.0,0.5", "1.0,x", r"v_depth: entry 'x' in row 0 .*12 such"),
        ("\n1,2,1.0", "\n# note\n\n1,2", "disturbance_rain: entry '' in row 2"),
        ("\n2,1,1.0", "\n2,1,1.0,1.0", "Expected 7 fields in line 10, saw 8"),
        (GOOD, HEAD + COLUMNS, "no rows"),
        ('"mm"', '"m\x1b[2Jm"', "signals cannot be understood"),
        ('"mm"', r'"m\nlaw: kept"', "unit of 'depth' = .*all printable"),
        ("1.0,0.5", "1_0.0,0.5", "reference_depth: entry '1_0.0' in row 0"),
        ("Ts: 1.0 s", f"Ts: {'x' * 200_000} s", "Ts = nan must be"),
        ("log 2", "l" * 200_000, "format is"),
    ],
)
def test_broken_logs_say_what_is_wrong(tmp_path, old, new, message):
    with pytest.raises(LogError, match=f"log.csv: .*{message}") as error:
        load_log(write(tmp_path, GOOD.replace(old, new)))
    assert len(str(error.value).splitlines()) == 1 and len(str(error.value)) <= 1000


@pytest.mark.parametrize(
    "text",
    [
        "\N{BOM}" + GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("1.0,", '"1.0",'),
        GOOD.replace("# Ts", "# a comment\n\n# Ts"),
        GOOD.replace("\n2,0", "\n# a comment\n\n  \n# another: one\n2,0"),
        GOOD.replace("trial,time,", "trial, time, "),
        re.sub(",([123]),1", r",\1e3,1", GOOD.replace("1.0 s", "1e3 ms")),
        GOOD.replace(",2,1.0", ",2.0004,1.0"),  # as few digits leave of a step
    ],
)
def test_what_means_the_same_is_read_alike(tmp_path, good, text):
    trials = load_log(write(tmp_path, text))
    xr.testing.assert_allclose(trials, good, atol=1e-3)
    assert trials.attrs == {"Ts": 1.0}


def test_a_last_number_that_may_be_torn_is_not_read(tmp_path, good):
    for cut in range(1, len(ROWS[-1])):
        with pytest.warns(UserWarning, match="left out"):
            trials = load_log(write(tmp_path, GOOD[:-cut]))
        assert trials.identical(good[{"trial": slice(2)}])
    with pytest.warns(UserWarning, match="no line feed, and is left out"):
        assert load_log(write(tmp_path, GOOD + "4,0,1.0")).identical(good)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(LogError, match=r"nowhere.csv: cannot be read"):
        load_log(tmp_path / "nowhere.csv")


def test_the_example_in_the_readme_of_data_is_a_log(tmp_path):
    text = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    example = text.split("```text\n")[1].split("```")[0]
    assert load_log(write(tmp_path, example)).y.values.ravel().tolist() == [98.2, 98.3]
