"""Tables of others: what they say is read, and what is wrong is named by row and column."""

import gzip

import numpy as np
import pandas as pd
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from ilctools import load_log, read_table, save_log
from ilctools.loop.notes import LogError
from ilctools.signals import dataset
from rodlib.paper import ROOT

BOARD = ROOT / "data" / "tclab" / "board-1s.csv"
OUTPUTS = {"T1": "Temperature 1", "T2": "Temperature 2 (degC)"}
INPUTS = {"Q1": "Heater 1 (%)", "Q2": "Heater 2"}
SAMPLES = np.arange(30)
LEVEL = 30 - 0.25 * SAMPLES
VALVE = 10.0 * (SAMPLES % 8 < 4)


@st.composite
def layouts(draw):
    """A text as a logger may write it, and the arguments that read it."""
    delimiter = draw(st.sampled_from([",", ";", "\t", "|", " "]))
    decimal = draw(st.sampled_from(".," if delimiter != "," else "."))
    clock = draw(st.sampled_from(["s", "ms", "date", "day", "hour"]))
    titles = draw(st.sampled_from(["with units", "units below", "none", "comment"]))
    Ts = draw(st.sampled_from([0.02, 60.0]))
    order = draw(st.permutations(range(4)))
    start = pd.Timestamp("2024-02-28T23:59:50")

    def text(value):
        return f"{value:.6f}".replace(".", decimal)

    def moment(t):
        at = start + pd.Timedelta(t, "s")
        return {
            "s": text(t),
            "ms": text(1000 * t),
            "date": at.isoformat(),
            "day": at.strftime("%H:%M:%S.%f"),
            "hour": at.strftime("%M:%S.%f"),
        }[clock]

    def line(*entries):
        return delimiter.join(entries[k] for k in order)

    unit = "ms" if clock == "ms" else "s"
    names, units = ["t", "valve", "level", "state"], [unit, "%", "°C", "word"]
    both = line(*(f"{name}[{unit}]" for name, unit in zip(names, units, strict=True)))
    head = {
        "with units": [both],
        "comment": [f"# {both}"],
        "units below": [line(*names), line(*units)],
        "none": [],
    }[titles]
    rows = zip(Ts * SAMPLES, VALVE, LEVEL, strict=True)
    rows = [line(moment(t), text(u), text(y), "ok") for t, u, y in rows]
    above = draw(st.sampled_from([[], ["Logger 1: made by hand", ""]]))
    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    encoding = draw(st.sampled_from(["utf-8-sig", "utf-16", "latin-1"]))
    content = newline.join([*above, *head, *rows, ""]).encode(encoding)
    columns = [order.index(k) for k in range(3)] if titles == "none" else names[:3]
    labels = {"time": unit, "h": "°C"} if titles == "none" else {}
    return content, columns, labels, Ts


@settings(max_examples=30)
@given(layouts())
def test_a_table_is_read_however_it_is_laid_out(tmp_path_factory, layout):
    content, (t, u, y), units, Ts = layout
    path = tmp_path_factory.mktemp("tables") / "table.txt"
    path.write_bytes(content)
    log = read_table(path, time=t, inputs={"q": u}, outputs={"h": y}, units=units)
    assert log.attrs["Ts"] == pytest.approx(Ts, rel=1e-9)
    np.testing.assert_allclose(log.time, Ts * SAMPLES, rtol=1e-9)
    np.testing.assert_allclose(log.y[0, :, 0], LEVEL, rtol=1e-12)
    np.testing.assert_array_equal(log.u[0, :, 0], VALVE)
    assert log.output_unit.item() == "°C" and "clock" not in log.attrs


S = [[0.01 * k, np.sin(k), k % 3] for k in range(20)]
ROWS = ["\t".join(f"{x:.6f}" for x in row) for row in S]
NAMED = {"time": "t", "outputs": {"y": "y"}, "inputs": {"u": "u 1"}}


@pytest.mark.parametrize(
    ("text", "more"),
    [
        ("LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\nChannels\t2\n"
         "t\ty\tu 1\tComment\n" + "\t\n".join(ROWS) + "\t\n", {}),
        ('"t" "y" "u 1"\n'
         + "\n".join(f'"{k}" {row}' for k, row in enumerate(ROWS)).replace("\t", " "), {}),
        ("Model,MSO,\nSample,0.01,\n,,\nt,y,u 1\n" + "\n".join(ROWS).replace("\t", ","), {}),
        ("t,1,2\n" + "\n".join(ROWS).replace("\t", ","),
         {"outputs": {"y": "1"}, "inputs": {"u": "2"}}),
    ],
)  # fmt: skip
def test_what_usual_programs_write_is_read(tmp_path, text, more):
    """LabVIEW, R, an oscilloscope, a spreadsheet with numbers for titles."""
    (tmp_path / "table.txt").write_text(text)
    log = read_table(tmp_path / "table.txt", **NAMED | more)
    np.testing.assert_allclose(np.c_[log.time, log.y[0], log.u[0]], S, atol=1e-6)


