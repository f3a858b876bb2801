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
    with pytest.raises(ValueError, match="e holds the signals"):
        law.next(v, e_table.rename(columns={names[0]: "another"}))


def test_the_first_signal_is_zero_or_given_and_rests():
    law = Law(Q, TWO, rest=3)
    assert not law.first(10).any() and law.first(10).shape == (10, 2)
    first = law.first(10, np.ones((10, 2)))
    assert first[:7].all() and not first[7:].any()
    with pytest.raises(ValueError, match="rest = 3"):
        law.first(3)
    with pytest.raises(ValueError, match="rest = 3"):
        law.next(np.zeros((3, 2)), np.zeros((3, 2)))


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


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"Q": np.ones(3)}, "Q"),
        ({"L": "TWO"}, "L"),
        ({"L": LearningFilter(np.ones((2, 2, 1)), 2.0)}, "Q.Ts = 1.0, L.Ts = 2.0"),
        ({"rest": -1}, "rest"),
        ({"gain": 0.0}, "gain"),
        ({"gain": 1.1}, "gain"),
        ({"limits": {"Q1": (1, 0)}}, "limits"),
        ({"limits": [0, 1]}, "limits"),
        ({"limits": {"fan": (0, 1)}, "loop": paper_loop()}, "limits"),
        ({"loop": 3}, "loop"),
    ],
)
def test_a_law_is_checked_when_it_is_made(change, argument):
    with pytest.raises(ValueError, match=argument):
        Law(**{"Q": Q, "L": TWO} | change)


def test_signals_are_checked():
    law, zero = Law(Q, TWO), np.zeros((5, 2))
    gap = zero.copy()
    gap[3, 1] = np.nan
    with pytest.raises(ValueError, match="e has 1 values that are not finite"):
        law.next(zero, gap)
    with pytest.raises(ValueError, match=r"e has shape \(6, 2\)"):
        law.next(zero, np.zeros((6, 2)))
    limited = Law(Q, TWO, limits={"Q1": (0, 1)})
    with pytest.raises(ValueError, match="limits need"):
        limited.next(zero, zero, zero)
    with pytest.raises(ValueError, match="u = None"):
        limited.bound_to(paper_loop()).next(zero, zero)


def test_a_design_has_its_law(loop, omega):
    design = synthesise(loop, Q, omega[::20], order=10)
    law = design.law(rest=4, gain=0.5, limits={"Q1": (0, 1)})
    assert (law.Q, law.L, law.rest, law.gain) == (Q, design.filter, 4, 0.5)
    of_samples = synthesise(
        loop, Q.frequency_response(omega[::20]), omega[::20], 1.0, order=10
    )
    with pytest.raises(ValueError, match="Q = samples"):
        of_samples.law()
