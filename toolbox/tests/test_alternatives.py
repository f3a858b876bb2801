"""Norm-optimal learning against dense algebra."""

import control
import numpy as np
from plants import LOOPS, lifted, random_stable

from ilctools import NormOptimal


def test_norm_optimal_solves_the_lifted_problem():
    """By dense algebra: with feedthrough, a delay, more outputs, states of 1e-20 to 1e20."""
    weight, like, rng = 0.03, random_stable(1), np.random.default_rng(0)
    units = np.geomspace(1e-20, 1e20, like.nstates)
    A, B, C = like.A * units / units[:, None], like.B / units[:, None], like.C * units
    scaled, furnace = control.ss(A, B, C, like.D, like.dt), LOOPS["furnace"]().P
    for P in (like, scaled, furnace, like[:, 0]):
        G, L = lifted(P, 60), NormOptimal(P, weight, 60)
        e = rng.standard_normal((60, L.channels))
        dense = np.linalg.solve(G.T @ G + weight * np.eye(G.shape[1]), G.T @ e.ravel())
        np.testing.assert_allclose(L.apply(e).ravel(), dense, atol=1e-9)