def rows_of(steps=1.0):
    """The lines of a table with a clock whose steps are given."""
    time = np.cumsum(np.broadcast_to(steps, 30)) - 1
    return ["t (s),level"] + [f"{t:.2f},{y}" for t, y in zip(time, LEVEL, strict=True)]


def damaged(*lines):
    """Other lines in the place of row 12; row 2 is the first one below the titles."""
    rows = rows_of()
    return [*rows[:11], *lines, *rows[12:]]


def read(folder, lines, **more):
    (folder / "table.csv").write_text("\n".join(lines))
    columns = {"time": "t", "outputs": {"h": "level"}, "Ts": 1.0}
    return read_table(folder / "table.csv", **columns | more)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["t (K),level", *rows_of()[1:]], "unit of time = 'K'"),
        (["t;level", "0;1,5", "1;1.234,5"], "level: entry '1.234,5' in row 3"),
        (["t;level", *4 * ["0;1,5"], "2;2.5"], "level: entry '2,5' in row 6"),
        (["t;level", *4 * ["0;1,5"], "2;05.03.2024"], "level: entry '05.03.2024' in row 6"),
        (["t,level", *4 * ["0,1"], "2,"], "level: entry '' in row 6"),
        (["t,level", "29.02.2024,1", "01.03.2024,1"], "entry '29.02.2024' in row 2"),
        (["t,level"], "no rows of numbers"),
        (["t,level", '9,"1,200"', '10,"1,201"'], "row 2: is the comma of '1,200' a decimal one"),
        (["PK\x03\x04"], "save a spreadsheet as CSV"),
    ],
)
def test_what_is_wrong_is_named_by_file_row_and_column(tmp_path, lines, message):
    with pytest.raises(LogError, match=f"table.csv: .*{message}"):
        read(tmp_path, lines)


@pytest.mark.parametrize(
    "lines",
    [
        damaged("10.30,27.425"),
        damaged("10.00,"),
        damaged("10.00"),
        rows_of(1 + 0.04 * (-1.0) ** SAMPLES),
    ],
)
def test_what_is_not_on_time_is_interpolated_on_request(tmp_path, lines):
    """The level falls along a line."""
    with pytest.warns(UserWarning, match=r"table.csv: \d+ rows were resampled to \d+"):
        log = read(tmp_path, lines, resample=True)
    assert log.sizes["time"] >= 29
    np.testing.assert_allclose(log.y[0, :, 0], LEVEL[: log.sizes["time"]], atol=0.012)


def board(**more):
    columns = {"time": "Time", "outputs": OUTPUTS, "inputs": INPUTS}
    return read_table(BOARD, **columns | more)


def test_the_log_of_a_real_board_is_what_pandas_reads(tmp_path):
    log, table = board(), pd.read_csv(BOARD, skipinitialspace=True).to_numpy()
    np.testing.assert_array_equal(log.u[0], table[:, 1:3])
    np.testing.assert_array_equal(log.y[0], table[:, 3:5])
    assert log.attrs["Ts"] == 1.0 and log.output_unit.values.tolist() == ["degC"] * 2
    assert log.attrs["clock"].startswith("steps from 0.9903 to 1.021 s, median 1.001")
    save_log(log, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(log)
    with pytest.raises(LogError, match=r"format is None.*read_table"):
        load_log(BOARD)


def test_one_actuator_and_two_sensors_are_a_log():
    """What is controlled is chosen by name; the rest stays."""
    one = {"inputs": {"Q1": "Heater 1"}, "outputs": {"T1": "Temperature 1"}}
    log = board(**one, measured={"T2": 4}, disturbances={"Q2": 2}, reference={"T1": 5})
    both = board()
    np.testing.assert_array_equal(log.measured[..., 0], both.y[..., 1])
    np.testing.assert_array_equal(log.disturbance[..., 0], both.u[..., 1])
    np.testing.assert_array_equal(log.e, log.reference - log.y)
    assert not log.v.any() and log.sensor.values.tolist() == ["T2"]


def test_trials_in_a_table_of_others_are_those_that_were_run():
    """With a clock in minutes that jitters."""
    rng, Ts = np.random.default_rng(0), 0.1
    names = {"reference": "reference", "v": "v", "inputs": "u", "outputs": "y"}
    signals = {name: rng.normal(size=(3, 80, 2)) for name in names.values()}
    run = dataset(Ts, ["a", "b"], ["p", "q"], [], {}, **signals)
    table = pd.DataFrame({"run": np.repeat([0, 1, 2], 80)})
    table["clock [min]"] = Ts / 60 * (np.arange(240) + 0.03 * np.sin(np.arange(240)))
    for name, signal in signals.items():
        table[[f"{name} 0", f"{name} 1"]] = signal.reshape(240, 2)
    asked = {word: {"a": f"{name} 0", "b": f"{name} 1"} for word, name in names.items()}
    asked["inputs"] = {"p": "u 0", "q": "u 1"}
    log = read_table(table, time="clock", trial="run", Ts=Ts, **asked)
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
    assert read_table(dated, **columns, resample=True).identical(log)  # nothing to do
    without = read_table(frame, Ts=0.5, trial=0, outputs={"x": 2})
    np.testing.assert_array_equal(without.time, [0, 0.5, 1, 1.5])
    with pytest.raises(LogError, match="trial 5 has 3 samples and trial 1 has 4"):
        read_table(frame[:-1], **columns)
    with pytest.raises(LogError, match=r"outputs\['x'\] = 'x' must be the title of one column"):
        read_table(frame.set_axis(["run", "x", "x"], axis=1), Ts=1.0, outputs={"x": "x"})


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"time": "Tine"}, r"time = 'Tine' must .* the titles are \['Time \(sec\)'"),
        ({"time": 7}, "time = 7 must be .* from 0 to 6"),
        ({"reference": {"T1": 5}}, "missing are .*'reference_T2'"),
        ({"v": {"T1": 5, "T2": 6}}, "missing are .*'reference_T1'"),
        ({"measured": {"T3": 2.5}}, r"measured\['T3'\] = 2.5 must be"),
        ({"measured": {3: 2}}, "a name in measured = 3"),
        ({"time": None, "Ts": None}, "Ts = None"),
        ({"units": {"T3": "degC"}}, "units is about"),
        ({"Ts": 1e-3, "resample": True}, r"Ts = 0.001 s \(598 of 598 steps differ\)"),
    ],
)
def test_what_a_table_does_not_have_is_named(more, message):
    with pytest.raises(ValueError, match=message):
        board(**more)


