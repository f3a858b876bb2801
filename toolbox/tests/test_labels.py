"""Labelled arrays are matched by name at every door, or refused."""

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    frequency_response,
    least_gain,
    measured_response,
    multisine,
    synthesise,
    zero_phase_butterworth,
)

TS = 0.1
MODEL = control.ss(  # far from symmetric, so that no exchange of channels stays unnoticed
    [[0.8, 0.1], [0.0, 0.7]], np.diag([0.5, 0.9]), [[1.0, 0.2], [0.1, 1.0]], 0, TS,
    inputs=["a", "b"], outputs=["x", "y"],
)  # fmt: skip
Q = zero_phase_butterworth(2, 1.0, TS)
OMEGA = np.geomspace(0.03, np.pi / TS, 120)
P = frequency_response(MODEL, OMEGA)
TABLE = xr.DataArray(
    P,
    dims=("frequency", "output", "input"),
    coords={"frequency": OMEGA, "output": ["x", "y"], "input": ["a", "b"]},
)
L = LearningFilter([[[0.3], [0.1]], [[0.0], [0.2]]], TS)
DESIGN = synthesise(P, Q, OMEGA, TS)
OF_MODEL = synthesise(MODEL, Q)
LAST_FIRST = {"output": [1, 0], "input": [1, 0]}
UNNAMED = TABLE.drop_vars(["frequency", "output", "input"])
GAINS = xr.DataArray(Q.frequency_response(OMEGA), {"frequency": OMEGA}, ("frequency",))


def designed(P, *arguments):
    """Coefficients of the filter for P."""
    return synthesise(P, Q, *arguments).filter.coefficients


@pytest.mark.parametrize(
    "table",
    [
        TABLE,
        TABLE.transpose("frequency", "input", "output"),
        TABLE.transpose("input", "output", "frequency"),
        UNNAMED.transpose("frequency", "input", "output"),
        xr.DataArray(P),  # without names: by position
    ],
)
def test_axes_of_P_are_found_by_their_names(table):
    assert np.array_equal(designed(table, OMEGA, TS), DESIGN.filter.coefficients)
    gamma = convergence(table, Q, L, OMEGA).gamma
    assert gamma == convergence(P, Q, L, OMEGA).gamma
    assert gamma != convergence(P.swapaxes(1, 2), Q, L, OMEGA).gamma


def test_frequencies_of_P_Q_and_the_radius_serve_as_omega():
    assert np.array_equal(designed(TABLE), DESIGN.filter.coefficients)
    of_series = pd.Series(GAINS.values, OMEGA)
    for design in (
        synthesise(MODEL, GAINS),
        synthesise(MODEL, of_series),
        synthesise(MODEL, Q, uncertainty=pd.Series(0.01 * np.ones(len(OMEGA)), OMEGA)),
        least_gain(TABLE, Q, order=2),
    ):
        assert np.array_equal(design.omega, OMEGA)
    assert OF_MODEL.check(TABLE).gamma == OF_MODEL.check(P, OMEGA).gamma


def test_channels_in_another_order_are_put_in_that_of_the_plant():
    turned = TABLE.isel(LAST_FIRST)
    assert np.array_equal(turned.values[:, 0, 0], P[:, 1, 1])  # it is another array
    for design in (OF_MODEL, synthesise(TABLE, Q), synthesise(ClosedLoop(MODEL), Q)):
        assert design.check(turned).gamma == design.check(TABLE).gamma
    both = synthesise([TABLE, turned], Q).problem.plants
    assert np.array_equal(both[0], both[1])
    # of inputs that are named after the outputs to whose reference v is added
    crossed = TABLE.assign_coords(input=["y", "x"])
    assert np.array_equal(synthesise(crossed, Q).problem.P, P[:, :, ::-1])
    # numbers count
    counted = turned.assign_coords(output=[2, 1], input=[2, 1])
    assert np.array_equal(designed(counted), DESIGN.filter.coefficients)


def test_a_design_of_a_labelled_table_knows_its_channels():
    assert synthesise(TABLE, Q).problem.response.signals.labels == ["x", "y", "a", "b"]
    with pytest.raises(ValueError, match=r"labels = .* in the same order"):
        synthesise(TABLE.isel(LAST_FIRST), Q).check(MODEL)


def test_several_plants_have_an_axis_of_their_own():
    several = xr.concat([TABLE, 0.98 * TABLE], "plant").transpose("input", "plant", ...)
    assert np.allclose(synthesise(several, Q).problem.plants, [P, 0.98 * P], rtol=1e-15, atol=0)


def test_scale_and_amplitude_are_matched_by_name():
    for scale in (
        pd.Series([2.0, 1.0], ["y", "x"]),
        pd.Series([2.0, 1.0], ["b", "a"]),
        xr.DataArray([2.0, 1.0], {"output": ["y", "x"]}, ("output",)),
        xr.DataArray([2.0, 1.0], {"output": ("channel", ["y", "x"])}, ("channel",)),
    ):
        for plant in (MODEL, TABLE, ClosedLoop(MODEL)):
            assert synthesise(plant, Q, scale=scale).problem.scale.tolist() == [1.0, 2.0]
    measured = measured_response(control.frd(np.moveaxis(P, 0, -1), OMEGA, TS, outputs=["x", "y"]))
    named, plain = (
        measured.on(OMEGA, scale=s)[0] for s in (pd.Series([2.0, 1.0], ["y", "x"]), [1.0, 2.0])
    )
    assert np.array_equal(named, plain)
    shaking = multisine(ClosedLoop(MODEL), 0.3, 10.0, pd.Series([2.0, 1.0], ["y", "x"]), hours=0.1)
    assert list(shaking.amplitude) == [1.0, 2.0]


