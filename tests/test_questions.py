"""docs/questions.md: each answer runs, and says what its heading asks."""

import re
from io import StringIO

import control
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from books import text
from documented import examples
from scipy.io import loadmat, savemat

from ilctools import measured_response, read_table, synthesise, zero_phase_butterworth
from ilctools.errors import LogError

TEXT = text("docs/questions.md")
SIGNALS = {  # of the batches
    "reference": {"T": "set"},
    "outputs": {"T": "T"},
    "units": {"time": "min", "T": "K"},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """What the blocks print, one after the other, and the names that they leave."""
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("questions"))
        said = StringIO()
        patch.setattr("sys.stdout", said)
        for block in examples("docs/questions.md"):
            exec(block, names)
        plt.close("all")
    return said.getvalue(), names


@pytest.fixture
def said(run):
    return run[0]


@pytest.fixture
def names(run):
    return run[1]


def rows_below(said, title):
    """The numbers in the rows below a line that begins with a title."""
    lines = iter(said.splitlines())
    while not next(lines).startswith(title):
        pass
    rows = []
    for line in lines:
        if not re.fullmatch(r"[\s\de.+nan-]+", line):
            break
        rows.append([*map(float, line.split())])
    return np.array(rows)


def test_the_lines_run_one_after_the_other(said):
    assert "for every plant within the radius" in said.splitlines()[0]  # of the table in a file
    shown = r"rate ([\d.e-]+),", r"([\d.e-]+) µm in"
    rates, left = ([*map(float, re.findall(what, said))] for what in shown)
    assert len(rates) == 3 and rates == sorted(rates) and rates[-1] < 1
    assert left == sorted(left, reverse=True)  # the fastest, not the one of least peak
    assert re.search(r"^(converges|diverges)", said, re.MULTILINE)
    transferred, from_zero = map(float, re.findall(r"([\d.e-]+) µm, and ([\d.]+)", said)[0])
    assert transferred < 0.2 * from_zero
    assert "commands up to 17.00 mm" in said
    assert float(re.findall(r"trial 10 leaves ([\d.e-]+) mm", said)[0]) < 0.1
    of_one, of_both = re.findall(r"([\d.e-]+) as designed, ([\d.]+) on the softer", said)
    assert float(of_one[0]) < 0.5 and float(of_one[1]) > 1 > float(of_both[1])
    whole, part = map(float, re.findall(r"v has ([\d.]+) µm", said))
    assert part < 0.6 * whole


def response_at(plant, omega, Ts):
    return plant(np.exp(1j * omega * Ts))


def test_decimal_commas_decibels_and_degrees_become_P(names):
    measured = names["measured"]
    exact = response_at(names["P"], measured.omega, 0.01)
    np.testing.assert_allclose(measured.frdata[0, 0], exact, rtol=1e-9)


def test_what_goes_wrong_with_a_table_reads_as_in_the_answer(names):
    assert "could not convert string to float: '0,159" in TEXT
    table = "Hz;dB;degrees\n0,159;0,01;-3,2\n0,2;0,02;-4\n0,3;0,02;-5\n"
    with pytest.raises(ValueError, match="could not convert string to float: '0,159'"):
        pd.read_csv(StringIO(table), sep=";").to_numpy(dtype=float)
    with pytest.raises(ValueError, match=r"not enough values to unpack \(expected 3, got 1\)"):
        _, _, _ = pd.read_csv(StringIO("Hz;dB;degrees\n1;0;-3\n")).to_numpy(dtype=str).T
    commas = table.replace(";", ",").replace("-4", "-4,0").replace("-5", "-5,0")
    table = pd.read_csv(StringIO(commas))
    assert not table.index.equals(pd.RangeIndex(len(table)))  # what the block asserts
    measured = names["measured"]
    in_Hz = control.frd(measured.frdata, measured.omega / (2 * np.pi), 0.01)
    with pytest.warns(UserWarning, match=r"(?i)\bHz\b"):
        synthesise(in_Hz, zero_phase_butterworth(2, 40.0, 0.01))


