"""Labelled arrays are matched by name at every door, or refused."""

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from plants import axes

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    frequency_response,
    measured_response,
    multisine,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.response.door import response_of

MODEL, TS = axes(), 0.1  # far from symmetric, so that no exchange of channels stays unnoticed
Q = zero_phase_butterworth(2, 1.0, TS)
OMEGA = np.geomspace(0.03, np.pi / TS, 120)
P = frequency_response(MODEL, OMEGA)
TABLE = xr.DataArray(
    P,
    dims=("frequency", "output", "input"),
    coords={"frequency": OMEGA, "output": ["x", "y"], "input": ["set x", "set y"]},
)
TURNED = TABLE.isel(output=[1, 0], input=[1, 0])
L = LearningFilter([[[0.3], [0.1]], [[0.0], [0.2]]], TS)
GAINS = xr.DataArray(Q.frequency_response(OMEGA), {"frequency": OMEGA}, ("frequency",))
RADIUS = pd.Series(0.01, OMEGA)
SCALE = pd.Series([2.0, 1.0], ["y", "x"])
DATA = control.frd(np.moveaxis(P, 0, -1), OMEGA, TS, outputs=["x", "y"])
SIGNAL = xr.DataArray(np.ones((2, 2)), dims=("channel", "time"))
IN_HERTZ = xr.DataArray(OMEGA / 6.28, dims="frequency", attrs={"units": "Hz"})
DESIGN = synthesise(MODEL, Q, order=3)


@pytest.mark.parametrize(
    "table",
    [
        TABLE.transpose("input", "output", "frequency"),
        TABLE.drop_vars([*TABLE.coords]).transpose("frequency", "input", "output"),
        xr.DataArray(P),  # without names: by position
        # inputs that are named after the outputs, to whose references v is added
        TABLE.assign_coords(input=["x", "y"]).isel(input=[1, 0]),
    ],
)
def test_axes_of_P_are_found_by_their_names(table):
    gamma = convergence(table, Q, L, OMEGA).rate
    assert gamma == convergence(P, Q, L, OMEGA).rate
    assert gamma != convergence(P.swapaxes(1, 2), Q, L, OMEGA).rate


def test_frequencies_of_P_Q_and_the_radius_serve_as_omega():
    several = xr.concat([TABLE, 0.98 * TABLE], "plant").transpose("input", "plant", ...)
    for response in (
        response_of(several, Ts=TS),
        response_of(MODEL, Q=GAINS),
        response_of(MODEL, OMEGA, uncertainty=RADIUS.reset_index(drop=True)),  # numbers count
        response_of(MODEL, uncertainty=RADIUS),
    ):
        assert np.array_equal(response.omega, OMEGA)
        assert np.allclose(response.P, [P, 0.98 * P][: len(response.P)], rtol=1e-12, atol=0)
    assert response.signals.labels == ["x", "y", "set x", "set y"]
    assert DESIGN.check(TABLE).rate == DESIGN.check(P, OMEGA).rate


def test_scale_and_amplitude_are_matched_by_name():
    of_dataset = xr.DataArray(SCALE, dims="channel").drop_vars("channel")
    for scale in (SCALE, of_dataset.assign_coords(output=("channel", SCALE.index))):
        for plant in (MODEL, TABLE, ClosedLoop(MODEL)):
            assert response_of(plant, Ts=TS, scale=scale).scale.y.tolist() == [1.0, 2.0]
    named, _ = measured_response(DATA).on(OMEGA, scale=SCALE)
    assert np.allclose(named, P * [[1, 2], [0.5, 1]], rtol=1e-12, atol=0)
    assert multisine(ClosedLoop(MODEL), 0.3, 10.0, SCALE, hours=0.1).amplitude == [1.0, 2.0]


def test_coefficients_have_axes_by_name():
    turned = xr.DataArray(L.coefficients.T, dims=("order", "output", "input"))
    assert np.array_equal(LearningFilter(turned, TS).coefficients, L.coefficients)


REFUSED = {
    r"P has the dimensions \['frequency', 'y', 'input'\], but": lambda: synthesise(
        TABLE.rename(output="y"), Q
    ),
    r"P is labelled with 120 frequencies from 0.03 .* Leave omega out": lambda: synthesise(
        TABLE, Q, 0.99 * OMEGA
    ),
    "P.frequency is in 'Hz'": lambda: synthesise(TABLE.assign_coords(frequency=IN_HERTZ), Q),
    "omega is in 'Hz'": lambda: synthesise(P, Q, IN_HERTZ),
    r"design.labels = .*, but P.labels = \['y', 'x'.* same order": lambda: DESIGN.check(TURNED),
    r"P\[0\].labels = .*, but P\[1\].labels = .* same order": lambda: synthesise(
        [MODEL, TURNED], Q
    ),
    r"P.output = \['x', 'x'\]": lambda: DESIGN.check(TABLE.assign_coords(output=["x", "x"])),
    r"P\[0\] has shape": lambda: synthesise([*map(pd.DataFrame, P)], Q, OMEGA),
    "Q is labelled with .*31.4": lambda: convergence(MODEL, GAINS[::-1], L, OMEGA),
    "uncertainty is lab": lambda: measured_response(DATA, uncertainty=RADIUS[::-1]),
    r"scale holds the signals \['y', 'z'\], but must": lambda: synthesise(
        MODEL, Q, scale=pd.Series([1.0, 2.0], ["y", "z"])
    ),
    r"scale holds .* must hold \[0, 1\]": lambda: synthesise(P, Q, OMEGA, scale=SCALE),
    # in a square trial no shape shows what is the time
    "v has the dimensions .* transpose it": lambda: Law(Q, L).next(SIGNAL, SIGNAL),
}


@pytest.mark.parametrize("words", REFUSED)
def test_labels_that_contradict_are_refused(words):
    with pytest.raises(ValueError, match=f"^(?s:{words})"):
        REFUSED[words]()
