"""The least gain, against CVXPY and an inverse."""

import cvxpy as cp
import numpy as np
import pytest
from plants import furnace, lag

from ilctools import current_trial_loop, least_gain, zero_phase_butterworth
from ilctools.errors import SolverError
from ilctools.synthesis import search


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
    """Where the solver would have to find a peak below the least."""
    monkeypatch.setattr(search, "SAME_PEAK", (-0.1,))
    omega = np.linspace(0.01, 3, 30)
    with pytest.raises(SolverError, match="least gain was not found"):
        least_gain(lag(0.5), zero_phase_butterworth(2, 0.3, 1.0), omega, 1.0, order=2)


def test_the_least_gain_of_a_loop_that_can_be_inverted_is_that_of_its_inverse():
    """The loop around a lag and a delay is b / (z - a) / z^n, its inverse a learning filter."""
    loop = current_trial_loop(furnace(3, Ts=30.0), sizes={"outlet": 10.0, "valve": 5.0})
    omega = np.geomspace(1e-3, np.pi, 100) / 30.0
    design = least_gain(loop, np.ones(100), omega, 30.0, order=5)
    inverse = 1 / loop.frequency_response(omega)
    assert 0 <= design.certificate.lower_bound <= design.value < 1e-9
    assert design.problem.L_max == pytest.approx(np.abs(inverse).max(), rel=1e-6)