def test_a_model_and_a_record_come_from_matlab(names, said, tmp_path):
    omega = np.geomspace(1, 300, 50)
    P = names["P"]
    np.testing.assert_allclose(
        response_at(names["of_matlab"], omega, 0.01), response_at(P, omega, 0.01), rtol=1e-9
    )
    assert "Ts = 0.01 s, rate" in said
    record = names["record"]
    np.testing.assert_allclose(names["log"].y[0, :, 0], record["x"])
    np.testing.assert_allclose(names["log"].reference[0, :, 0], record["w"])
    savemat(tmp_path / "plant.mat", {"Ts": 0.01})
    with pytest.raises(ValueError, match=r"invalid timebase, dt = \[\[0.01\]\]"):
        control.ss(0.5, 1, 1, 0, loadmat(tmp_path / "plant.mat")["Ts"])
    with pytest.raises(ValueError, match=r"continuous"):
        synthesise(control.ss(-0.5, 1, 1, 0), names["Q"])
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / "new.mat").write_bytes(head + b"\x89HDF\r\n")
    with pytest.raises(NotImplementedError, match=r"Please use HDF reader for matlab v7\.3 files"):
        loadmat(tmp_path / "new.mat")


def test_simplified_matrices_lose_their_direction(tmp_path):
    plant = control.ss(np.diag([0.9, 0.5]), [[0.1], [0.2]], np.eye(2), 0, 1.0)
    matrices = {"A": plant.A, "B": plant.B, "C": plant.C, "D": plant.D}
    savemat(tmp_path / "plant.mat", matrices)
    simple = loadmat(tmp_path / "plant.mat", simplify_cells=True)
    with pytest.raises(control.ControlDimension):
        control.ss(*(simple[name] for name in "ABCD"), 1.0)
    file = loadmat(tmp_path / "plant.mat")
    assert control.ss(*(file[name] for name in "ABCD"), 1.0).D.shape == (2, 1)


def test_batches_with_missing_rows_become_records_and_trials(names, said):
    logs, heater = names["logs"], names["heater"]
    assert "[240, 240, 100, 110, 240] samples, Ts = 60.0 s" in said  # batch 3 is cut in two
    assert "trials [1 2 4] of 240 samples" in said
    omega = np.geomspace(1e-3, 0.05, 30)
    P, radius = measured_response(logs).on(omega, 0.95)
    assert np.all(np.abs(P[:, 0, 0] - response_at(heater, omega, 60.0)) <= radius)
    batches = [names["every_minute"](rows) for _, rows in names["table"].groupby("batch")]
    bridged = [names["log_of"](rows) for rows in batches]
    _, large = measured_response(bridged).on(omega, 0.95)
    assert 5 < large[0] / radius[0] < 20  # the gap is interpolated nevertheless


def test_what_goes_wrong_with_batches_reads_as_in_the_answer(names):
    table = names["table"]
    one = names["every_minute"](table[table["batch"] == 1])
    missing = one.assign(T=one["T"].where(one["minute"] != 20))
    whole = pd.concat([one, one.iloc[:-1].assign(batch=2.0)], ignore_index=True)
    as_seconds = SIGNALS | {"time": "t", "units": {"T": "K"}}
    untitled = one.rename(columns={"minute": "t"})
    for rows, more, message in (
        (table[table["batch"] == 1], {}, "row 18 is 120 s after the row before, but Ts = "),
        (missing, {}, "entry 'nan' in row 20 must be a finite number.* interpolate"),
        (whole, {"trial": "batch"}, "trials must be equally long, but trial "),
        (one.drop(columns="minute"), {}, "time = 'minute' must be the title of one column.*'set'"),
        (
            untitled,
            {"Ts": 60, **as_seconds},
            "row 1 is 1 s after the row before, but Ts = 60 s.*min",
        ),
    ):
        with pytest.raises(LogError, match=message):
            read_table(rows, **{"time": "minute", **SIGNALS, **more})
    assert read_table(untitled, **as_seconds).attrs["Ts"] == 1  # no error is possible
    titled = SIGNALS | {"units": {}}
    assert read_table(one, time="minute", **titled).attrs["Ts"] == 60


