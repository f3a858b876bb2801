"""What every learning operator has in common, and Q with them; what each is: its own tests."""

import pickle

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import random_stable

from ilctools import LearningFilter, NormOptimal, zero_phase_butterworth
from ilctools.base import RegularisedInverse
from ilctools.filters import LearningOperator
from ilctools.pooled import isometry

RANDOM, SAMPLES, MIDDLE = np.random.default_rng(0), 400, 200
P = random_stable(0)
Ts = P.dt
TALL = control.ss(P.A, P.B, np.vstack([P.C, 2 * P.C]), np.vstack([P.D, 2 * P.D]), Ts)
INVERSE = RegularisedInverse(P, 0.5, [1.0, 4.0])
TAPS = RANDOM.standard_normal((2, 2, 5))
LONG = RANDOM.standard_normal((2, 2, 120)) / 10
LOW = {
    f"Q, {ends}": zero_phase_butterworth(2, 1.0, Ts, ends) for ends in ("zero", "hold", "hold-last")
}
OPERATORS = {
    "ahead": LearningFilter(TAPS, Ts),
    "both ways": LearningFilter(TAPS, Ts, "hold", first=-3),
    "back": LearningFilter(TAPS, Ts, "hold-last", first=-9),
    "long": LearningFilter(LONG, Ts, "hold", first=-60),
    "of three errors": LearningFilter(RANDOM.standard_normal((2, 3, 4)), Ts),
    "B K": INVERSE @ LearningFilter(TAPS, Ts, "hold-last", -2),
    "K B": LearningFilter(TAPS, Ts) @ INVERSE,
    "finite B K": LearningFilter(LONG, Ts, first=-60) @ LearningFilter(TAPS, Ts),
    "inverse": INVERSE,
    "inverse of two models": RegularisedInverse(TALL, 0.5, [1.0, 4.0], isometry(2, 2)),
    "norm-optimal": NormOptimal(P, 0.25, SAMPLES),
    "norm-optimal, of four errors": NormOptimal(TALL, 0.25, SAMPLES),
}


@pytest.mark.parametrize("name", [*LOW, *OPERATORS])
def test_it_is_linear_has_its_transpose_and_its_response_and_travels(name):
    L, random = (LOW | OPERATORS)[name], np.random.default_rng(1)
    rows, columns = getattr(L, "rows", 2), getattr(L, "columns", 2)
    assert isinstance(L, LearningOperator) == (name in OPERATORS)
    x, other = random.standard_normal((2, 3, SAMPLES, columns))
    applied = L.apply(x)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(L)).apply(x), applied)
    size = {"rtol": 0, "atol": 1e-10 * np.abs(applied).max()}
    one_by_one = [2 * L.apply(signal) for signal in other]
    assert_allclose(L.apply(x + 2 * other), applied + one_by_one, **size)
    y = random.standard_normal((3, SAMPLES, rows))
    product = np.sum(L.apply_transposed(y) * x)
    assert np.sum(y * applied) == pytest.approx(product, abs=1e-8 * np.abs(applied).sum())
    pulses, omega = np.zeros((columns, SAMPLES, columns)), np.linspace(0, np.pi / Ts, 9)
    pulses[range(columns), MIDDLE, range(columns)] = 1
    turns = np.exp(-1j * np.outer(omega * Ts, np.arange(SAMPLES) - MIDDLE))
    seen, response = np.einsum("nt,jti->nij", turns, L.apply(pulses)), L.frequency_response(omega)
    response = response if response.ndim == 3 else response[:, None, None] * np.eye(2)  # Q
    assert_allclose(seen, response, rtol=0, atol=1e-7 * np.abs(response).max())


def test_it_learns_in_the_norm_that_it_minimises_or_in_the_usual_one():
    weights = {name: L.weight_of_change for name, L in OPERATORS.items()}
    assert {name for name, weight in weights.items() if weight == 0.25} == {
        "norm-optimal",
        "norm-optimal, of four errors",
    }
    assert {*weights.values()} == {0.25, 0.01}
