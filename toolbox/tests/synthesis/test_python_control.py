"""What python-control's users pass and get back: theirs in, theirs out."""

import re
import warnings

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from paper import paper_loop

from ilctools import (
    ClosedLoop,
    current_trial_loop,
    measured_response,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)

LOOP, Q = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0)
OMEGA = np.geomspace(1e-3, np.pi, 60)
P = control.frd(LOOP.P, OMEGA)
DESIGN = synthesise(P, Q, Ts=1.0, order=10, L_max=60.0)
ONE = control.tf([0.1], [1, -0.9], 1.0)
OF_ONE = synthesise(ONE, Q, OMEGA, order=3)
CONTINUOUS = control.tf([400], [1, 20, 400])
AS_STATES = control.ss(CONTINUOUS)


def test_M_L_and_P_come_back_as_their_data():
    for design, plant in ((DESIGN, P), (OF_ONE, control.frd(ONE, OMEGA))):
        loss = 1 - design.P * design.L if design is OF_ONE else np.eye(2) - P * design.L
        np.testing.assert_allclose(design.P.frdata, plant.frdata, rtol=1e-9)
        M = Q.frequency_response(OMEGA) * loss.frdata
        np.testing.assert_allclose(design.M.frdata, M, rtol=0, atol=1e-9)


def test_their_singular_values_are_those_of_the_certificate():
    for data, largest in ((DESIGN.M, DESIGN.sigma_M), (DESIGN.L, DESIGN.sigma_L)):
        response = control.singular_values_response(data)
        np.testing.assert_array_equal(response.omega, OMEGA)
        np.testing.assert_allclose(response.frdata[0, 0], largest, rtol=1e-9)


def test_a_P_that_came_back_makes_the_same_design():
    again = synthesise(DESIGN.P, Q, order=10, L_max=60.0)
    assert again.value == pytest.approx(DESIGN.value, rel=1e-9)


def test_of_a_scaled_design_they_are_in_its_units():
    scaled = synthesise(P, Q, Ts=1.0, order=10, L_max=60.0, scale=[1.0, 3.0])
    sigma = control.singular_values_response(scaled.M).frdata[0, 0]
    np.testing.assert_allclose(sigma, scaled.sigma_M, rtol=1e-9)
    np.testing.assert_allclose(scaled.P.frdata[1, 0] * 3, P.frdata[1, 0], rtol=1e-9)


@pytest.mark.parametrize("design", [DESIGN, OF_ONE], ids=["two", "one"])
def test_a_filter_is_called_at_z_as_their_systems_are(design):
    L, z = design.filter, np.exp(1j * OMEGA)
    polynomials = [
        [[*c[::-1].tolist(), 0.0] for c in row] for row in L.coefficients
    ]  # their polynomials begin with the highest power
    ones = [[[1.0]] * L.channels] * L.channels
    theirs = control.TransferFunction(polynomials, ones, 1.0)
    for points in (z[3], z, [0.5, 2.0j]):
        np.testing.assert_allclose(L(points), theirs(points), rtol=1e-10)
        assert np.shape(L(points)) == np.shape(theirs(points))
    data = control.frd(L(z), OMEGA)
    np.testing.assert_allclose(data.frdata, design.L.frdata, rtol=1e-9)


def test_a_drawing_takes_axes_and_returns_what_theirs_returns():
    figure, ax = plt.subplots()
    drawn = DESIGN.plot(ax=ax)
    assert isinstance(drawn, control.ControlPlot)
    assert drawn.axes.ravel().tolist() == [ax]
    of_M, *_ = ax.lines
    np.testing.assert_allclose(of_M.get_ydata(), DESIGN.sigma_M, rtol=1e-9)
    plt.close(figure)


def test_a_law_is_printed_without_its_region():
    measured = measured_response(P, uncertainty=np.full(len(P.omega), 1e-4))
    with warnings.catch_warnings(action="ignore"):
        law = synthesise(measured, Q, order=10).law()
    assert law.region is not None and len(repr(law)) < 500


def test_their_squeezed_response_of_one_channel_needs_its_axes():
    with warnings.catch_warnings(action="ignore"):
        design = synthesise(SQUEEZED[:, None, None], Q, OMEGA, order=3)
    assert design.sigma_M == pytest.approx(OF_ONE.sigma_M, abs=1e-4)


SQUEEZED, ROWS = ONE(np.exp(1j * OMEGA)), np.ones((2, 30))
REFUSED = {  # what the error says, and a call
    "P[1].dt = 0 is continuous time: pass control.sample_system(P[1], Ts)": lambda: synthesise(
        [ONE, CONTINUOUS], Q
    ),
    "P.dt = 0 is continuous time: pass control.sample_system(P, Ts)": lambda: ClosedLoop(
        AS_STATES, Ts=0.01
    ),
    "plant.dt = 0 is continuous time: pass control.sample_system(plant": lambda: current_trial_loop(
        AS_STATES
    ),
    "plant.dt = 0 is continuous time": lambda: run_trials(
        LOOP, DESIGN.law(), np.ones((9, 2)), plant=AS_STATES
    ),
    "synthesise takes the table": lambda: ClosedLoop(P),
    # arrays laid out as theirs
    "its last axis belongs first, as in np.moveaxis(P, -1, 0)": lambda: synthesise(
        P.frdata, Q, OMEGA
    ),
    "its last axis belongs first, as in np.moveaxis(P[0], -1, 0)": lambda: synthesise(
        [P.frdata, P.frdata], Q, OMEGA
    ),
    "its last axis belongs first, as in np.moveaxis(plant, -1, 0)": lambda: LOOP.frequency_response(
        OMEGA, P.frdata
    ),
    "its last axis belongs first, as in np.moveaxis(reference, -1, 0)": lambda: run_trials(
        LOOP, DESIGN.law(), ROWS
    ),
    "its last axis belongs first, as in np.moveaxis(signal, -1, 0)": lambda: DESIGN.filter.apply(
        ROWS
    ),
    "pass P.reshape((60, 1, 1))": lambda: synthesise(SQUEEZED, Q, OMEGA),
    "as control.frd(log, omega, Ts)": lambda: measured_response(P.frdata),
    "z holds values of type": lambda: DESIGN.filter("here"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_refused_names_the_remedy(words):
    with pytest.raises(ValueError, match=re.escape(words)):
        REFUSED[words]()
