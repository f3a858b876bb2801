"""The certificate says when the problem itself promises little, and warns who asked for it."""

import control
import numpy as np
import pytest

from rodlib import synthesise, zero_phase_butterworth
from rodlib.ilc.evidence.certificate import certify
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import Solution

OMEGA = np.geomspace(1e-4, np.pi, 200)


@pytest.mark.parametrize("highest", [0.2, 0.6, 1.0])
def test_a_gain_keeps_its_bound_above_the_design_frequencies(highest):
    lag = control.ss(0.5, 0.5, 1, 0, 1.0)
    omega = np.linspace(1e-3, highest * np.pi, 300)
    Q = zero_phase_butterworth(2, 0.3)
    design = synthesise(lag, Q, omega, 1.0, band=(0.001, 0.2), L_max=5.0)
    L = design.filter.frequency_response(np.linspace(0, np.pi, 20000))
    assert (
        4.9 < np.abs(L).max() <= 5 * (1 + 1e-4)
    )  # in use, and kept, but for between two samples
    np.testing.assert_array_equal(design.omega, omega)
    assert design.sigma_M.shape == design.sigma_L.shape == (300,)


def test_learning_that_does_nothing_is_named():
    P = control.ss(0.9, 0.1, 1, 0, 1.0)
    problem = pose(P, zero_phase_butterworth(2, 0.05), OMEGA, 1.0)
    nothing = Solution(
        np.zeros((1, 1, 10)), np.zeros((200, 1, 1)), np.zeros((200, 1, 1)), 1, "", 0
    )
    assert certify(problem, nothing).warnings == [
        "the filter leaves 100% of the error in the band"
    ]