def test_the_rule_for_the_learning_gain_is_that_of_many_draws(said):
    rows = rows_below(said, "x/e_0")
    assert rows[:, :2].tolist() == [[x, a] for x in (0.1, 0.01) for a in (1.0, 0.5, 0.3, 0.1)]
    rng, draws = np.random.default_rng(0), 20_000
    for x, a, steps, *rule, seen, own, own_seen in rows:
        v = np.zeros(draws)  # of a scalar plant, P = L = Q = 1, e_0 = 1
        after = {}
        for step in range(101):
            new = x * rng.normal(size=draws)
            e = 1 - v - new
            after[step] = 100 * np.sqrt(np.mean(e**2))
            plant = 100 * np.sqrt(np.mean((1 - v) ** 2))
            v = v + a * e
        assert (1 - a) ** steps <= x * (1 + 1e-9) and (steps == 1 or (1 - a) ** (steps - 1) > x)
        # the draws scatter by 0.5 %; two of the columns have one decimal, the others two
        np.testing.assert_allclose(rule[:2], [after[5], after[20]], rtol=0.02, atol=0.05)
        np.testing.assert_allclose([rule[2], own], [after[100], plant], rtol=0.02, atol=0.005)
        if x == 0.1:  # the trials of the block: 390 values, related over 1 / a trials
            assert seen == pytest.approx(rule[2], rel=0.1)
            assert own_seen == pytest.approx(own, rel=3 / np.sqrt(2 * 390 * a / (2 - a)))
    finally_, of_plant = rows[:4, 5], rows[:4, 7]
    assert (finally_ / 10)[[0, 2, 3]].round(2).tolist() == [1.41, 1.08, 1.03]  # as the text says
    assert of_plant[3] / of_plant[0] == pytest.approx(0.25, abs=0.03)
    soon, late = map(float, re.findall(r"plant's own error is ([\d.]+) %", said))
    assert late < 0.5 * soon


def test_the_weight_of_norm_optimal_learning_leaves_what_the_formulas_say(names, said):
    rows = rows_below(said, "weight/")
    assert rows[:, 0].tolist() == [1e-4, 1e-2, 1.0]
    omega = np.linspace(0, 1, 4000) * np.pi / 0.01
    sigma = np.abs(response_at(names["P"], omega, 0.01))
    low = zero_phase_butterworth(2, 100.0, 0.01).frequency_response(omega)
    for share, at_top, at_tenth, gain, bound, noise in rows:
        weight = share * sigma.max() ** 2
        assert at_top == pytest.approx(share / (1 + share), abs=1e-4)
        assert at_tenth == pytest.approx(share / (0.01 + share), rel=0.02)
        assert gain == pytest.approx(bound, rel=0.01)
        assert bound == pytest.approx(0.5 / np.sqrt(weight), rel=0.01)
        M, QL = low * weight / (sigma**2 + weight), low * sigma / (sigma**2 + weight)
        power = QL**2 / (1 - M**2)  # where Q is 1, this is 1 / (sigma^2 + 2 weight)
        here = omega < 10
        of_text = 1 / (sigma**2 + 2 * weight)
        np.testing.assert_allclose(power[here], of_text[here], rtol=0.03)
        # trials of 400 samples have ends
        assert noise == pytest.approx(10 * np.sqrt(np.mean(power)), rel=0.1)


def test_the_weight_of_the_default_design_follows_from_L_max(names):
    design = names["synthesise"](names["P"], names["Q"])
    L_max = design.problem.L_max
    L = names["NormOptimal"](names["P"], 1 / (4 * L_max**2), 400)
    omega = design.omega
    np.testing.assert_allclose(
        design.filter.frequency_response(omega), L.frequency_response(omega), rtol=1e-3
    )
