"""The checks themselves, and every public door of rodlib with things that do not belong there."""

import warnings
from dataclasses import fields

import control
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from rodlib import (
    LearningFilter,
    Rod,
    arguments,
    converged_noise,
    current_trial_loop,
    exact_response,
    midr,
    minimal_realisation,
    noise_bound,
    noise_by_trial,
    paper_loop,
    run_trials,
    sampled_response,
    synthesise,
    trial_noise,
    update,
    zero_phase_butterworth,
)
from rodlib.evidence import TrialNoise
from rodlib.laboratory import VirtualRig, record
from rodlib.realisation import frequency_response
from rodlib.trials import assumed_disturbance, assumed_reference, rms, state_sequence

PLANT = control.ss(0.5, [[0.5, 1.0]], 1, 0, 1.0, inputs=["u", "d"], outputs=["y"])
LOOP, PAPER = current_trial_loop(PLANT, ["u"]), paper_loop()
Q, L = zero_phase_butterworth(), LearningFilter([[[0.5, 0.1]]], 1.0)
L2 = LearningFilter(np.ones((2, 2, 1)), 1.0)
OMEGA = np.linspace(0.1, 3, 12)
NOISE = {"omega": OMEGA, "Ts": 1.0, "P": LOOP.frequency_response(OMEGA), "measured_density": 1.0}
SIGNAL = np.zeros((6, 1))
NAN = control.ss(0.5, [[1.0, np.nan]], 1, 0, 1.0, inputs=["u", "d"])

# What no argument may be; and what further is wrong where a number, a model or an array is meant.
NOTHING = {"text": "1", "object": object(), "class": int, "function": len, "set": {1.0}}
NOTHING |= {"bytes": b"1", "dictionary": {"a": 1}, "ragged": [[1.0], [1.0, 2.0]]}
NOTHING |= {"strings": np.array([["1"]]), "objects": np.array([None, {}]), "empty": []}
NOTHING |= {"nan": np.nan, "inf": np.inf, "NaNs": np.full((6, 1), np.nan), "huge": 10**400}
NOTHING |= {"booleans": np.array([[True]]), "true": True, "times": np.array(["NaT"], "M8[s]")}
NOTHING |= {"no rows": np.zeros((0, 1))}
NOTHING |= {"masked": np.ma.masked_array(np.ones((6, 1)), np.eye(6, 1)), "frame": xr.Dataset()}
NUMBER = {"-1": -1.0, "complex": 1j, "1e300": 1e300, "list": [1.0], "array": np.ones(3)}
WHOLE = NUMBER | {"half": 1.5, "float": 1.0}
REAL = {"complex": np.full((6, 1), 1j), "1e300": np.full((6, 1), 1e300)}
MODEL = {"nan model": NAN, "number": 1.0, "transfer": control.tf(1, [1, 0.5], 1.0, inputs="F")}
DENSITY = REAL | {"-1": -1.0, "lists": [[1.0]], "matrices": np.full((12, 2, 2), 1.0)}
WRONG_PLANT = {"nan model": NAN, "continuous": control.ss(-1, 1, 1, 0), "names": MODEL["transfer"]}

