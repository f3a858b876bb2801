"""Tables of others: what is written is read, and what is wrong is told by row and column."""

import re
import warnings
from dataclasses import dataclass, field

import control
import numpy as np
import pandas as pd
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rodlib import (
    ClosedLoop,
    Law,
    LogError,
    current_trial_loop,
    load_log,
    read_table,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from rodlib.ilc import p_type, replay, with_law
from rodlib.paper.repository import ROOT

BOARD = ROOT / "data" / "tclab" / "board-1s.csv"
ASKED = {
    "inputs": {"Q1": "Heater 1 (%)", "Q2": "Heater 2"},
    "outputs": {"T1": "Temperature 1", "T2": "Temperature 2 (degC)"},
}
WHOLE = st.sampled_from
SPOILT = (
    "late",
    "lost",
    "swapped",
    "twice",
    "text",
    "missing",
    "short",
    "long",
    "wrong column",
)


@dataclass
class Written:
    """A table as somebody's logger may write it, and what it says."""

    delimiter: str = ","
    decimal: str = "."
    titles: str = "with units"
    clock: str = "s"
    encoding: str = "utf-8"
    newline: str = "\n"
    form: str = ".6f"
    quoted: bool = False
    above: int = 0
    order: list[int] = field(default_factory=lambda: [0, 1, 2, 3, 4])
    Ts: float = 1.0
    samples: int = 30
    spoilt: str = ""
    row: int = 12

    def __post_init__(self):
        k = np.arange(self.samples)
        if self.spoilt == "late":
            k = np.where(k == self.row, k + 0.3, k)
        if self.spoilt == "jitter":
            k = k + 0.04 * (-1.0) ** k
        if self.spoilt == "lost":
            k = np.delete(k, [self.row, self.row + 1])
        if self.spoilt == "twice":
            k = np.insert(k, self.row, k[self.row])
        if self.spoilt == "swapped":
            k[[self.row, self.row + 1]] = k[[self.row + 1, self.row]]
        self.time, self.u, self.y = (
            self.Ts * k,
            10.0 * (np.round(k) % 8 < 4),
            30 - 0.25 * k,
        )

    def number(self, value):
        text = f"{value:{self.form}}".replace(".", self.decimal)
        return f'"{text}"' if self.quoted else text

    def moment(self, t):
        if self.clock in ("s", "ms"):
            return self.number(t if self.clock == "s" else 1000 * t)
        at = pd.Timestamp("2024-02-28T23:59:50") + pd.Timedelta(t, "s")
        return (
            at.isoformat()
            if self.clock == "date"
            else f"{at - pd.Timestamp('2024-02-28')}"[7:]
        )

    def text(self):
        rows = [
            [self.moment(t), self.number(u), self.number(y), "ok", "7"]
            for t, u, y in zip(self.time, self.u, self.y, strict=True)
        ]
        if self.spoilt in ("text", "missing"):
            rows[self.row][2] = {"text": "off", "missing": ""}[self.spoilt]
        unit = (
            ""
            if self.titles == "plain"
            else f" [{'ms' if self.clock == 'ms' else 's'}]"
        )
        titles = [
            f"t{unit}",
            "valve",
            "level" + (" (°C)" if unit else ""),
            "state",
            "seven",
        ]
        titles = [
            title.replace(" ", "_" if self.delimiter == " " else " ")
            for title in titles
        ]
        if self.delimiter == " ":
            titles = [title.replace("_[", "[").replace("_(", "(") for title in titles]
        lines = [self.delimiter.join(row[k] for k in self.order) for row in rows]
        if self.spoilt == "short":
            lines[self.row] = self.delimiter.join(
                lines[self.row].split(self.delimiter)[:2]
            )
        if self.spoilt == "long":
            lines[self.row] += f"{self.delimiter}1"
        head = [f"Logger {k}: made by hand" for k in range(self.above)]
        line = self.delimiter.join(titles[k] for k in self.order)
        head += {"none": [], "comment": [f"# {line}"]}.get(self.titles, [line])
        self.first = len(head) + 1
        return self.newline.join([*head, *lines, "", ""])

    def read(self, folder, **more):
        path = folder / "table.txt"
        path.write_bytes(self.text().encode(self.encoding))
        named = [self.order.index(k) for k in range(3)] if self.titles == "none" else []
        t, u, y = named or ("t", "valve", "level")
        if self.titles == "plain" or named:
            more |= {
                "units": {"time": "ms" if self.clock == "ms" else "s", "h": "degC"}
            }
        if self.spoilt == "wrong column":
            t, y = y, t
        return read_table(path, time=t, inputs={"q": u}, outputs={"h": y}, **more)


@st.composite
def written(draw, spoilt):
    delimiter = draw(WHOLE([",", ";", "\t", "|", " "]))
    return Written(
        delimiter,
        draw(WHOLE(".," if delimiter != "," else ".")),
        draw(WHOLE(["with units", "plain", "none", "comment"])),
        draw(WHOLE(["s", "ms", "date", "day"])),
        draw(WHOLE(["utf-8", "utf-8-sig", "utf-16", "latin-1"])),
        draw(WHOLE(["\n", "\r\n", "\r"])),
        draw(WHOLE([".6f", ".9e", ".12g"])),
        draw(st.booleans()) and delimiter != " ",
        draw(st.integers(0, 3)),
        draw(st.permutations(range(5))),
        draw(WHOLE([0.02, 1.0, 3.0, 60.0])),
        draw(st.integers(25, 40)),
        draw(WHOLE(spoilt)),
        draw(st.integers(1, 20)),
    )


def is_right(log, table):
    assert log.attrs["Ts"] == pytest.approx(table.Ts, rel=1e-9)
    k = np.arange(log.sizes["time"])
    np.testing.assert_allclose(log.time, table.Ts * k, rtol=1e-9)
    np.testing.assert_allclose(log.y.values[0, :, 0], 30 - 0.25 * k, atol=0.02)
    np.testing.assert_array_equal(
        log.u.values[0, :, 0], table.u if len(table.u) == len(k) else log.u[0, :, 0]
    )
    assert log.output_unit.item() in ("degC", "°C")


@settings(max_examples=120)
@given(written(["", "jitter"]))
def test_however_a_table_is_laid_out_it_is_read_as_it_was_written(
    tmp_path_factory, table
):
    with warnings.catch_warnings(action="error"):
        Ts = (
            {"Ts": table.Ts} if table.spoilt else {}
        )  # which a clock that is off tells roughly
        log = table.read(tmp_path_factory.mktemp("tables"), **Ts)
    is_right(log, table)
    assert ("clock" in log.attrs) == (table.spoilt == "jitter")


@settings(max_examples=120)
@given(written(SPOILT))
def test_what_is_wrong_is_told_by_file_row_and_column(tmp_path_factory, table):
    with pytest.raises(LogError) as error:
        table.read(tmp_path_factory.mktemp("tables"), Ts=table.Ts)
    said = str(error.value)
    assert "table.txt: " in said and len(said) < 400
    assert "1 problem" in said or "is none of time" in said
    row = (
        table.first
        + table.row
        + {"lost": 0, "twice": 1, "swapped": 1}.get(table.spoilt, 0)
    )
    if table.spoilt == "wrong column":
        assert "row" in said or "time = 'level': unit '°C' is none of time" in said
        return
    if table.spoilt in ("late", "swapped"):
        assert re.search(rf"row ({row}|{row + 1}) ", said)
    else:
        assert re.search(rf"row {row}\b", said), row
    if table.spoilt in ("text", "missing"):
        assert "level" in said or table.titles == "none" or table.delimiter == " "


@settings(max_examples=60)
@given(written(["late", "lost", "jitter", "missing", "short"]))
def test_what_is_not_on_time_is_interpolated_on_request(tmp_path_factory, table):
    """The level falls along a line, which is what it is between samples, too."""
    with pytest.warns(
        UserWarning, match=r"table.txt: \d+ rows were resampled to \d+ samples"
    ):
        log = table.read(tmp_path_factory.mktemp("tables"), Ts=table.Ts, resample=True)
    k = np.arange(log.sizes["time"])
    np.testing.assert_allclose(log.y.values[0, :, 0], 30 - 0.25 * k, atol=0.012)
    held = np.delete(k, [table.row, table.row + 1]) if table.spoilt != "jitter" else k
    np.testing.assert_array_equal(log.u.values[0, held, 0], 10.0 * (held % 8 < 4))
    assert "resampled" in log.attrs and log.sizes["time"] >= table.samples - 1


def board(**more):
    return read_table(BOARD, **{"time": "Time", "Ts": 1.0} | ASKED | more)


def test_the_log_of_a_real_board_is_what_pandas_reads(tmp_path):
    log, table = board(), pd.read_csv(BOARD, skipinitialspace=True).to_numpy()
    np.testing.assert_array_equal(log.u[0], table[:, 1:3])
    np.testing.assert_array_equal(log.y[0], table[:, 3:5])
    assert (
        log.output_unit.values.tolist() == ["degC"] * 2 and log.control_unit[0] == "%"
    )
    assert log.attrs["clock"].startswith(
        "steps from 0.9903 to 1.021 s, median 1.001, where Ts = 1"
    )
    assert board(Ts=None).attrs["Ts"] == 1.0
    save_log(log, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(log)
    with pytest.raises(
        LogError, match=r"format is None.*: rodlib.read_table reads other tables"
    ):
        load_log(BOARD)


def test_one_actuator_and_two_sensors_are_a_log(tmp_path):
    """What is controlled is chosen by name; the rest is kept."""
    one = {"inputs": {"Q1": "Heater 1"}, "outputs": {"T1": "Temperature 1"}}
    with pytest.raises(ValueError, match=r"must be as many, .* measured in measured"):
        board(inputs=one["inputs"])
    log = board(**one, measured={"T2": 4}, disturbances={"Q2": 2}, reference={"T1": 5})
    both = board()
    np.testing.assert_array_equal(log.measured[..., 0], both.y[..., 1])
    np.testing.assert_array_equal(log.disturbance[..., 0], both.u[..., 1])
    np.testing.assert_array_equal(log.e, log.reference - log.y)
    assert not log.v.any() and log.sensor.values.tolist() == ["T2"]
    save_log(log, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(log)


def test_a_table_is_replayed_with_the_law_that_it_is_told():
    log = board(reference={"T2": 6, "T1": 5})
    np.testing.assert_array_equal(
        log.reference[0], pd.read_csv(BOARD).to_numpy()[:, 5:]
    )
    assert replay(log).following is None
    Q = zero_phase_butterworth(2, 0.1, 1.0)
    L = p_type(0.5, 3, 2, 1.0)
    following = replay(with_law(log, Law(Q, L))).following
    np.testing.assert_allclose(
        following, Law(Q, L).next(log.v.values[0], log.e.values[0])
    )
    with pytest.raises(ValueError, match=r"trials lack \['reference', 'v'\]"):
        replay(board())


@pytest.mark.parametrize("name", ["stage", "tanks", "furnace", "another's"])
def test_trials_in_a_table_of_others_replay_as_if_they_were_ours(tmp_path, name):
    """A stage in mm, tanks with three channels, a long delay, and a controller that is not ours."""
    if name == "another's":
        loop, ahead = (
            ClosedLoop(
                control.ss(0.8, 0.2, 1, 0, 0.1, inputs=["w"], outputs=["level"])
            ),
            1,
        )
    else:
        plant, controls = {
            "stage": (plants.stage(), ["F"]),
            "tanks": (plants.tanks(), ["pump A", "pump B", "pump C"]),
            "furnace": (plants.furnace(), ["valve"]),
        }[name]
        loop, ahead = current_trial_loop(plant, controls), 31
    m, Ts = len(loop.outputs), loop.Ts
    Q, L = zero_phase_butterworth(2, 0.3 / Ts, Ts), p_type(0.01, ahead, m, Ts)
    reference = np.sin(np.linspace(0, 3, 80))[:, None] * np.arange(1, m + 1)
    ran = run_trials(loop, Law(Q, L), reference, None, 3)
    signals = {"ref": ran.reference, "ff": ran.v, "y": ran.y} | (
        {"u": ran.u} if "u" in ran else {}
    )
    table = pd.DataFrame({"run": np.repeat([0, 1, 2], 80)})
    table["clock [min]"] = Ts / 60 * (np.arange(240) + 0.03 * np.sin(np.arange(240)))
    for word, signal in signals.items():
        table[[f"{word} {n}" for n in range(m)]] = signal.values.reshape(240, m)
    table.to_csv(tmp_path / "rig.txt", sep=";", decimal=",", index=False)

    def named(word, names):
        return {n: f"{word} {k}" for k, n in enumerate(names)}

    log = read_table(
        tmp_path / "rig.txt", time="clock", trial="run", Ts=Ts,
        outputs=named("y", loop.outputs), reference=named("ref", loop.outputs),
        v=named("ff", loop.outputs), inputs=named("u", loop.controls) if "u" in ran else None,
    )  # fmt: skip
    replayed = replay(with_law(log, Law(Q, L, loop=loop)))
    assert replayed.agreement == "the recorded v is that of the law in every trial"
    np.testing.assert_allclose(replayed.simulated.y, ran.y, atol=1e-12)
    assert replayed.fit.min(axis=None) > 1 - 1e-6


def test_trials_stand_one_after_the_other_with_a_clock_of_their_own_or_one_for_all(
    tmp_path,
):
    day = 1.7e9  # s, since 1970
    runs = [(k, day * (k > 0) + t, 10 * k + t) for k in (0, 1, 4) for t in range(4)]
    frame = pd.DataFrame(runs, columns=["run", "at", "x"])
    log = read_table(frame, time="at", trial="run", outputs={"x": "x"})
    assert log.trial.values.tolist() == [1, 2, 5] and log.attrs == {"Ts": 1.0}
    np.testing.assert_array_equal(log.y[..., 0], frame.x.to_numpy().reshape(3, 4))
    again = read_table(frame, time="at", trial="run", outputs={"x": "x"}, resample=True)
    assert again.identical(log)  # and no warning, as there is nothing to do
    without = read_table(frame, Ts=0.5, trial=0, outputs={"x": 2})
    np.testing.assert_array_equal(without.time, [0, 0.5, 1, 1.5])
    with pytest.raises(LogError, match=r"row 10 of trial 1 is at .*, not later than"):
        read_table(frame.assign(run=1), time="at", outputs={"x": "x"}, Ts=1.0)
    with pytest.raises(LogError, match="3 samples in trial 5; 4 samples in trial 1, 2"):
        read_table(frame[:-1], time="at", trial="run", outputs={"x": "x"}, Ts=1.0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"time": "Tine"}, r"time = 'Tine' is no column: did you mean 'Time'\? It has"),
        ({"time": 7}, "time = 7 must be from 0 to 6, as the rows have 7"),
        ({"reference": {"T1": 5, "T2": 5}},
         r"reference\['T2'\] = 5 is the column of reference\['T1'\], too"),
        ({"reference": {"T1": 5}}, r"reference is of \['T1'\], but outputs are \['T1', 'T2'\]"),
        ({"v": {"T1": 5, "T2": 6}}, "v is given, but no reference"),
        ({"measured": {"T1": 5}}, "must have different names"),
        ({"measured": {"T3": 2.5}}, r"measured\['T3'\] = 2.5 must be a title or a number"),
        ({"measured": {3: 2}}, "measured names 3, but must name signals by text"),
        ({"time": None, "Ts": None}, "Ts = None must be a sampling period"),
        ({"units": {"T3": "degC"}}, "units is about .*'T3'.*, but must name some of"),
        ({"units": {"T1": "degR"}, "Ts": 2.0}, "row 3 of trial 1 is 1.00128 after the row before, "
         r"where Ts = 2: irregular sampling \(598 such steps\); resample=True interpolates"),
        ({"Ts": 1.02}, "the mean step is 1.00151, but Ts = 1.02: state that as Ts"),
        ({"Ts": 1e-9, "resample": True}, "row 3 of trial 1 is 1.00128 after the row before"),
    ],
)  # fmt: skip
def test_what_a_table_has_not_is_told(more, message):
    with pytest.raises(ValueError, match=message):
        board(**more)


