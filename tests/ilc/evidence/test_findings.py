"""The certificate says when the problem itself promises little, and warns who asked for it."""

from contextlib import nullcontext

import control
import numpy as np
import pytest

from rodlib import synthesise, zero_phase_butterworth
from rodlib.ilc.evidence.certificate import certify
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import Solution

OMEGA = np.geomspace(1e-4, np.pi, 200)


def behind_delay(steps):
    """The lag 0.1 / (z - 0.9) behind a delay, which answers after steps + 1 samples."""
    chain = control.ss(
        np.eye(steps, k=-1), np.eye(steps, 1), np.eye(1, steps, k=steps - 1), 0, 1.0
    )
    return chain * control.ss(0.9, 0.1, 1, 0, 1.0)


@pytest.mark.parametrize(
    ("order", "warned"), [(10, True), (30, True), (31, False), (35, False)]
)
def test_a_filter_shorter_than_the_delay_is_named(order, warned):
    Q = zero_phase_butterworth(2, 0.05)
    with pytest.warns(match="it never sees what it does") if warned else nullcontext():
        design = synthesise(
            behind_delay(30), Q, OMEGA, 1.0, order=order, L_max=30.0, M_max=0.999
        )
    text = f"and the filter looks ahead by only {order}: it never sees what it does"
    assert any(text in warning for warning in design.certificate.warnings) == warned
    assert ("WARNING: P responds after" in str(design)) == warned


def test_a_loop_slower_than_the_band_is_named(loop, Q, omega):
    slow = control.ss(0.999, 0.001, 1, 0, 1.0)
    with pytest.warns(match="take a faster loop") as said:
        design = synthesise(slow, Q, OMEGA, 1.0, band=(1e-4, 0.1), L_max=None)
    assert [line.filename for line in said] == [__file__]
    [warning] = design.certificate.warnings
    assert warning.startswith("at 0.09") and "the loop passes only 0.01 of w" in warning
    assert synthesise(loop, Q, omega, 1.0).certificate.warnings == []


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
    P = behind_delay(1)
    problem = pose(P, zero_phase_butterworth(2, 0.05), OMEGA, 1.0)
    nothing = Solution(
        np.zeros((1, 1, 10)), np.zeros((200, 1, 1)), np.zeros((200, 1, 1)), 1, "", 0
    )
    assert certify(problem, nothing).warnings == [
        "the filter leaves 100% of the error in the band"
    ]