@pytest.mark.parametrize(
    ("title", "unit"),
    [
        ("tempo_ms", 1e-3),
        ("t / us", 1e-6),
        ("t_µs", 1e-6),
        ("Time msec", 1e-3),
        ("Time S", 1.0),
        ("ms", 1e-3),
        ("rooms", 1.0),
    ],
)
def test_the_unit_of_a_clock_may_end_its_title(title, unit):
    frame = pd.DataFrame({title: 10.0 * SAMPLES, "y": LEVEL})
    log = read_table(frame, time=title, outputs={"y": "y"})
    assert log.attrs["Ts"] == pytest.approx(10 * unit)
    stated = read_table(frame, time=title, outputs={"y": "y"}, units={"y": "degC", "time": "min"})
    assert stated.output_unit.item() == "degC" and stated.attrs["Ts"] == pytest.approx(600)


@pytest.mark.parametrize(
    ("save", "load"),
    [(scipy.io.savemat, scipy.io.loadmat), (lambda path, file: np.savez(path, **file), np.load)],
)
def test_how_arrays_of_others_are_read_is_said(tmp_path, save, load):
    """What the message says makes a table of the file."""
    path = tmp_path / "log.npz"
    save(path, {"t": 0.5 * SAMPLES, "y": LEVEL})
    with pytest.raises(LogError, match=r"numpy.ravel\(file\[name\]\) .*scipy.io.loadmat"):
        read_table(path, time="t", outputs={"y": "y"})
    file = load(path)
    frame = pd.DataFrame({name: np.ravel(file[name]) for name in ("t", "y")})
    getattr(file, "close", int)()  # of numpy.load
    np.testing.assert_array_equal(read_table(frame, time="t", outputs={"y": "y"}).y[0, :, 0], LEVEL)


def test_compressed_text_and_quoted_commas_are_read(tmp_path, monkeypatch):
    rows = [f'"{k},0","{k / 4}"'.replace(".", ",") for k in range(9)]
    text = gzip.compress("\n".join(["t,level", *rows]).encode())
    (tmp_path / "log.csv.gz").write_bytes(text)
    log = read_table(tmp_path / "log.csv.gz", time="t", outputs={"h": "level"})
    assert log.attrs["Ts"] == 1
    assert log.y.values[0, :, 0].tolist() == [k / 4 for k in range(9)]
    (tmp_path / "log.csv.gz").write_bytes(text[:-9])
    for message in (r"csv\.gz: Compressed file ended", "holds more than 9 bytes"):
        with pytest.raises(LogError, match=message):
            read_table(tmp_path / "log.csv.gz", time="t", outputs={"h": "level"})
        monkeypatch.setattr("ilctools.logs.reader.LARGEST", 9)


def test_an_input_that_is_logged_at_every_tenth_row_is_not_resampled():
    time = 0.1 * np.arange(300)
    table = pd.DataFrame({"t": time, "u": np.where(np.arange(300) % 10, np.nan, 1.0), "y": time})
    columns = {"time": "t", "inputs": {"y": "u"}, "outputs": {"y": "y"}}
    with pytest.raises(LogError, match="30 of 300 rows have a number in each column: fill in"):
        read_table(table, **columns, resample=True)
    log = read_table(table.ffill(), **columns, resample=True)
    assert (log.sizes["time"], log.attrs["Ts"]) == (300, 0.1)