S = [[0.01 * k, np.sin(k), k % 3] for k in range(20)]
ROWS = ["\t".join(f"{x:.6f}" for x in row) for row in S]
NAMED = {"time": "t", "outputs": {"y": "y"}, "inputs": {"u": "u 1"}}


@pytest.mark.parametrize(
    ("text", "more"),
    [
        ("LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n\nChannels\t2\n"
         "t\ty\tu 1\tComment\n" + "\t\n".join(ROWS) + "\t\n", {}),
        ("t;y;u 1\ns;bar;%\n" + "\n".join(ROWS).replace("\t", ";").replace(".", ","), {}),
        ('"t" "y" "u 1"\n'
         + "\n".join(f'"{k}" {row}' for k, row in enumerate(ROWS)).replace("\t", " "), {}),
        ("Model,MSO,\nSample,0.01,\n,,\nt,y,u 1\n" + "\n".join(ROWS).replace("\t", ","), {}),
        ("\n".join(ROWS), {"time": 0, "outputs": {"y": 1}, "inputs": {"u": 2}}),
        ("% t, y, u 1\n" + "\n".join(ROWS).replace("\t", " ,  ") + "\n% the end", {}),
        ("t,1,2\n" + "\n".join(ROWS).replace("\t", ","),
         {"outputs": {"y": "1"}, "inputs": {"u": "2"}}),
    ],
)  # fmt: skip
def test_what_usual_programs_write_is_read(tmp_path, text, more):
    """LabVIEW, a logger with a line of units, R, an oscilloscope, numpy, Octave, a spreadsheet."""
    (tmp_path / "table.txt").write_text(text)
    log = read_table(tmp_path / "table.txt", **NAMED | more)
    np.testing.assert_allclose(np.c_[log.time, log.y[0], log.u[0]], S, atol=1e-6)
    assert log.output_unit.item() == ("bar" if "bar" in text else "")