DOORS = {
    "Rod": (Rod, {}, {f.name: NUMBER for f in fields(Rod)[:7]} | {"sections": WHOLE}),
    "Rod, sensors": (Rod, {}, {"sensors": {"beyond": [9.0], "none": None, "2-D": [[0.1]]}}),
    "midr": (midr, {"rod": Rod(), "degree": 1}, {"rod": NUMBER, "degree": WHOLE}),
    "exact_response": (exact_response, {"rod": Rod(), "s": [1j]}, {"rod": NUMBER, "s": {}}),
    "sampled_response": (
        sampled_response,
        {"rod": Rod(), "omega": OMEGA, "Ts": 1.0},
        {"rod": NUMBER, "omega": REAL | {"-1": -1.0}, "Ts": NUMBER | {"short": 1e-9}},
    ),
    "minimal_realisation": (
        minimal_realisation,
        {"plant": PLANT, "controls": ["u"]},
        {"plant": MODEL, "controls": {"twice": ["u", "u"], "none": None, "numbers": [1, 2]}},
    ),
    "current_trial_loop": (
        current_trial_loop,
        {"plant": PLANT, "controls": ["u"], "sizes": {"y": 2}, "units": {"u": "N"}},
        {
            "plant": MODEL,
            "controls": {"twice": ["u", "u"], "two": ["u", "d"], "none": None},
            "sizes": NUMBER | {"zero": {"y": 0}, "words": {"y": "large"}, "d": {"d": 1.0}},
            "units": NUMBER | {"number": {"y": 1.0}, "pair": {("y", "u"): "K"}},
        }
        | {name: REAL | NUMBER for name in ("Qs", "Rs", "Qo", "Ro")},
    ),
    "paper_loop": (paper_loop, {}, {"rod": NUMBER, "degree": WHOLE, "Ts": NUMBER}),
    "frequency_response": (
        frequency_response,
        {"system": PLANT, "omega": OMEGA},
        {"system": MODEL, "omega": REAL},
    ),
    "loop.frequency_response": (
        LOOP.frequency_response,
        {"omega": OMEGA, "plant": np.ones((12, 1, 1))},
        {"omega": REAL, "plant": WRONG_PLANT | {"column": np.ones((12, 1))}},
    ),
    "loop.around": (LOOP.around, {"plant": PLANT}, {"plant": WRONG_PLANT | {"number": 1.0}}),
    "zero_phase_butterworth": (
        zero_phase_butterworth,
        {},
        {"order": WHOLE, "cutoff": NUMBER, "Ts": NUMBER, "ends": {"other": "mirror", "none": None}},
    ),
    "Q.frequency_response": (Q.frequency_response, {"omega": OMEGA}, {"omega": REAL}),
    "Q.apply": (Q.apply, {"signal": SIGNAL}, {"signal": REAL}),
    "LearningFilter": (
        LearningFilter,
        {"coefficients": L.coefficients, "Ts": 1.0},
        {"coefficients": REAL, "Ts": NUMBER, "ends": {"other": "mirror", "none": None}},
    ),
    "L.frequency_response": (L.frequency_response, {"omega": OMEGA}, {"omega": REAL}),
    "L.apply": (L.apply, {"signal": SIGNAL}, {"signal": REAL}),
    "update": (
        update,
        {"v": SIGNAL, "e": SIGNAL, "Q": Q, "L": L},
        {"v": REAL, "e": REAL, "Q": MODEL, "L": MODEL, "rest": WHOLE, "step": NUMBER | {"0": 0}},
    ),
    "synthesise": (
        synthesise,
        {"P": LOOP, "Q": Q, "omega": OMEGA, "Ts": 1.0, "band": (0.1, 1.0), "order": 2},
        {
            "P": REAL | {"nan model": NAN, "1e200": LOOP.frequency_response(OMEGA) * 1e200},
            "Q": REAL | {"zero": np.zeros(12)},
            "omega": REAL,
            "Ts": NUMBER,
            "order": WHOLE,
            "M_max": NUMBER,
            "L_max": {k: v for k, v in NUMBER.items()},
            "band": {"none": None, "1e300": (0.1, 1e300), "one": 0.1},
            "structure": {"other": "half", "none": None},
            "objective": {"other": "mean", "none": None},
            "solver": {"other": "abacus", "none": None},
            "start": {"number": 1.0},
            "samples": WHOLE,
            "rest": WHOLE,
            "check": {"true": 1.0, "none": None},
        },
    ),
    "run_trials": (
        run_trials,
        {"loop": LOOP, "Q": Q, "L": L, "reference": SIGNAL, "trials": 2},
        {
            "loop": MODEL,
            "Q": MODEL,
            "L": MODEL,
            "reference": REAL,
            "trials": WHOLE,
            "disturbance": REAL,
            "plant": WRONG_PLANT | {"number": 1.0},
            "noise": REAL,
            "initial_state": REAL,
            "rest": WHOLE,
            "step": REAL | {"0": 0.0, "2": 2.0},
        },
    ),
    "trial_noise": (
        trial_noise,
        {"loop": LOOP, "omega": OMEGA, "noise": 1.0, "disturbance": 1.0},
        {
            "loop": MODEL,
            "omega": REAL | NUMBER | {"falling": OMEGA[::-1]},
            "noise": DENSITY,
            "disturbance": DENSITY,
            "plant": WRONG_PLANT | {"number": 1.0},
        },
    ),
    "TrialNoise": (
        TrialNoise,
        NOISE,
        {
            "omega": REAL | NUMBER,
            "Ts": NUMBER,
            "P": REAL | NUMBER,
            "measured_density": DENSITY | {"none": None},
            "true_density": DENSITY,
        },
    ),
    "converged_noise": (
        converged_noise,
        {"new": TrialNoise(**NOISE), "Q": Q, "L": L},
        {"new": MODEL, "Q": MODEL, "L": MODEL, "step": NUMBER | {"0": 0}},
    ),
    "noise_by_trial": (
        noise_by_trial,
        {"new": TrialNoise(**NOISE), "Q": Q, "L": L, "step": [1, 0.5]},
        {"new": MODEL, "Q": MODEL, "L": MODEL, "step": REAL | {"0": [0.0], "2": [1, 2]}},
    ),
    "noise_bound": (
        noise_bound,
        {"new": TrialNoise(**NOISE), "Q": Q, "M_max": 0.9, "L_max": 2.0},
        {"new": MODEL, "Q": MODEL, "M_max": REAL | {"1": 1, "-1": -1.0}, "L_max": REAL},
    ),
    "state_sequence": (
        state_sequence,
        {"A": np.eye(2), "forcing": np.zeros((3, 2)), "initial": np.zeros(2)},
        {"A": REAL, "forcing": REAL, "initial": REAL},
    ),
    "rms": (rms, {"e": xr.DataArray(SIGNAL, dims=("time", "channel"))}, {"e": REAL}),
    "assumed_reference": (assumed_reference, {}, {"samples": WHOLE}),
    "assumed_disturbance": (
        assumed_disturbance, {}, {"samples": WHOLE, "trials": WHOLE, "first": WHOLE}
    ),
    "record": (
        record,
        {
            "rig": VirtualRig(), "loop": PAPER, "Q": Q, "L": L2, "reference": np.zeros((5, 2)),
            "disturbance": np.zeros((2, 5, 3)), "trials": 2, "pause": 1,
        },
        {
            "rig": MODEL,
            "loop": MODEL,
            "Q": MODEL,
            "L": MODEL,
            "reference": REAL,
            "disturbance": REAL,
            "decimals": NUMBER,
            "trials": WHOLE,
            "pause": WHOLE,
            "rest": WHOLE,
            "step": NUMBER | {"0": 0},
        },
    ),
}  # fmt: skip
CASES = [(door, name) for door, (_, _, wrong) in DOORS.items() for name in wrong]


