"""The law (23) without limits, and what it is checked for."""

from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_choices, paper_loop
from plants import tanks

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)

Q = zero_phase_butterworth(2, 0.1, 1.0)
ONE = LearningFilter([[[1.0, -0.5]]], 1.0)
TWO = LearningFilter(np.random.default_rng(4).standard_normal((2, 2, 10)), 1.0)


def as_matrix(apply, samples, channels):
    """Matrix of a linear map of signals, column by column."""
    units = np.eye(samples * channels).reshape(-1, samples, channels)
    return apply(units).reshape(-1, samples * channels).T


def test_next_is_the_ilc_law():
    v, e = np.random.default_rng(5).standard_normal((2, 100, 2))
    matrix_Q, matrix_L = as_matrix(Q.apply, 100, 2), as_matrix(TWO.apply, 100, 2)
    expected = matrix_Q @ (v.ravel() + matrix_L @ e.ravel())
    np.testing.assert_allclose(Law(Q, TWO).next(v, e).ravel(), expected, atol=1e-11)
    np.testing.assert_array_equal(Law(Q, None).next(v, e), v)


@given(st.floats(0.001, 1), st.integers(0, 19), st.integers(0, 2**32 - 1))
def test_the_gain_goes_a_share_of_the_way_and_v_rests_at_the_end(gain, rest, seed):
    v, e = np.random.default_rng(seed).standard_normal((2, 3, 20, 1))
    whole = Law(Q, ONE).next(v, e)
    part = Law(Q, ONE, rest=rest, gain=gain).next(v, e)
    moving = slice(0, 20 - rest)
    change = gain * (whole - v)[:, moving]
    np.testing.assert_allclose(part[:, moving] - v[:, moving], change, atol=1e-12)
    assert not part[:, 20 - rest :].any()


def test_labelled_signals_are_matched_by_name():
    v, e = np.random.default_rng(6).standard_normal((2, 30, 2))
    law = Law(Q, TWO, loop=paper_loop())
    names = law.outputs
    assert (law.Ts, law.channels) == (1.0, 2) and Law(Q, TWO).outputs is None
    v_table, e_table = (pd.DataFrame(s, columns=names)[names[::-1]] for s in (v, e))
    expected = law.next(v, e)
    following = law.next(v_table, e_table)  # labelled as v is, and in its order
    assert following.columns.tolist() == names[::-1]
    np.testing.assert_array_equal(following[names], expected)
    np.testing.assert_array_equal(law.next(v, e_table), expected)
    coordinates = {"output": ("channel", names[::-1])}
    v_array = xr.DataArray(v[:, ::-1], coordinates, ("time", "channel"))
    following = law.next(v_array, e)
    assert following.output.values.tolist() == names[::-1]
    np.testing.assert_array_equal(following.values[:, ::-1], expected)
    assert Law(Q, None, loop=law.loop).next(v_table, e).equals(v_table)
    one = Law(Q, ONE).next(pd.DataFrame(v[:, :1], columns=["a"]), e[:, :1])
    np.testing.assert_array_equal(one["a"], Law(Q, ONE).next(v[:, 0], e[:, 0]))


def test_the_first_signal_is_zero_or_given_and_rests():
    law = Law(Q, TWO, rest=3)
    assert not law.first(10).any() and law.first(10).shape == (10, 2)
    first = law.first(10, np.ones((10, 2)))
    assert first[:7].all() and not first[7:].any()
    assert law.first(4, np.ones((4, 2)))[0].all()  # all but one rest


def test_a_law_is_bound_to_one_loop():
    law, loop = Law(Q, TWO, gain=0.5), paper_loop()
    bound = law.bound_to(loop)
    assert bound.gain == 0.5 and bound.bound_to(paper_loop()) is bound  # an equal one
    weaker = replace(loop, Ks=0.9 * loop.Ks)
    renamed = replace(loop, units=loop.units | {"y1": "degC"})
    for other in (weaker, renamed, ClosedLoop(loop.P)):
        with pytest.raises(ValueError, match="another loop"):
            bound.bound_to(other)
        assert replace(bound, loop=None).bound_to(other).loop is other
    tanks_loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
    with pytest.raises(ValueError, match="Ts"):
        law.bound_to(tanks_loop)
    with pytest.raises(ValueError, match="channels"):
        Law(Q, ONE).bound_to(loop)


