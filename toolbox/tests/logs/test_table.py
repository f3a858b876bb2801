"""Tables of others: what they say is read, and what is wrong is named by row and column."""

import numpy as np
import pandas as pd
import pytest

from ilctools import read_table
from ilctools.errors import LogError
from ilctools.signals import dataset

SAMPLES = np.arange(30)
LEVEL = 30 - 0.25 * SAMPLES
VALVE = 10.0 * (SAMPLES % 8 < 4)


def test_a_table_is_read_however_it_is_laid_out(tmp_path):
    """By titles or numbers of columns, with a clock in ms, below two lines of another program."""
    columns = {"level[°C]": LEVEL, "t(ms)": 20 * SAMPLES, "state": "ok", "valve[%]": VALVE}
    text = pd.DataFrame(columns).to_csv(sep=";", decimal=",", index=False)
    text = f"Logger 1: made by hand\n\n{text}"
    (tmp_path / "table.txt").write_text(text, encoding="utf-16", newline="\r\n")
    options = {"sep": ";", "decimal": ",", "skiprows": 2, "encoding": "utf-16"}
    for y, t, u in ((0, 1, 3), ("level", "t(ms)", "valve")):
        asked = {"time": t, "inputs": {"q": u}, "outputs": {"h": y}}
        log = read_table(tmp_path / "table.txt", **asked, **options)
        assert log.attrs["Ts"] == pytest.approx(0.02, rel=1e-9) and "clock" not in log.attrs
        np.testing.assert_allclose(log.time, 0.02 * SAMPLES, rtol=1e-9)
        np.testing.assert_array_equal(log.y[0, :, 0], LEVEL)
        np.testing.assert_array_equal(log.u[0, :, 0], VALVE)
        assert log.output_unit.item() == "°C"


ROWS = [f"{0.5 * k},{y}" for k, y in enumerate(LEVEL)]


def read(folder, lines, **more):
    (folder / "table.csv").write_text("\n".join(lines))
    return read_table(folder / "table.csv", **{"time": "t", "outputs": {"h": "level"}} | more)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["t (K),level", *ROWS], "invalid unit abbreviation: K"),
        (["t,level", "0,1", "1,1.234.5"], "level: entry '1.234.5' in row 1"),
        (["t,level", "0,1", "1,"], "level: entry 'nan' in row 1 .* missing: interpolate"),
        (["t,level", "0,5,20,1", "1,0,20,3"], "more entries than there are titles.*decimal=','"),
        (["t,level", "29.02.2024,1", "01.03.2024,1"], "entry '29.02.2024' in row 0"),
        (["t;level", "0;1"], r"outputs\['h'\] = 'level' must be .* titles are \['t;level'\]"),
        (["t,level", *ROWS[:5], *ROWS[6:]], "row 5 is 1 s after the row before, but Ts = 0.518 s"),
        (["t,level"], "Ts = nan must be"),
        (["t,level", "2,1", "1,2", "0,2"], "Ts = -1.0 must be"),
        ([], "No columns to parse"),
    ],
)
def test_what_is_wrong_is_named_by_file_row_and_column(tmp_path, lines, message):
    with pytest.raises(LogError, match=f"table.csv: .*{message}"):
        read(tmp_path, lines)


def test_a_comma_after_the_last_entry_of_each_row_adds_no_column(tmp_path):
    log = read(tmp_path, ["t,level", *(f"{row}," for row in ROWS)])
    np.testing.assert_array_equal(log.y[0, :, 0], LEVEL)


def test_trials_in_a_table_of_others_are_those_that_were_run():
    """With a clock in minutes that jitters."""
    rng, Ts = np.random.default_rng(0), 0.1
    signals = {name: rng.normal(size=(3, 80, 1)) for name in ("reference", "v", "u", "y")}
    run = dataset(Ts, ["a"], ["p"], [], {}, **signals)
    table = pd.DataFrame({name: signal.ravel() for name, signal in signals.items()})
    table["run"] = np.repeat([0, 1, 2], 80)
    table["clock [min]"] = Ts / 60 * (np.arange(240) + 0.03 * np.sin(np.arange(240)))
    asked = {"reference": {"a": "reference"}, "v": {"a": "v"}, "outputs": {"a": "y"}}
    log = read_table(table, time="clock", trial="run", Ts=Ts, inputs={"p": "u"}, **asked)
    assert log.drop_attrs().equals(run.drop_attrs())


def test_a_data_frame_is_read_as_it_is():
    """Here with a clock of its own in each trial; another clock may go on, be dates or miss."""
    runs = [(k, 1.7e9 * k + t, 10.0 * k + t) for k in (0, 1, 4) for t in range(4)]
    frame = pd.DataFrame(runs, columns=["run", "at", "x"])
    columns = {"time": "at", "trial": "run", "outputs": {"x": "x"}}
    log = read_table(frame, **columns)
    assert log.trial.values.tolist() == [1, 2, 5] and log.attrs == {"Ts": 1.0}
    np.testing.assert_array_equal(log.y[..., 0], frame.x.to_numpy().reshape(3, 4))
    dated = frame.assign(at=pd.to_datetime(frame["at"], unit="s"))
    assert read_table(dated, **columns).identical(log)
    with pytest.raises(TypeError, match="sep"):
        read_table(frame, **columns, sep=";")
    without = read_table(frame, Ts=0.5, trial=0, outputs={"x": 2})
    np.testing.assert_array_equal(without.time, [0, 0.5, 1, 1.5])
    with pytest.raises(LogError, match=r"outputs\['x'\] = 'x' must be the title of one column"):
        read_table(frame.set_axis(["run", "x", "x"], axis=1), Ts=1.0, outputs={"x": "x"})


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"time": "Tine"}, r"time = 'Tine' must .* The titles are \['Time \(sec\)'"),
        ({"time": 7}, "time = 7 must be .* from 0 to 2"),
        ({"reference": {"h": 1}, "v": {}}, "'v_h'.* are missing"),
        ({"reference": {"h": "valve"}}, "is in m, but h is in mm: state the units"),
        ({"time": None}, "Ts = None"),
        ({"units": {"T3": "degC"}}, "units has the keys"),
        ({"Ts": 1e-3}, r"Ts = 0.001 s \(29 of 29 steps differ\).*units={'time': 'min'}"),
    ],
)
def test_what_a_table_does_not_have_is_named(more, message):
    frame = pd.DataFrame({"Time (sec)": 1.0 * SAMPLES, "level (mm)": LEVEL, "valve (m)": VALVE})
    asked = {"time": "Time", "outputs": {"h": "level"}, "inputs": {"q": "valve"}}
    with pytest.raises(ValueError, match=message):
        read_table(frame, **asked | more)


@pytest.mark.parametrize(
    ("title", "unit"),
    [("t_µs", 1e-6), ("t_ms [us]", 1e-6), ("Time us", 1e-6), ("T_MS ", 1e-3), ("rooms", 1.0)],
)
def test_the_unit_of_a_clock_may_end_its_title(title, unit):
    frame = pd.DataFrame({title: 10.0 * SAMPLES, "y": LEVEL})
    log = read_table(frame, time=title, outputs={"y": "y"})
    assert log.attrs["Ts"] == pytest.approx(10 * unit)
    stated = read_table(frame, time=title, outputs={"y": "y"}, units={"time": "min"})
    assert stated.attrs["Ts"] == pytest.approx(600)
