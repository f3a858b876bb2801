"""What python-control's users pass and get back: theirs in, theirs out."""

import re

import control
import numpy as np
import pytest
from paper import paper_loop

from ilctools import ClosedLoop, measured_response, run_trials, synthesise, zero_phase_butterworth

LOOP, Q = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0)
OMEGA = np.geomspace(1e-3, np.pi, 60)
P = control.frd(LOOP.P, OMEGA)
DESIGN = synthesise(P, Q, Ts=1.0, order=10, L_max=60.0)
ONE = control.tf([0.1], [1, -0.9], 1.0)
CONTINUOUS = control.tf([400], [1, 20, 400])
AS_STATES = control.ss(CONTINUOUS)


def test_a_filter_is_called_at_z_as_their_systems_are():
    L, z = DESIGN.filter, np.exp(1j * OMEGA)
    polynomials = [
        [[*c[::-1].tolist(), 0.0] for c in row] for row in L.coefficients
    ]  # their polynomials begin with the highest power
    theirs = control.TransferFunction(polynomials, [[[1.0]] * 2] * 2, 1.0)
    for points in (z[3], z, [0.5, 2.0j]):
        np.testing.assert_allclose(L(points), theirs(points), rtol=1e-10)
        assert np.shape(L(points)) == np.shape(theirs(points))


SQUEEZED, ROWS = ONE(np.exp(1j * OMEGA)), np.ones((2, 30))
REFUSED = {  # what the error says, and a call
    "P.dt = 0 is continuous time: pass control.sample_system(P, Ts)": lambda: ClosedLoop(
        AS_STATES, Ts=0.01
    ),
    "plant.dt = 0 is continuous time": lambda: run_trials(
        LOOP, DESIGN.law(), np.ones((9, 2)), plant=AS_STATES
    ),
    "synthesise takes the table": lambda: ClosedLoop(P),
    # arrays laid out as theirs
    "P has shape (2, 2, ": lambda: synthesise(P.frdata, Q, OMEGA),
    "plant has shape (2, 2, ": lambda: LOOP.frequency_response(OMEGA, P.frdata),
    "signal has shape (2, 30), but must": lambda: DESIGN.filter.apply(ROWS),
    "P has shape (60,), but must": lambda: synthesise(SQUEEZED, Q, OMEGA),
    "as control.frd(log, omega, Ts)": lambda: measured_response(P.frdata),
    "z holds values of type": lambda: DESIGN.filter("here"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_refused_names_the_remedy(words):
    with pytest.raises(ValueError, match=re.escape(words)):
        REFUSED[words]()
