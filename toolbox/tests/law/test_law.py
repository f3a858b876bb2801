"""The law (23) without limits, and what it is checked for."""

from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_loop
from plants import RestartingModel, as_matrix, lag

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    record,
    synthesise,
    zero_phase_butterworth,
)

Q = zero_phase_butterworth(2, 0.1, 1.0)
ONE = LearningFilter([[[1.0, -0.5]]], 1.0)
TWO = LearningFilter(np.random.default_rng(4).standard_normal((2, 2, 10)), 1.0)


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
    turned, expected = law.outputs[::-1], law.next(v, e)
    v_table, e_table = (pd.DataFrame(s[:, ::-1], columns=turned) for s in (v, e))
    coordinates = {"output": ("channel", turned)}
    v_array = xr.DataArray(v[:, ::-1], coordinates, ("time", "channel"))
    # labelled as v is, and in its order
    of_table, of_array = law.next(v_table, e_table), law.next(v_array, e)
    assert of_table.columns.tolist() == of_array.output.values.tolist() == turned
    for following in (of_table, of_array):
        np.testing.assert_array_equal(np.asarray(following)[:, ::-1], expected)


def test_the_first_signal_is_zero_or_given_and_rests():
    law = Law(Q, TWO, rest=3)
    assert not law.first(10).any() and law.first(10).shape == (10, 2)
    first = law.first(10, np.ones((10, 2)))
    assert first[:7].all() and not first[7:].any()


def test_a_law_is_bound_to_one_loop():
    law, loop = Law(Q, TWO, gain=0.5), paper_loop()
    bound = law.bound_to(loop)
    assert bound.gain == 0.5 and bound.bound_to(paper_loop()) is bound  # an equal one
    weaker = replace(loop, Ks=0.9 * loop.Ks)
    renamed = replace(loop, units=loop.units | {"y1": "degC"})
    for other in (weaker, renamed, ClosedLoop(loop.P)):
        with pytest.raises(ValueError, match="another loop"):
            bound.bound_to(other)


def test_a_design_has_its_law():
    design = synthesise(lag(), Q, order=3)
    law = design.law(rest=4, gain=0.5)
    assert (law.Q, law.L, law.rest, law.gain) == (Q, design.filter, 4, 0.5)


def test_an_L_for_trials_of_another_length_is_refused_before_any_is_run():
    P = lag(0.5)
    rig = RestartingModel(P)
    law, loop = Law(Q, NormOptimal(P, 0.1, 100)), ClosedLoop(P, outputs=["x"])
    with pytest.raises(ValueError, match="100"):
        record(rig, loop, law, np.zeros(160), trials=2)
    assert not rig.sent


def test_an_L_for_other_numbers_of_channels_than_the_plant_has_is_refused():
    wide = control.ss(0.5, [[1.0, 2.0]], [[1.0]], 0, 1.0)
    L, plant = NormOptimal(wide, 0.1, 30), control.append(lag(0.5), lag(0.8))
    with pytest.raises(ValueError, match="L has 2 rows and 1 columns, but must have 2 rows"):
        convergence(plant, Q, L)
    with pytest.raises(ValueError, match="L has 1 outputs, but loop has 2"):
        Law(Q, L, loop=ClosedLoop(plant))
