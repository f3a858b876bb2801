import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import stage, tanks

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    run_trials,
    zero_phase_butterworth,
)
from rodlib.ilc import replay_of, with_law
from rodlib.ilc.report import (
    about_the_law,
    by_unit,
    rms_by_trial,
    save_following,
    summary,
)

STAGE = current_trial_loop(stage(), ["F"], {"x": 1.0, "F": 10.0}, {"x": "mm", "F": "N"})
PUMPS = ["pump A", "pump B", "pump C"]
TANKS = current_trial_loop(
    tanks(), PUMPS, units=dict.fromkeys(["left", "middle", "right"], "cm")
)  # fmt: skip


def run_on(loop, scale=1.0):
    """Four trials without a disturbance."""
    m = loop.plant.noutputs
    Q = zero_phase_butterworth(2, 0.06 / loop.Ts, loop.Ts)
    L = LearningFilter(np.eye(m)[..., None] * [0, 0, 0, 0, 0, 0.5], loop.Ts)
    reference = np.outer(
        np.sin(np.pi * np.arange(150) / 150) ** 2, scale + np.arange(m) * scale
    )
    return with_law(
        run_trials(loop, Law(Q, L), reference, None, 4), Law(Q, L, loop=loop)
    )


@settings(max_examples=10)
@given(st.integers(1, 4), st.integers(0, 2), st.floats(1e-3, 10), st.integers(-9, 9))
def test_a_departure_from_the_law_is_found_whatever_the_unit(
    trial, channel, size, exponent
):
    run = run_on(TANKS, 10.0**exponent)
    largest = np.abs(run.v.values[..., channel]).max()
    assert np.all(replay_of(run).departure <= 1e-12 * 10.0**exponent)
    run["v"][trial - 1, 70, channel] += size * largest
    said = about_the_law(replay_of(run))
    assert said.startswith(f"v departs from the law from trial {trial} on, by ")
    assert said.endswith(f" cm in {TANKS.outputs[channel]}")
    amount = float(said.split("by ")[1].split()[0])
    assert amount == pytest.approx(size * largest, rel=0.06)


@pytest.mark.parametrize(
    "names", [["left", "middle", "right"], ['a, "b"', "# 2", "ϑ / K"]]
)
def test_what_to_apply_next_is_read_back_equal(names, tmp_path):
    trials = run_on(TANKS).assign_coords(output=("channel", names))
    del trials.attrs["loop"]  # of the plant's former names
    replay, path = replay_of(trials), tmp_path / "next.csv"
    save_following(replay, path)
    titles = pd.read_csv(path, comment="#", nrows=0).columns.tolist()
    assert titles == ["time", *(f"v_{name}" for name in names)]
    table = np.loadtxt(path, delimiter=",", skiprows=3)
    np.testing.assert_array_equal(table[:, 0], trials.time)
    np.testing.assert_array_equal(table[:, 1:], replay.following)
    first, second = path.read_text(encoding="utf-8").splitlines()[:2]
    assert first == "# ILC signal v of trial 5, to be added to the reference"
    units = {"time": "s"} | {f"v_{name}": "cm" for name in names}
    assert json.loads(second.removeprefix("# units: ")) == units


def test_errors_are_summed_over_channels_of_one_unit_only():
    e = run_on(TANKS).e
    one = rms_by_trial(e)
    assert one.columns.tolist() == ["RMS (cm)"] and one.index.tolist() == [1, 2, 3, 4]
    np.testing.assert_allclose(one["RMS (cm)"], np.sqrt((e.values**2).sum(2).mean(1)))
    mixed = rms_by_trial(e.assign_coords(output_unit=("channel", ["cm", "", "cm"])))
    assert mixed.columns.tolist() == ["RMS of left, right (cm)", "RMS of middle"]
    np.testing.assert_allclose(
        mixed["RMS of middle"], np.sqrt((e.values[..., 1] ** 2).mean(1))
    )
    expected = np.sqrt((e.values[..., [0, 2]] ** 2).sum(2).mean(1))
    np.testing.assert_allclose(mixed.iloc[:, 0], expected)
    assert by_unit(["K", "bar", "K"]) == {"K": [0, 2], "bar": [1]}


def test_the_summary_says_it_in_lines():
    lines = summary(replay_of(run_on(STAGE))).splitlines()
    assert lines[0] == "4 trials of 150 samples, Ts = 0.001 s"
    assert lines[1] == "law: the recorded v is that of the law in every trial"
    assert lines[3].split() == ["RMS", "(mm),", "log", "RMS", "(mm),", "simulation"]
    for k, line in enumerate(lines[5:9], 1):
        number, log, simulation = line.split()
        assert int(number) == k and log == simulation
    assert lines[9] == "fit of the model's prediction, mean of all trials: x 100 %"
    assert lines[10].startswith("share of the error left by the first of the trials")
    assert lines[11].split() == ["promised", "foretold", "reached", "noise"]
    for line in lines[13:]:  # the trials are the model's
        foretold, reached = line.split()[2:4]
        assert foretold == reached
    assert 14 <= len(lines) <= 20