def test_a_unit_that_nobody_knows_is_left_out():
    frame = pd.DataFrame({"t (s)": range(4), "x (bogus)": 1.0})
    with pytest.warns(
        UserWarning, match="unit 'bogus' of x is not understood: it is left out"
    ):
        log = read_table(frame, time="t", outputs={"x": "x"})
    assert log.output_unit.item() == ""
    frame = pd.DataFrame({"x": [1.0], "x ": [2.0]}).rename(columns=str.strip)
    with pytest.raises(
        LogError, match="'x' is the title of several columns: give its number"
    ):
        read_table(frame, Ts=1.0, outputs={"x": "x"})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no rows of numbers are found"),
        (b"t,x\n", "no rows of numbers are found"),
        (b"\x89PNG\r\n\x1a\n\0", "is no text: let pandas read it"),
        (
            b"t,x\n0,1\n1,2\n1,3\n",
            "row 4 of trial 1 is at 1, not later than the row before",
        ),
        (b"t,x\n0,1\n0,2\n", "the clock stands still, or there is one row: state Ts"),
        (b"t,x\n0,1\n1,inf\n", "x: entry is 'inf', not a finite number, in row 3"),
        (b"t,x\n0,1\n1,1e400\n", "x: entry is '1e400', not a finite number, in row 3"),
        (
            b"t;x\n0;1,5\n1;1.234,5\n",
            "x: entry is '1.234,5', not a finite number, in row 3",
        ),
        (
            b"t;x\n0;1,5\n1;1,5\n2;1,5\n3;1,5\n4;2.5\n",
            "x: entry is '2.5', not a finite number",
        ),
        (
            b"t,x\n29.02.2024,1\n01.03.2024,1\n",
            "t: entry is '29.02.2024', not a finite number",
        ),
    ],
)
def test_what_is_no_table_of_signals_is_told(tmp_path, content, message):
    (tmp_path / "table.csv").write_bytes(content)
    with pytest.raises(LogError, match=re.escape(message)):
        read_table(tmp_path / "table.csv", time="t", outputs={"x": "x"})
