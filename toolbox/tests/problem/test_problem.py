"""The problem as solver and evidence take it."""

import numpy as np
from plants import random_response
from problems import posed


def test_what_was_chosen_and_what_is_assumed_is_said_and_singular_plants_are_counted():
    P, Q, omega = random_response(1, 2)
    values = np.linalg.svd(P, compute_uv=False)[:, -1]
    problem = posed(P, Q, omega, 1.0, uncertainty=values * (omega > 1) + 1e-3)
    np.testing.assert_array_equal(problem.singular_within_radius, omega > 1)
    chosen, *_, of_Q, lost = map(str, problem.assumptions)
    assert chosen.startswith("chosen: order = ") and "; band = (" in chosen
    assert of_Q == f"assumed: Q is splined between its samples, and {Q[-1]:.4g} above the last"
    assert f"nothing can be learned at {np.sum(omega > 1)} frequencies from " in lost
