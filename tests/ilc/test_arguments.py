"""How arguments are checked: what may pass, and what the errors say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.ilc import arguments


@given(st.floats() | st.integers() | st.fractions(), st.floats(-5, 5), st.floats(-5, 5))
def test_a_number_lies_strictly_between_its_limits(value, low, high):
    if low < value < high and (value == 0 or 1e-100 <= abs(value) <= 1e100):
        assert arguments.number("x", value, "right", low, high) == float(value)
    else:
        with pytest.raises(ValueError, match=r"x = .* (must be right|is too)"):
            arguments.number("x", value, "right", low, high)


def test_numbers_at_the_limits():
    assert arguments.number("x", 1e100, "right") == 1e100
    assert arguments.number("x", -1e-100, "right") == -1e-100
    for value, word in ((1.1e100, "large"), (9e-101, "small"), (-1.1e100, "large")):
        with pytest.raises(ValueError, match=f"is too {word}: choose another unit"):
            arguments.number("x", value, "right")
    with pytest.raises(ValueError, match="x = 0 must be a positive number"):
        arguments.positive("x", 0)


@given(st.integers(-3, 9), st.integers(-3, 3), st.none() | st.integers(0, 5))
def test_a_whole_number_may_be_its_limits(value, low, high):
    if value >= low and (high is None or value <= high):
        for same in (value, np.int16(value)):
            assert type(arguments.whole("n", same, low, high)) is int
    else:
        limits = f"{low} or more" if high is None else f"from {low} to {high}"
        with pytest.raises(
            ValueError, match=f"n = {value} must be a whole number, {limits}"
        ):
            arguments.whole("n", value, low, high)


def test_a_whole_number_has_an_end():
    assert arguments.whole("n", 10**9, 1) == 10**9
    with pytest.raises(
        ValueError, match="n = 1000000001 is too large: at most 1000000000"
    ):
        arguments.whole("n", 10**9 + 1, 1)


def test_flags_and_words():
    assert arguments.flag("x", np.True_) is True and arguments.flag("x", False) is False
    assert arguments.choice("x", "a", ["a", "b"]) == "a"
    with pytest.raises(ValueError, match="x = 'c' must be 'a' or 'b'"):
        arguments.choice("x", "c", ["a", "b"])


@pytest.mark.parametrize(
    ("shape", "sizes", "fits"),
    [
        ((2, "m"), (2, 5), True),
        ((2, "m"), (3, 5), False),
        ((2, "m"), (2, 0), False),
        ((2, "m"), (2,), False),
        ((2, 0), (2, 0), True),
        (("m", "m"), (3, 3), True),
        (("m", "m"), (3, 4), False),
        ((..., 2), (2,), True),
        ((..., 2), (7, 8, 2), True),
        ((..., 2), (), False),
        ((..., "t", 2), (2,), False),
        ((..., "t", 2), (9, 3, 2), True),
        ((...,), (), True),
        ((), (), True),
        (("n",), (4,), True),
    ],
)
def test_shapes(shape, sizes, fits):
    value = np.ones(sizes)
    if fits:
        np.testing.assert_array_equal(arguments.array("x", value, shape), value)
        return
    with pytest.raises(ValueError) as error:
        arguments.array("x", value, shape)
    for word in (
        f"x has shape {sizes}",
        *(str(size) for size in shape if size is not ...),
    ):
        assert word in str(error.value)


def test_an_array_is_a_copy_of_the_type_asked_for():
    given_ = np.arange(3)
    copy = arguments.array("x", given_, (3,))
    copy[0] = 9
    assert given_[0] == 0 and copy.dtype == float
    assert arguments.array("x", given_, (3,), complex).dtype == complex
    assert arguments.array("x", 1e100, ()) == 1e100
    unmasked = np.ma.masked_array([1.0], [False])
    assert type(arguments.array("x", unmasked, (1,))) is np.ndarray


@given(st.floats())
def test_a_share_is_above_zero_and_at_most_one(value):
    if 1e-100 <= value <= 1:
        assert arguments.share("step", value) == value
    else:
        with pytest.raises(
            ValueError, match=r"step = .* (must be in|is too (small|large))"
        ):
            arguments.share("step", value)


def test_frequencies_end_at_the_nyquist_frequency():
    top = np.pi / 0.5
    assert arguments.increasing_frequencies("omega", [0, top], 0.5).tolist() == [0, top]
    for wrong in ([0, 1.001 * top], [-0.1, 1]):
        with pytest.raises(
            ValueError, match=r"omega spans \[.*\] rad/s, but must lie in \[0, 6.28"
        ):
            arguments.increasing_frequencies("omega", wrong, 0.5)
    for wrong in ([1.0], [1, 1], [2, 1]):
        with pytest.raises(ValueError, match="must be a row of increasing frequencies"):
            arguments.increasing_frequencies("omega", wrong, 0.5)


def test_a_row_may_be_one_number():
    assert arguments.row("x", 2.0).tolist() == [2.0]
    assert arguments.row("x", [1, 2]).tolist() == [1.0, 2.0]
    with pytest.raises(
        ValueError, match=r"x has shape \(1, 2\), but must have shape \(n,\)"
    ):
        arguments.row("x", [[1, 2]])
