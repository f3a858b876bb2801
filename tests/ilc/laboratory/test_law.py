"""Q and L in a file: what record is given is what was designed, or an error that says why not."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rodlib import LearningFilter, load_law, save_law, zero_phase_butterworth

COEFFICIENTS = arrays(float, (2, 2, 3), elements=st.floats(-1e9, 1e9))


@settings(max_examples=5)
@given(COEFFICIENTS, st.integers(1, 4), st.floats(0.1, 0.9), st.floats(1e-4, 1e4), st.text())
def test_filters_come_back_to_the_last_digit(
    tmp_path_factory, coefficients, order, share, Ts, note
):
    path = tmp_path_factory.mktemp("law") / "law.json"
    Q = zero_phase_butterworth(order, share * np.pi / Ts, Ts, ends="hold")
    L = LearningFilter(coefficients, Ts, "hold")
    save_law(path, Q, L, note)
    again, learning = load_law(path)
    assert again == Q
    np.testing.assert_array_equal(learning.coefficients, coefficients)
    assert (learning.Ts, learning.ends) == (Ts, "hold")
    assert json.loads(path.read_text(encoding="utf-8"))["note"] == note


@pytest.fixture
def law(Q):
    return Q, LearningFilter(np.ones((1, 1, 2)), 1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "rodlib law 9"}, "format 'rodlib law 9' is not 'rodlib law 1'"),
        ({"Ts": -1.0}, "Ts = -1.0 must be a positive sampling period"),
        ({"Q": {"order": 2}}, "KeyError"),
        ({"L": None}, "L = None must be a LearningFilter"),
        ({"L": {"coefficients": [1.0], "ends": "zero"}}, "coefficients has shape"),
        ({"L": {"coefficients": [[[True, 0.5]]], "ends": "zero"}}, "holds True or False"),
        ({"Ts": float("nan")}, "NaN is no number"),
    ],
)
def test_a_file_that_is_no_law_is_refused(tmp_path, law, changes, message):
    path = tmp_path / "law.json"
    save_law(path, *law)
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(ValueError, match=r"law.json' is no law of save_law: .*") as error:
        load_law(path)
    assert message in str(error.value)


def test_what_a_file_says_twice_is_refused(tmp_path, law):
    path = tmp_path / "law.json"
    save_law(path, *law)
    path.write_text(path.read_text().replace('"Ts"', '"Ts": 2.0, "Ts"'))
    with pytest.raises(ValueError, match="a name stands there twice"):
        load_law(path)


@pytest.mark.parametrize("text", ["", "[]", "3", "{}", "trial,time\n1,0", "[" * 9999])
def test_any_other_text_is_refused(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="is no law of save_law"):
        load_law(path)


def test_nothing_is_written_that_could_not_be_used(tmp_path, law):
    path = tmp_path / "law.json"
    with pytest.raises(ValueError, match=r"Q.Ts = 1.0 s, L.Ts = 2.0 s"):
        save_law(path, law[0], LearningFilter(np.ones((1, 1, 2)), 2.0))
    with pytest.raises(ValueError, match="L = None must be a LearningFilter"):
        save_law(path, law[0], None)
    with pytest.raises(ValueError, match="note = 3 must be a str"):
        save_law(path, *law, note=3)
    assert not path.exists()
    with pytest.raises(OSError):
        load_law(path)
