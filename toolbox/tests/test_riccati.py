"""The gains of least squares on a trial, and its memory; the trial itself: test_norm_optimal."""

import tracemalloc

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import lag
from scipy.linalg import solve_discrete_are

from ilctools import synthesise
from ilctools.riccati import gains

EPS = np.finfo(float).eps


@pytest.mark.parametrize("pole", [0.5, 0.999])
def test_far_from_the_end_the_gains_are_those_of_the_algebraic_equation(pole):
    """They are not there too early where the closed loop is slow."""
    P = control.append(lag(pole), lag(0.3, gain=5.0))
    P = control.ss(P.A, P.B @ [[1, 0.3], [0.2, 1]], P.C, [[0, 0], [0, 0.5]], 1.0)
    weight = 100.0
    S = solve_discrete_are(P.A, P.B, P.C.T @ P.C, P.D.T @ P.D + weight * np.eye(2), s=P.C.T @ P.D)
    R = P.D.T @ P.D + weight * np.eye(2) + P.B.T @ S @ P.B
    K = np.linalg.solve(R, P.D.T @ P.C + P.B.T @ S @ P.A)
    found = gains(P.A, P.B, P.C, P.D, weight, 10**6)
    assert len(found.K) < 60 / (1 - pole)
    # scipy's solution is exact to rounding times the distance of its poles from the circle
    assert_allclose(found.K[0], K, rtol=0, atol=10 * EPS / (1 - pole) * np.abs(K).max())


def test_memory_is_a_few_signals_and_not_the_factors_of_each_sample():
    """Of the default law, whose L is the base: in units of the signals v or e of a trial."""
    P = control.ss(np.diag([0.95, 0.5, 0.2]), np.ones((3, 1)), [[0.05, 0.1, 0.1]], 0, 1.0)
    law = synthesise(control.append(P, P)).law()
    v, e = np.zeros((20_000, 2)), np.sin(np.arange(40_000.0) / 1e3).reshape(2, -1).T
    tracemalloc.start()
    law.next(v, e)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 30 * v.nbytes  # factors of the same matrices for each sample take 500
