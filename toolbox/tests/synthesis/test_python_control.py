"""What python-control's users pass and get back: theirs in, theirs out."""

import warnings

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from paper import paper_loop

from ilctools import (
    ClosedLoop,
    LearningFilter,
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


def test_a_filter_is_called_at_numbers():
    with pytest.raises(ValueError, match="z holds values"):
        LearningFilter(np.ones((1, 1, 2)), 1.0)("here")


def test_a_drawing_takes_axes_and_returns_what_theirs_returns():
    figure, ax = plt.subplots()
    drawn = DESIGN.plot(ax=ax)
    assert isinstance(drawn, control.ControlPlot)
    assert drawn.axes.ravel().tolist() == [ax]
    of_M, *_ = ax.lines
    np.testing.assert_allclose(of_M.get_ydata(), DESIGN.sigma_M, rtol=1e-9)
    plt.close(figure)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("P[1]", lambda: synthesise([ONE, CONTINUOUS], Q)),
        ("P", lambda: ClosedLoop(AS_STATES, Ts=0.01)),
        ("plant", lambda: current_trial_loop(AS_STATES)),
        ("plant", lambda: run_trials(LOOP, DESIGN.law(), np.ones((9, 2)), plant=AS_STATES)),
    ],
)  # fmt: skip
def test_a_continuous_plant_names_what_samples_it(name, call):
    with pytest.raises(ValueError) as error:
        call()
    remedy = f"{name}.dt = 0 is continuous time: pass control.sample_system({name}, Ts)"
    assert remedy in str(error.value)


def test_a_table_makes_no_loop_and_a_law_is_printed_without_its_region():
    with pytest.raises(ValueError, match=r"P is a table .* ClosedLoop\(Ts=..., outputs=\[...\]\)"):
        ClosedLoop(P)
    measured = measured_response(P, uncertainty=np.full(len(P.omega), 1e-4))
    with warnings.catch_warnings(action="ignore"):
        law = synthesise(measured, Q, order=10).law()
    assert law.region is not None and len(repr(law)) < 500


LAST = "its last axis belongs first, as in np.moveaxis({}, -1, 0)"
ROWS = np.ones((2, 30))
SIGNALS = {
    "P": lambda: synthesise(P.frdata, Q, OMEGA),
    "P[0]": lambda: synthesise([P.frdata, P.frdata], Q, OMEGA),
    "plant": lambda: LOOP.frequency_response(OMEGA, P.frdata),
    "reference": lambda: run_trials(LOOP, DESIGN.law(), ROWS),
    "signal": lambda: DESIGN.filter.apply(ROWS),
}


@pytest.mark.parametrize("name", SIGNALS)
def test_arrays_laid_out_as_theirs_are_refused_with_the_remedy(name):
    with pytest.raises(ValueError, match=r"has shape") as error:
        SIGNALS[name]()
    assert LAST.format(name) in str(error.value)


def test_their_squeezed_response_of_one_channel_is_refused():
    squeezed = ONE(np.exp(1j * OMEGA))
    with pytest.raises(ValueError, match=r"P has shape .* pass P\.reshape\(\(\d+, 1, 1\)\)$"):
        synthesise(squeezed, Q, OMEGA)
    with warnings.catch_warnings(action="ignore"):
        design = synthesise(squeezed[:, None, None], Q, OMEGA, order=3)
    assert design.sigma_M == pytest.approx(OF_ONE.sigma_M, abs=1e-4)


def test_an_array_is_no_measured_response_and_says_how_to_pass_it():
    with pytest.raises(ValueError, match=r"control\.frd\(log, omega, Ts\)"):
        measured_response(P.frdata)
