"""Logs in our format: read however they are written, or refused in a few printable words."""

import re
import warnings

import control
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    law_of,
    load_log,
    replay,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.errors import LogError
from ilctools.law.notes import with_law

SIGNALS = (
    '{"outputs": {"depth": "mm"}, "controls": {"valve, left": "l/min"}, '
    '"disturbances": {"rain": ""}}'
)
FORMAT = "rodlib trial log 2"
HEAD = f"# format: {FORMAT}\n# Ts: 1.0 s\n# signals: {SIGNALS}\n"
COLUMNS = 'trial,time,reference_depth,v_depth,"u_valve, left",y_depth,disturbance_rain\n'
ROWS = [f"{k},{p},1.0,0.5,{p}.25,0.75,2.0\n" for k in (1, 2, 3) for p in range(4)]
GOOD = HEAD + COLUMNS + "".join(ROWS)


def write(folder, text, **how):
    path = folder / "log.csv"
    path.write_text(text, newline="", **{"encoding": "utf-8"} | how)
    return path


@pytest.fixture
def good(tmp_path):
    with pytest.raises(LogError, match=r"log.csv: cannot be read"):
        load_log(tmp_path / "log.csv")
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
        ("log 2", "log 1", "format is .*log 1"),
        ("Ts: 1.0 s", "Ts: -1 s", "Ts = -1.0 must be"),
        ("# Ts", "# Ts: 2.0 s\n# Ts", "'Ts' appears twice"),
        (",y_depth,", ",depth,", r"\['y_depth'\] are missing, and \['depth'\] are unknown"),
        ('"controls": {', '"controls": {"fan": "", ', "must be as many controls"),
        ("# signals: ", "# signals:" + "[" * 10000, "signals"),
        ('"rain": ""', '"depth": "m"', "'depth' has two units"),
        ("1.0,0.5", "1.0,x", r"v_depth: entry 'x' in row 0 .*such entries: 12"),
        ("\n1,2,1.0", "\n# note\n\n1,2", "disturbance_rain: entry '' in row 2"),
        ("\n2,1,1.0", "\n2,1,1.0,1.0", "Expected 7 fields in line 10, saw 8"),
        (GOOD, HEAD + COLUMNS, "no rows"),
        ('"mm"', '"m\x1b[2Jm"', "signals cannot be understood"),
        ('"mm"', r'"m\nlaw: kept"', "unit of 'depth' = .*must be printable"),
        ("Ts: 1.0 s", f"Ts: {'x' * 200_000} s", "Ts = nan must be"),
        ("log 2", "l" * 200_000, "format is"),
        ("Ts: 1.0 s", "Ts: 1.0", "Ts is '1.0', but must be a number with a unit"),
        ("# Ts: 1.0 s\n", "", "Ts is '', but must be a number with a unit"),
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


HOSTILE = [
    *["-1", "0", "1e999", "nan", "1e-99", "1" * 5000, "1_000", "٣", "null", "{}"],
    *['"', "\\", '"\\ud800"', "\\u202e", "\x1b[2J", "\x85", "\x00", "\ufeff"],
    *["\n", "\r", ",", "# Ts: 1 s\n", "[" * 2000, '{"a": 1, "a": 2}', ""],
]
ACCIDENTS = st.lists(
    st.tuples(
        st.booleans(),  # in the head
        st.floats(0, 1),  # where
        st.sampled_from([0, 1, 3, 30, 3000]),  # how much goes
        st.sampled_from(HOSTILE) | st.text(max_size=3) | st.none(),  # what comes; or it twice
    ),
    min_size=1,
    max_size=3,
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """With a law and a loop, without a reset, with limits."""
    path, texts = tmp_path_factory.mktemp("logs") / "log.csv", []
    model = control.ss(0.8, 0.2, 1, 0, 0.1, inputs=["w"], outputs=["x"])
    loop = ClosedLoop(model, units={"x": "mm"})
    Q, L = zero_phase_butterworth(2, 3.0, 0.1), LearningFilter([[[0.5]]], 0.1)
    for limits, reset in (({}, True), ({}, False), ({"w": (-0.5, 0.9)}, True)):
        law = Law(Q, L, limits=limits, loop=loop)
        with warnings.catch_warnings(action="ignore"):
            run = run_trials(loop, law, bump(90, [1.0]), trials=3, reset=reset)
        save_log(with_law(run, law), path)
        texts.append(path.read_text(encoding="utf-8"))
    return path, texts


@settings(max_examples=60)
@given(st.integers(0, 2), ACCIDENTS)
def test_a_log_with_accidents_is_read_or_refused_in_a_few_printable_words(logs, kind, accidents):
    path, texts = logs
    text = texts[kind]
    for in_head, where, length, new in accidents:
        start = int(where * (text.rfind("\n#") + 200 if in_head else len(text)))
        old = text[start : start + length]
        text = text[:start] + (2 * old if new is None else new) + text[start + length :]
    path.write_bytes(text.encode(errors="surrogatepass"))
    try:
        with warnings.catch_warnings(action="ignore"):
            log = load_log(path)
            assert all(np.isfinite(log[name]).all() for name in ("reference", "v", "y"))
            law_of(log)
            said = str(replay(log))
    except ValueError as error:  # a LogError is one
        said = str(error)
        assert len(said) < 5000
    assert said.replace("\n", "").isprintable()
