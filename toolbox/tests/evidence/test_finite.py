"""How long the trial is whose norm a design prints."""

import numpy as np
import pytest
from plants import furnace, lag

from ilctools import LearningFilter, trial_norm, zero_phase_butterworth
from ilctools.evidence.finite import settled_norm
from ilctools.models import sampled_plant

Q, L = zero_phase_butterworth(2, 0.5, 1.0), LearningFilter([[[0.5]]], 1.0)


@pytest.mark.parametrize(
    ("plants", "samples"),
    [
        ([lag(0.9)], 50 + 10 * np.log(0.02) / np.log(0.9)),  # settled to 2 % ten times
        ([lag(0.5), lag(0.9)], 50 + 10 * np.log(0.02) / np.log(0.9)),  # the slower
        ([sampled_plant(furnace(400, gain=0.1), "P")], 50 + 2 * 401),  # twice its delay
    ],
)
def test_a_trial_is_ten_times_as_long_as_the_plants_settle(plants, samples):
    found, norm = settled_norm(plants, Q, L)
    assert found == int(samples)
    assert norm == pytest.approx(max(trial_norm(P, Q, L, found)[0] for P in plants), rel=1e-7)
