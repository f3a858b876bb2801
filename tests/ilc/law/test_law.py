"""The law (23) without limits, and what it is checked for."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import tanks

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    paper_choices,
    paper_loop,
    synthesise,
    zero_phase_butterworth,
)

Q = zero_phase_butterworth()
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
    np.testing.assert_array_equal(law.next(v_table, e_table), expected)
    unbound = Law(Q, TWO).next(pd.DataFrame(v, columns=names), e_table)
    np.testing.assert_array_equal(unbound, expected)
    np.testing.assert_array_equal(Law(Q, TWO).next(v, e_table[names]), expected)


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
    "e holds the signals": lambda: Law(Q, TWO).next(
        pd.DataFrame(ZERO, columns=["a", "b"]), pd.DataFrame(ZERO, columns=["a", "c"])
    ),
}
ZERO, GAP = np.zeros((5, 2)), np.where(np.eye(5, 2, -3), np.nan, 0.0)
LIMITED = Law(Q, TWO, limits={"Q1": (0, 1)})


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_wrong_is_refused(words):
    with pytest.raises(ValueError, match=words):
        REFUSED[words]()


def test_a_design_has_its_law(loop, omega):
    omega, limits = omega[::20], {"Q1": (0, 1)}
    design = synthesise(loop, Q, omega, **paper_choices())
    law = design.law(rest=4, gain=0.5, limits=limits)
    assert (law.Q, law.L, law.rest, law.gain) == (Q, design.filter, 4, 0.5)
    of_samples = synthesise(
        loop, Q.frequency_response(omega), omega, 1.0, **paper_choices()
    )
    with pytest.raises(ValueError, match="Q = samples"):
        of_samples.law()
