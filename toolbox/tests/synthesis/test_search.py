"""A Q that is left out, and the least gain; that of the paper's filter: test_synthesise."""

import re

import control
import cvxpy as cp
import numpy as np
import pytest
from plants import furnace, lag

from ilctools import (
    current_trial_loop,
    least_gain,
    measured_response,
    synthesise,
    trial_map,
    zero_phase_butterworth,
)
from ilctools.errors import SolverError
from ilctools.synthesis import search

LAG, SLOW = lag(0.5), lag()


def test_without_Q_the_cutoff_is_where_P_ends():
    """Of a lag a tenth of what it is at rest, by its formula; L inverts no more than that."""
    design = synthesise(SLOW)
    ends = 2 * np.arcsin(np.sqrt((1 - 0.1**2) / 0.1**2 * 0.01 / (4 * 0.9)))  # |P| = 0.1
    assert design.problem.lowpass.cutoff == pytest.approx(ends, rel=0.05)
    low = np.exp(1j * design.Q.cutoff / 30)  # up to there L may be 20 times what inverts P
    assert design.problem.L_max == pytest.approx(20 / abs(SLOW(low)), rel=1e-3)
    assert design.sigma_L.max() <= design.problem.L_max * (1 + 1e-4)
    samples, norm = re.search(r"norm of a trial of (\d+) samples (\S+)", repr(design)).groups()
    T = trial_map(SLOW, design.Q, design.filter, int(samples)) @ np.eye(int(samples))
    assert float(norm) == pytest.approx(np.linalg.norm(T, 2), rel=2e-3) and float(norm) < 1


LINES = np.geomspace(0.01, 2, 40)
RESPONSE = LAG(np.exp(1j * LINES)).reshape(1, 1, -1)


def test_what_is_too_uncertain_to_learn_is_said():
    radius = 2 * abs(RESPONSE.ravel())
    below = r"sigma_max\(M\) may reach .* below 0.01 rad/s"  # where Q is above one half
    with (
        pytest.warns(match=r"cut-off 0.01 rad/s, .* next to nothing is learned"),
        pytest.warns(match=below),
    ):
        synthesise(control.frd(RESPONSE, LINES, 1.0), uncertainty=radius)


def test_a_table_alone_is_enough():
    """Its radius, or where it ends, limits the cut-off; the filter does for the plant itself."""
    table = control.frd(RESPONSE, LINES, 1.0)
    for P in (table, measured_response(table, uncertainty=0.02 + 0.1 * LINES)):
        design = synthesise(P)
        assert 0.3 < design.problem.lowpass.cutoff < 3 and design.certificate.failures == []
        assert design.check(LAG).rate < 0.9


def test_the_least_gain_of_a_lag_is_that_of_cvxpy():
    """One filter only has the least peak; there is no band to be named, at any sampling period."""
    Ts, order = 1e-3, 3
    omega = np.geomspace(1e-3, np.pi, 100) / Ts
    Q = zero_phase_butterworth(2, 300.0, Ts)
    design = least_gain(lag(Ts=Ts), Q, omega, order=order, scale=[2.0])
    z = np.exp(1j * omega * Ts)
    L = np.power.outer(z, np.arange(1, order + 1)) @ (c := cp.Variable(order))
    M = cp.multiply(Q.frequency_response(omega), 1 - cp.multiply(0.1 / (z - 0.9), L))
    least = cp.Problem(cp.Minimize(cp.max(cp.abs(M)))).solve("CLARABEL")
    assert design.value == pytest.approx(least, rel=2e-6)
    room = [cp.abs(M) <= least * (1 + 1e-5)]
    gain = cp.Problem(cp.Minimize(cp.max(cp.abs(L))), room).solve("CLARABEL")
    assert design.problem.L_max == pytest.approx(gain, rel=2e-3)
    assert c.size == design.filter.order


def test_a_least_gain_that_is_not_found_is_no_other_gain(monkeypatch):
    def fails(*_, **__):
        raise RuntimeError("the bounds leave less room than rounding takes")

    monkeypatch.setattr(search, "solve_everywhere", fails)
    omega = np.linspace(0.01, 3, 30)
    with pytest.raises(SolverError, match="least gain was not found"):
        least_gain(LAG, zero_phase_butterworth(2, 0.3, 1.0), omega, 1.0, order=2)


def test_the_least_gain_of_a_loop_that_can_be_inverted_is_that_of_its_inverse():
    """The loop around a lag and a delay is b / (z - a) / z^n, its inverse a learning filter."""
    loop = current_trial_loop(furnace(3, Ts=30.0), sizes={"outlet": 10.0, "valve": 5.0})
    omega = np.geomspace(1e-3, np.pi, 100) / 30.0
    design = least_gain(loop, np.ones(100), omega, 30.0, order=5)
    inverse = 1 / loop.frequency_response(omega)
    assert 0 <= design.certificate.lower_bound <= design.value < 1e-9
    assert design.problem.L_max == pytest.approx(np.abs(inverse).max(), rel=1e-6)
