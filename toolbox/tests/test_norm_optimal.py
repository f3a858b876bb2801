"""Norm-optimal learning in other processes; what it is on a trial: test_riccati."""

import pickle
from dataclasses import dataclass

import numpy as np
from plants import random_stable

from ilctools import NormOptimal


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
