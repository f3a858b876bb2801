"""Norm-optimal learning against dense algebra."""

import pickle
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Priced(NormOptimal):
    """One with a field more, as a variant of it would have."""

    price: float = 0.0

    def apply(self, signal):
        return super().apply(signal) / (1 + self.price)


def test_a_field_more_travels_to_another_process_and_factors_do_not():
    L, e = Priced(random_stable(1), 0.03, 3000, price=1.5), np.ones((3000, 2))
    applied = L.apply(e)
    text = pickle.dumps(L)
    there = pickle.loads(text)
    assert type(there) is Priced and there.price == 1.5 and len(text) < 5000
    np.testing.assert_array_equal(there.apply(e), applied)
