"""How arguments are checked: what may pass, and what the errors say."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from ilctools import arguments


@given(st.floats() | st.integers() | st.fractions(), st.floats(-5, 5), st.floats(-5, 5))
def test_a_number_lies_strictly_between_its_limits(value, low, high):
    if low < value < high:
        assert arguments.number("x", value, "right", low, high) == float(value)
    else:
        with pytest.raises(ValueError, match=r"x = .* must be right"):
            arguments.number("x", value, "right", low, high)


@given(st.integers(-3, 9), st.integers(-3, 3), st.none() | st.integers(0, 5))
def test_a_whole_number_may_be_its_limits(value, low, high):
    if value >= low and (high is None or value <= high):
        for same in (value, np.int16(value)):
            assert type(arguments.whole("n", same, low, high)) is int
    else:
        limits = f"{low} or more" if high is None else f"from {low} to {high}"
        with pytest.raises(ValueError, match=f"n = {value} must be a whole number, {limits}"):
            arguments.whole("n", value, low, high)


@pytest.mark.parametrize(
    ("shape", "sizes", "fits"),
    [
        ((2, "m"), (2, 5), True),
        ((2, "m"), (3, 5), False),
        ((2, "m"), (2, 0), False),
        (("m", "m"), (3, 4), False),
        ((..., 2), (7, 8, 2), True),
        ((..., "t", 2), (2,), False),
        ((...,), (), True),
    ],
)
def test_shapes(shape, sizes, fits):
    value = np.ones(sizes)
    if fits:
        np.testing.assert_array_equal(arguments.array("x", value, shape), value)
        return
    with pytest.raises(ValueError, match=re.escape(f"x has shape {sizes}")):
        arguments.array("x", value, shape)


def test_an_array_is_a_copy_of_the_type_asked_for():
    given_ = np.arange(3)
    copy = arguments.array("x", given_, (3,))
    copy[0] = 9
    assert given_[0] == 0 and copy.dtype == float
    assert arguments.array("x", given_, (3,), complex).dtype == complex
    unmasked = np.ma.masked_array([1.0], [False])
    assert type(arguments.array("x", unmasked, (1,))) is np.ndarray


def test_a_signal_gets_the_labels_of_another_in_their_order():
    frame = pd.DataFrame(np.zeros((2, 3), int), columns=["b", "c", "a"])
    labelled = arguments.labelled_as(frame, np.array([[0.1, 0.2, 0.3]] * 2), ["a", "b", "c"])
    assert labelled.to_dict("list") == {"b": [0.2] * 2, "c": [0.3] * 2, "a": [0.1] * 2}


def test_what_is_at_a_limit_passes():
    assert arguments.flag("x", np.True_) is True
    top = np.pi / 0.5
    assert arguments.increasing_frequencies("omega", [0, top], 0.5).tolist() == [0, top]
    assert arguments.row("x", 2.0).tolist() == [2.0]


DATA = xr.Dataset({"y": 0.0, "e": 1.0})
REFUSED = [  # a call, and how the error begins
    (lambda: arguments.increasing_frequencies("w", [0, 6.29], 0.5), "w spans"),
    (lambda: arguments.increasing_frequencies("w", [-0.1, 1], 0.5), "w spans"),
    (lambda: arguments.increasing_frequencies("w", [1, 1], 0.5), "w, of shape"),
    (lambda: arguments.array("x", True, (...,)), "x holds values of type bool"),
    (lambda: arguments.array("P", DATA, ("n",)), "P must .* or is it a Dataset"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        call()
