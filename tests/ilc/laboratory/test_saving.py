import os

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rodlib import load_log, run_trials, save_log
from rodlib.ilc.trials import dataset

NAMES = st.text(min_size=1, max_size=8).filter(str.isprintable) | st.sampled_from(
    [
        "v1",
        "y2",
        "time",
        "trial",
        "delta",
        "reference_y1",
        "2nd, left",
        'the "hot" end',
        "#1",
        " ",
        "ϑ",
    ]
)
ALIKE = st.sampled_from(["K", "mK", "degC", "°C", "mm", "µm", "N", "l/min", "%", "1/s**2", ""])
FLOATS = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [-0.0, 5e-324, -5e-324, 1e300, -1e300, 1e-300, 2.2250738585072011e-308, 0.1 + 0.2]
)


@pytest.fixture
def good():
    """Three trials of a tank, of four samples each."""
    shape = (3, 4, 1)
    signals = {"reference": 1.0, "v": 0.5, "u": 2.25, "y": 0.75, "disturbance": 2.0}
    units = {"depth": "mm", "valve, left": "l/min"}
    return dataset(
        1.0, ["depth"], ["valve, left"], ["rain"], units,
        **{name: np.full(shape, value) for name, value in signals.items()},
    )  # fmt: skip


@st.composite
def any_trials(draw):
    m, trials, samples = draw(st.integers(1, 3)), draw(st.integers(1, 3)), draw(st.integers(1, 4))
    names = draw(st.lists(NAMES, min_size=2 * m, max_size=2 * m + 2, unique=True))
    units = {name: draw(ALIKE) for name in names}
    signals = {
        name: draw(arrays.arrays(float, (trials, samples, m), elements=FLOATS))
        for name in ("reference", "v", "u", "y", *(["delta"] if draw(st.booleans()) else []))
    }
    sources = names[2 * m :]
    if sources:
        shape = (trials, samples, len(sources))
        signals["disturbance"] = draw(arrays.arrays(float, shape, elements=FLOATS))
    Ts = draw(st.floats(1e-9, 1e9))
    with np.errstate(over="ignore"):
        run = dataset(Ts, names[:m], names[m : 2 * m], sources, units, **signals)
    numbers = draw(st.lists(st.integers(1, 10**6), min_size=trials, max_size=trials, unique=True))
    text = st.text().filter(lambda note: note.isprintable() and note == note.strip())
    return run.assign_coords(trial=numbers).assign_attrs(origin=draw(text), note="a: b # c")


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
    assert list(titles[:2]) == ["trial", "time"] and f"y_{saved.output.values[0]}" in titles


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
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
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
    notes = {"seed": 3, "list": [1, 2.5], "lines": "one\ntwo", "when": np.datetime64("2024-02-29")}
    save_log(good.assign_attrs(notes), tmp_path / "log.csv")
    assert {k: v for k, v in load_log(tmp_path / "log.csv").attrs.items() if k != "Ts"} == {
        "seed": "3", "list": "[1, 2.5]", "lines": r'"one\ntwo"', "when": '"2024-02-29"'
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda t: None, "trials = None must be a Dataset"),
        (lambda t: t.drop_vars("u"), r"lack \['u'\]"),
        (lambda t: t.drop_vars("output"), r"lack the coordinates \['output'\]"),
        (lambda t: t.drop_vars("source_unit"), r"lack the coordinates \['source_unit'\]"),
        (lambda t: t.assign(y=t.y * np.nan), "not finite in 'y_depth'"),
        (lambda t: t.assign(y=t.y.where(t.time < 2)), "not finite in 'y_depth'"),
        (lambda t: t.assign_attrs(Ts=0), "Ts.* = 0 must be"),
        (lambda t: t.isel(time=slice(1, None)), "time must be 0, Ts, 2 Ts"),
        (lambda t: t.isel(time=slice(0, None, 2)), "time must be 0, Ts, 2 Ts"),
        (lambda t: t.isel(time=slice(0, 0)), "trials have no samples"),
        (lambda t: t.assign_coords(trial=[1, 2, 2]), "none of them twice"),
        (lambda t: t.assign_coords(trial=[0, 1, 2]), "trials.trial = .*0.* must be a whole number"),
        (lambda t: t.assign_coords(output=("channel", ["a\nb"])), "printable"),
        (lambda t: t.assign_coords(output=("channel", [""])), "printable"),
        (lambda t: t.assign_coords(output=("channel", ["\ud800"])), "printable"),
        (lambda t: t.assign_coords(control=("channel", ["depth"])), "'depth' has two units"),
        (lambda t: t.assign_coords(output_unit=("channel", ["cubit/fortnite"])), "not understood"),
        (lambda t: t.assign_attrs(format="mine"), "attribute 'format' cannot be"),
        (lambda t: t.assign_attrs({"a: b": "mine"}), "attribute 'a: b' cannot be"),
        (lambda t: t.assign_attrs(limits='{"y_depth": [0, 0.5]}'), "'y_depth' .* from 0 to 0.5"),
        (lambda t: t.assign_attrs(limits='{"depth": [0, 0.5]}'), "no columns"),
    ],
)
def test_what_would_not_be_read_alike_is_not_saved(tmp_path, good, changed, message):
    with pytest.raises(ValueError, match=message):
        save_log(changed(good), tmp_path / "other.csv")
    assert not (tmp_path / "other.csv").exists()


def test_a_simulated_run_is_saved_and_loaded(tmp_path, loop, Q):
    run = run_trials(loop, Q, None, np.ones((30, 2)), None, 2)
    save_log(run, tmp_path / "log.csv")
    assert load_log(tmp_path / "log.csv").identical(run)