@pytest.mark.parametrize("door", DOORS)
def test_every_door_is_open_to_what_belongs_there(door):
    function, right, _ = DOORS[door]
    function(**right)


@pytest.mark.parametrize(("door", "name"), CASES)
def test_every_door_is_shut_to_what_does_not(door, name):
    """Only a ValueError that names the argument, and no warning, whatever is passed."""
    function, right, wrong = DOORS[door]
    for kind, value in (NOTHING | wrong[name]).items():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(ValueError) as error:
                function(**right | {name: value})
        assert name in str(error.value), kind
        assert len(str(error.value)) < 500, kind


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
        with pytest.raises(ValueError, match=f"n = {value} must be a whole number, {limits}"):
            arguments.whole("n", value, low, high)


def test_a_whole_number_has_an_end():
    assert arguments.whole("n", 10**9, 1) == 10**9
    with pytest.raises(ValueError, match="n = 1000000001 is too large: at most 1000000000"):
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
    for word in (f"x has shape {sizes}", *(str(size) for size in shape if size is not ...)):
        assert word in str(error.value)


@pytest.mark.parametrize("value", [[True, 0.5], [[1, 2], (3, np.True_)], True])
def test_true_is_no_number_of_an_array(value):
    with pytest.raises(ValueError, match=r"x holds (True or False|values of type bool), but must"):
        arguments.array("x", value, (...,))


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
        with pytest.raises(ValueError, match=r"step = .* (must be in|is too (small|large))"):
            arguments.share("step", value)


def test_frequencies_end_at_the_nyquist_frequency():
    top = np.pi / 0.5
    assert arguments.frequencies("omega", [0, top], 0.5).tolist() == [0, top]
    for wrong in ([0, 1.001 * top], [-0.1, 1]):
        with pytest.raises(
            ValueError, match=r"omega spans \[.*\] rad/s, but must lie in \[0, 6.28"
        ):
            arguments.frequencies("omega", wrong, 0.5)
    for wrong in ([1.0], [1, 1], [2, 1]):
        with pytest.raises(ValueError, match="must be a row of increasing frequencies"):
            arguments.frequencies("omega", wrong, 0.5)


def test_a_row_may_be_one_number():
    assert arguments.row("x", 2.0).tolist() == [2.0]
    assert arguments.row("x", [1, 2]).tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match=r"x has shape \(1, 2\), but must have shape \(n,\)"):
        arguments.row("x", [[1, 2]])


def test_periods_are_equal_up_to_rounding():
    arguments.one_period(loop=0.3, Q=0.1 * 3, L=0.3)
    with pytest.raises(ValueError, match=r"loop.Ts = 1.0 s, Q.Ts = 1.000000001 s: the sampling"):
        arguments.one_period(loop=1.0, Q=1.000000001)
