import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from ilctools import load_log, save_log
from ilctools.signals import dataset

ODD_NAMES = ["time", "delta", "reference_y1", "2nd, left", 'the "hot" end', "#1", " ", "ϑ"]
NAMES = st.text(min_size=1, max_size=8).filter(str.isprintable) | st.sampled_from(ODD_NAMES)
FLOATS = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [-0.0, 5e-324, -1e300, 2.2250738585072011e-308, 0.1 + 0.2]
)


@pytest.fixture
def trials():
    values = np.arange(12.0).reshape(3, 4, 1)
    signals = {"reference": values, "v": -values, "u": values**2, "y": values / 3}
    units = {"depth": "mm", "valve, left": "l/min"}
    names = [["depth"], ["valve, left"], ["rain"]]
    return dataset(1.0, *names, units, disturbance=values + 1, **signals)


@st.composite
def any_trials(draw):
    m, count, samples = (draw(st.integers(1, 3)) for _ in range(3))
    names = draw(st.lists(NAMES, min_size=2 * m, max_size=2 * m + 2, unique=True))
    units = {name: draw(st.sampled_from(["°C", "my own", ""])) for name in names}

    def signal(channels):
        return draw(arrays.arrays(float, (count, samples, channels), elements=FLOATS))

    signals = {name: signal(m) for name in ("reference", "v", "u", "y")}
    if draw(st.booleans()):
        signals["delta"] = signal(m)
    outputs, controls, sources = names[:m], names[m : 2 * m], names[2 * m :]
    if sources:
        signals["disturbance"] = signal(len(sources))
    with np.errstate(over="ignore"):
        Ts = draw(st.floats(1e-9, 1e9))
        run = dataset(Ts, outputs, controls, sources, units, **signals)
    numbers = st.integers(1, 10**6)
    numbers = st.lists(numbers, min_size=count, max_size=count, unique=True)
    return run.assign_coords(trial=draw(numbers)).assign_attrs(note="a: b # c")


@settings(max_examples=10)
@given(any_trials())
def test_whatever_is_saved_is_loaded_bit_for_bit(tmp_path_factory, saved):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    save_log(saved.transpose(..., "time", "trial"), path)
    with np.errstate(over="ignore"):
        loaded = load_log(path)
    assert loaded.identical(saved)
    for name in saved.variables:
        if saved[name].dtype == float:
            assert loaded[name].values.tobytes() == saved[name].values.tobytes()
    again = path.with_name("again.csv")
    save_log(loaded, again)
    assert again.read_bytes() == path.read_bytes()


def test_pandas_alone_reads_a_log(tmp_path, trials):
    named = trials.assign_coords(control=("channel", ['the "first", #1']))
    save_log(named, tmp_path / "log.csv")
    table = pd.read_csv(tmp_path / "log.csv", comment="#")
    np.testing.assert_array_equal(table['u_the "first", #1'], trials.u.values.ravel())


def test_attributes_come_back_as_a_line_of_text(tmp_path, trials):
    notes = {"seed": 3, "list": np.array([1, 2.5]), "lines": "one\ntwo", "note": "a: b"}
    save_log(trials.assign_attrs(notes), tmp_path / "log.csv")
    attributes = load_log(tmp_path / "log.csv").attrs
    assert attributes.pop("Ts") == 1.0
    lines = {"seed": "3", "list": "[1.0, 2.5]", "lines": r'"one\ntwo"', "note": "a: b"}
    assert attributes == lines


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda t: t.drop_vars("v"), r"lack the signals \['v'\]"),
        (lambda t: t.assign(y=t.y.where(t.time < 2)), "trials.y has 6 values that are not finite"),
        (lambda t: t.assign_attrs(Ts=0), "Ts.* = 0 must be"),
        (lambda t: t.isel(time=slice(1, None)), "time must be 0, Ts, 2 Ts"),
        (lambda t: t.assign_coords(trial=[1, 2, 2]), "trials.trial"),
        (lambda t: t.assign_coords(output=("channel", ["a\nb"])), "printable"),
        (lambda t: t.assign_attrs(format="mine"), "attribute 'format'"),
    ],
)
def test_what_would_not_be_read_alike_is_not_saved(tmp_path, trials, changed, message):
    with pytest.raises(ValueError, match=message):
        save_log(changed(trials), tmp_path / "log.csv")
    assert not (tmp_path / "log.csv").exists()
