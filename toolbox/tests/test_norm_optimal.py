"""Norm-optimal learning on a trial, against dense algebra; see test_operators, too."""

import pickle
from dataclasses import dataclass

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import furnace, lag, lifted, random_stable

from ilctools import NormOptimal
from ilctools.models import sampled_plant

EPS = np.finfo(float).eps
SQUARE = random_stable(0)
UNITS = np.diag(np.geomspace(1e-20, 1e20, 4))
PLANTS = {
    "with feedthrough, two by two": SQUARE,
    "with states of other units": control.ss(
        np.linalg.solve(UNITS, SQUARE.A @ UNITS), np.linalg.solve(UNITS, SQUARE.B),
        SQUARE.C @ UNITS, SQUARE.D, SQUARE.dt,
    ),
    "more outputs than inputs": random_stable(1)[:, 0],
    "more inputs than outputs": random_stable(2)[0, :],
    "with a delay of thirty samples": sampled_plant(furnace(30), "P"),
    "slow": control.append(lag(0.999), lag(0.3, gain=5.0)),
    "with a state that no input moves": control.append(lag(0.9), lag(0.99))[:, 0],
    "without states": control.ss([], [], [], [[2.0, 0.1], [0.3, 1.0]], 1.0),
}  # fmt: skip


@pytest.mark.parametrize("share", [1.0, 0.01, 1e-6])
@pytest.mark.parametrize("name", PLANTS)
def test_it_is_the_matrix_of_the_normal_equations_and_its_transpose(name, share):
    """Down to weights with which it is the inverse, where there is one."""
    P, random = PLANTS[name], np.random.default_rng(0)
    for samples in (1, 8, 90):
        P_N = lifted(P, samples)
        size = np.linalg.norm(P_N, 2) or 1.0
        weight = (share * size) ** 2
        Q, R = np.linalg.qr(np.vstack([P_N, np.sqrt(weight) * np.eye(P_N.shape[1])]))
        dense = np.linalg.solve(R, Q[: len(P_N)].T)
        L = NormOptimal(P, weight, samples)
        # backward stable solutions of the normal equations: rounding times their condition, and
        # by as much as a norm of a trial may be larger than its largest sample
        condition = EPS * (1 + size**2 / weight) * np.sqrt(sum(P_N.shape))
        for apply, matrix in ((L.apply, dense), (L.apply_transposed, dense.T)):
            signal = random.standard_normal((2, samples, matrix.shape[1] // samples))
            expected = signal.reshape(2, -1) @ matrix.T
            atol = condition * np.linalg.norm(matrix, 2) * np.linalg.norm(signal[0])
            assert_allclose(apply(signal).reshape(2, -1), expected, rtol=0, atol=4 * atol)


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
