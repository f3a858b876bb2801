import control
import cvxpy as cp
import numpy as np
import pytest
from limited import plant
from plants import bump, lifted

from ilctools.law.nearest import Norm, NotFound, Rows, nearest


def test_a_program_with_outputs_and_weights_is_that_of_another_solver():
    """Whole-trial matrices in CVXPY: no states. Outputs are weighted, and limited by time."""
    P, samples, active = plant(np.random.default_rng(3), 2, 2), 40, 33
    rng = np.random.default_rng(0)
    errors = rng.uniform(0, 2, (samples, 2))
    high = bump(samples, [-0.5, 0.2]) + 0.1  # somewhere below zero: z has to move there
    rows = Rows(P.C, P.D, np.full((samples, 2), -np.inf), high)
    found = nearest(P, Norm(0.01, errors), samples, active, rows, 1.0)
    z, P_N = cp.Variable(samples * 2), lifted(P, samples)
    cost = cp.sum_squares(cp.multiply(np.sqrt(errors).ravel(), P_N @ z))
    cost = cost + 0.01 * cp.sum_squares(z)
    limits = [P_N @ z <= high.ravel(), z[2 * active :] == 0]
    cp.Problem(cp.Minimize(cost), limits).solve(cp.CLARABEL)
    best = z.value.reshape(samples, 2)[:active]
    assert np.abs(found - best).max() < 1e-4 * np.abs(best).max()
    assert Norm(0.01, errors).size((P_N @ z.value).reshape(samples, 2), z.value) == (
        pytest.approx(cost.value)
    )


def test_what_cannot_be_reached_is_not_found():
    P = control.ss(0.5, 0.5, 1, 0, 1.0)
    rows = Rows(P.C, P.D, np.full((20, 1), -np.inf), np.full((20, 1), -1.0))  # also at the start
    with pytest.raises(NotFound, match="no v within the limits"):
        nearest(P, Norm(0.01), 20, 20, rows, 1.0)
