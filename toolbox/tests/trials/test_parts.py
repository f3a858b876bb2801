"""Trials in parts: with a reset each is one, without it all are."""

import numpy as np
import pytest

from ilctools.law.notes import RESET
from ilctools.signals import dataset
from ilctools.trials.parts import from_rest_to_rest, successions


@pytest.mark.parametrize(
    ("notes", "since", "lengths"),
    [({}, [0, 0, 2, 2], [3, 3, 3, 3]), ({RESET: "none"}, [0, 1, 2, 2], [12])],
)
def test_trials_in_succession_have_one_reference_and_start_alike(notes, since, lengths):
    y = np.repeat([1.0, 1.0, 2.0, 2.0], 3).reshape(4, 3, 1)
    trials = dataset(1.0, ["x"], [], [], {}, reference=y, y=y).assign_attrs(notes)
    assert successions(trials).tolist() == since
    parts = [part["y"] for part in from_rest_to_rest(trials)]
    assert [len(part) for part in parts] == lengths
    np.testing.assert_array_equal(np.concatenate(parts).ravel(), y.ravel())