def test_a_scale_by_name_orders_a_reference_where_P_has_no_names():
    rng = np.random.default_rng(0)
    reference = pd.DataFrame(rng.standard_normal((50, 2)), columns=["x", "y"])
    scale = pd.Series([2.0, 1.0], ["y", "x"])
    named = synthesise(P, Q, OMEGA, scale=scale, reference=reference)
    swapped = reference[["y", "x"]].to_numpy()
    plain = synthesise(P, Q, OMEGA, scale=[2.0, 1.0], reference=swapped)
    assert np.array_equal(named.filter.coefficients, plain.filter.coefficients)


def test_coefficients_and_signals_have_axes_by_name():
    coefficients = xr.DataArray(L.coefficients, dims=("input", "output", "order"))
    turned = LearningFilter(coefficients.transpose("order", "output", "input"), TS)
    assert np.array_equal(turned.coefficients, L.coefficients)
    # a square trial, in which no shape shows what is the time
    v = xr.DataArray(np.random.default_rng(0).standard_normal((2, 2)), dims=("channel", "time"))
    law = Law(Q, L)
    assert np.array_equal(law.next(v, v), law.next(v.values.T, v.values.T).T)


REFUSED = {
    r"P has the dimensions \['frequency', 'y', 'input'\], but": lambda: synthesise(
        TABLE.rename(output="y"), Q
    ),
    r"P is labelled with 120 frequencies from 0.03 .* Leave omega out": lambda: synthesise(
        TABLE, Q, 0.99 * OMEGA
    ),
    "P is labelled with 120 frequencies from 0.0047": lambda: synthesise(
        TABLE.assign_coords(frequency=OMEGA / (2 * np.pi)), Q, OMEGA
    ),
    "P has frequencies in 'Hz'": lambda: synthesise(
        TABLE.assign_coords(frequency=("frequency", OMEGA / 6.28, {"units": "Hz"})), Q
    ),
    "omega has frequencies in 'Hz'": lambda: synthesise(
        P, Q, xr.DataArray(OMEGA / 6.28, attrs={"units": "Hz"})
    ),
    "P has the frequencies .*must be numbers": lambda: synthesise(
        TABLE.assign_coords(frequency=[f"{x} rad/s" for x in OMEGA]), Q
    ),
    r"P has the outputs \['x', 'z'\], but must have \['x', 'y'\]": lambda: OF_MODEL.check(
        TABLE.assign_coords(output=["x", "z"])
    ),
    r"P\[1\] has the inputs \['a', 'c'\], but must have \['a', 'b'\]": lambda: synthesise(
        [MODEL, TABLE.assign_coords(input=["a", "c"])], Q
    ),
    r"P has the outputs \['x', 'x'\], but": lambda: OF_MODEL.check(
        TABLE.assign_coords(output=["x", "x"])
    ),
    r"P has the outputs \[1, 1\], but": lambda: synthesise(TABLE.assign_coords(output=[1, 1]), Q),
    "P is a list of labelled arrays of one frequency": lambda: synthesise(
        [pd.DataFrame(each) for each in P], Q, OMEGA
    ),
    "Q is labelled with 120 frequencies": lambda: synthesise(MODEL, GAINS, 0.99 * OMEGA),
    "Q is labelled with 120 freq": lambda: convergence(MODEL, GAINS[::-1], L, OMEGA),
    "uncertainty is labelled with 120 frequencies from 31": lambda: synthesise(
        P, Q, OMEGA, uncertainty=pd.Series(0.01 * np.ones(120), OMEGA[::-1])
    ),
    "uncertainty is labelled with .*31.1": lambda: measured_response(
        control.frd(np.moveaxis(P, 0, -1), OMEGA, TS),
        uncertainty=pd.Series(0.01 * np.ones(120), 0.99 * OMEGA),
    ),
    "log is a labelled array of a frequency response": lambda: measured_response(TABLE),
    r"scale has the outputs \['y', 'z'\], but must have \['x', 'y'\]": lambda: synthesise(
        MODEL, Q, scale=pd.Series([1.0, 2.0], ["y", "z"])
    ),
    "scale has the dimensions": lambda: synthesise(
        MODEL, Q, scale=xr.DataArray([1.0, 2.0], dims="unit")
    ),
    "coefficients has the dimensions": lambda: LearningFilter(
        xr.DataArray(L.coefficients, dims=("input", "output", "lag")), TS
    ),
    "signal has the dimensions .* transpose it": lambda: Q.apply(
        xr.DataArray(np.ones((2, 2)), dims=("channel", "time"))
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", REFUSED)
def test_labels_that_contradict_are_refused(words):
    with pytest.raises(ValueError, match=f"^{words}"):
        REFUSED[words]()
