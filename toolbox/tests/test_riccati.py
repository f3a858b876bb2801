"""Least squares on a trial against dense algebra, the algebraic equation and its own optimality."""

import subprocess
import sys

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import STAGE_WITH_MODES, furnace, lag, lifted, random_stable
from scipy.linalg import solve_discrete_are

from ilctools import NormOptimal
from ilctools.models import sampled_plant
from ilctools.riccati import FIRST_LOOK, gains

EPS = np.finfo(float).eps
PLANTS = {
    "with feedthrough, two by two": random_stable(0),
    "more outputs than inputs": random_stable(1)[:, 0],
    "more inputs than outputs": random_stable(2)[0, :],
    "with modes": STAGE_WITH_MODES,
    "with a delay of thirty samples": sampled_plant(furnace(30), "P"),
    "with a zero on the circle": control.ss(control.tf([1, -1], [1, -0.995], 1.0)),
    "with a zero outside": control.ss(control.tf([1, -1.3], [1, -1.7, 0.72], 1.0)),
    "with a state that no input moves": control.append(lag(0.9), lag(0.99))[:, 0],
    "without states": control.ss([], [], [], [[2.0, 0.1], [0.3, 1.0]], 1.0),
}


@pytest.mark.parametrize("share", [0.1, 1e-3])
@pytest.mark.parametrize("name", PLANTS)
def test_it_is_the_matrix_of_the_normal_equations_and_its_transpose(name, share):
    """Shorter and longer than its gains need to settle; for several signals at once."""
    P, random = PLANTS[name], np.random.default_rng(0)
    for samples in (1, FIRST_LOOK, 90):
        P_N = lifted(P, samples)
        size = np.linalg.norm(P_N, 2) or 1.0
        weight = (share * size) ** 2
        above = np.vstack([P_N, np.sqrt(weight) * np.eye(P_N.shape[1])])
        Q, R = np.linalg.qr(above)
        dense = np.linalg.solve(R, Q[: len(P_N)].T)
        L = NormOptimal(P, weight, samples)
        # backward stable solutions of the normal equations: rounding times their condition, and
        # by as much as a norm of a trial may be larger than its largest sample
        condition = EPS * (1 + size**2 / weight) * np.sqrt(len(P_N) + P_N.shape[1])
        for apply, matrix, channels in (
            (L.apply, dense, P.noutputs),
            (L.apply_transposed, dense.T, P.ninputs),
        ):
            signal = random.standard_normal((2, 3, samples, channels))
            expected = signal.reshape(6, -1) @ matrix.T
            atol = condition * np.linalg.norm(matrix, 2) * np.linalg.norm(signal[0, 0])
            assert_allclose(apply(signal).reshape(6, -1), expected, rtol=0, atol=4 * atol)


@pytest.mark.parametrize("pole", [0.5, 0.99, 0.999])
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


def outputs_of(P, signal):
    """P on a signal (time, inputs), sample by sample."""
    x, y = np.zeros(P.nstates), np.empty((len(signal), P.noutputs))
    for p, now in enumerate(signal):
        y[p] = P.C @ x + P.D @ now
        x = P.A @ x + P.B @ now
    return y


def test_of_a_long_trial_no_other_change_is_better(monkeypatch):
    """In many pieces: the gradient P' (e - P change) - weight change is zero."""
    monkeypatch.setattr("ilctools.riccati.PIECE", 2**10)
    P, weight = random_stable(0), 0.02
    random = np.random.default_rng(1)
    e = random.standard_normal((6_000, 2)).cumsum(axis=0)
    change = NormOptimal(P, weight, len(e)).apply(e)
    adjoint = control.ss(P.A.T, P.C.T, P.B.T, P.D.T, P.dt)
    left = e - outputs_of(P, change)
    gradient = outputs_of(adjoint, left[::-1])[::-1] - weight * change
    of_impulse = np.abs(outputs_of(P, np.eye(400, 2))).sum()  # what P makes of a sample, at most
    scale = of_impulse * (np.abs(e).max() + of_impulse * np.abs(change).max())
    assert np.abs(gradient).max() < 100 * EPS * scale


LONG = """
import resource, sys
import control, numpy as np
from ilctools import synthesise
P = control.ss(np.diag([0.95, 0.5, 0.2]), np.ones((3, 1)), [[0.05, 0.1, 0.1]], 0, 1.0)
P = control.append(P, P)
law = synthesise(P).law()
v, e = np.zeros((100_000, 2)), np.sin(np.arange(200_000.0) / 1e3).reshape(2, -1).T
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
law.next(v, e)
added = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(added / (1024 if sys.platform == "darwin" else 1) / (v.nbytes / 1024))
"""


def test_memory_is_a_few_signals_and_not_the_factors_of_each_sample():
    """Of the default law, whose L is the base: in units of the signals v or e of a trial."""
    pytest.importorskip("resource")  # which Windows has not
    run = subprocess.run([sys.executable, "-c", LONG], capture_output=True, text=True, check=True)
    assert float(run.stdout) < 30  # factors of the same matrices for each sample take 500