REFUSED = {  # what the error names, and a call
    "Q = ": lambda: Law(np.ones(3), TWO),
    "L = ": lambda: Law(Q, "TWO"),
    "Q.Ts = 1.0, L.Ts = 2.0": lambda: Law(Q, LearningFilter(np.ones((2, 2, 1)), 2.0)),
    "rest = -1": lambda: Law(Q, TWO, rest=-1),
    "gain = 0": lambda: Law(Q, TWO, gain=0),
    "gain = 1.1": lambda: Law(Q, TWO, gain=1.1),
    r"limits\['Q1'\]": lambda: Law(Q, TWO, limits={"Q1": (1, 0)}),
    "limits = ": lambda: Law(Q, TWO, limits=[0, 1]),
    "limits is about": lambda: Law(Q, TWO, limits={"fan": (0, 1)}, loop=paper_loop()),
    "loop = 3": lambda: Law(Q, TWO, loop=3),
    "rest = 3": lambda: Law(Q, TWO, rest=3).first(3),
    "rest = 3 ": lambda: Law(Q, TWO, rest=3).next(ZERO[:3], ZERO[:3]),
    "e has 2 values that are not finite": lambda: Law(Q, TWO).next(ZERO, GAP),
    r"e has shape \(6, 2\)": lambda: Law(Q, TWO).next(ZERO, np.zeros((6, 2))),
    "limits need": lambda: LIMITED.next(ZERO, ZERO, ZERO),
    "u = None": lambda: LIMITED.bound_to(paper_loop()).next(ZERO, ZERO),
    "e holds the signals": lambda: LIMITED.bound_to(paper_loop()).next(
        ZERO, pd.DataFrame(ZERO, columns=["a", "c"])
    ),
    r"v holds the signals \['b', 'a'\], .*bound_to": lambda: Law(Q, TWO).next(
        pd.DataFrame(ZERO, columns=["b", "a"]), ZERO
    ),
    "e holds .*bound_to": lambda: Law(Q, TWO).next(ZERO, pd.DataFrame(ZERO, columns=["b", "a"])),
    "loop.Ts = 2.0": lambda: LIMITED.bound_to(ClosedLoop(None, 2.0, ["y1", "y2"])),
    "u is equal to v": lambda: OWN.next(ZERO + 0.5, ZERO, ZERO + 0.5),
    "applied reaches from .* beyond limits": lambda: OWN.next(ZERO, ZERO, ZERO + 2, ZERO + 1.01),
    "applied reaches from .* moves faster": lambda: OWN.next(ZERO, ZERO, RAMP, RAMP),
}
ZERO, GAP = np.zeros((5, 2)), np.where(np.eye(5, 2, -3), np.nan, 0.0)
RAMP = np.outer([0.0, 0.1, 0.5, 0.6, 0.7], [1, 1])
LIMITED = Law(Q, TWO, limits={"Q1": (0, 1)})
MODELLED = ClosedLoop(
    control.ss(0.5 * np.eye(2), np.eye(2) / 2, np.eye(2), 0, 1.0, inputs=["w1", "w2"])
)
OWN = Law(Q, TWO, limits={"w1": (-1, 1, 0.2)}, loop=ClosedLoop(None, 1.0, ["y1", "y2"]))


def test_a_reference_of_zero_and_digits_that_a_log_lacks_are_no_mistakes():
    v = np.random.default_rng(7).uniform(-0.1, 0.1, (5, 2))
    expected = OWN.next(v, ZERO, v + 1e-9)
    np.testing.assert_allclose(OWN.next(v, ZERO, v, v), expected, atol=1e-8)
    exact, rounded = (np.full((5, 2), x) for x in (1.0, 1.001))
    run = OWN.next(v, ZERO, exact, rounded)
    np.testing.assert_allclose(run, OWN.next(v, ZERO, exact, exact), atol=0.01)
    still = run_trials(MODELLED, Law(Q, TWO, limits=OWN.limits), ZERO, v=v, trials=2)
    assert still.v.values[1].any()


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_wrong_is_refused(words):
    with pytest.raises(ValueError, match=words):
        REFUSED[words]()


def test_a_design_has_its_law(loop, omega):
    omega, limits = omega[::20], {"Q1": (0, 1)}
    design = synthesise(loop, Q, omega, **paper_choices())
    law = design.law(rest=4, gain=0.5, limits=limits)
    assert (law.Q, law.L, law.rest, law.gain) == (Q, design.filter, 4, 0.5)
    of_samples = synthesise(loop, Q.frequency_response(omega), omega, 1.0, **paper_choices())
    with pytest.raises(ValueError, match="Q = samples"):
        of_samples.law()
