"""The norm of a trial of several plants, against that of each by itself."""

import control
import pytest
from plants import coupled, lag, others

from ilctools import LearningFilter, synthesise, trial_norm, zero_phase_butterworth
from ilctools.evidence.worst_trial import largest_trial_norm


@pytest.mark.parametrize(
    ("plants", "how"),
    [(others(5), {}), (coupled(3), {}), (others(40)[-5:], {"order": 10, "base": None})],
)
def test_it_is_the_largest_of_all_plants_in_any_order(plants, how):
    lowpass, samples = zero_phase_butterworth(2, 0.4 / plants[0].dt, plants[0].dt), 120
    L = synthesise(plants, lowpass, **how).filter
    norm_of = {P: trial_norm(P, lowpass, L, samples)[0] for P in plants}
    for ordered in (plants, sorted(plants, key=norm_of.get)):
        found = largest_trial_norm(ordered, lowpass, L, samples)
        assert found == pytest.approx(max(norm_of.values()), rel=1e-7)


def test_a_plant_whose_map_is_zero_counts_for_nothing():
    """Of the first plant Q L P = Q, so that its map is zero; with five samples and 120."""
    lowpass, L = zero_phase_butterworth(2, 0.5, 1.0), LearningFilter([[[0.5]]], 1.0, first=0)
    plants = [control.ss([], [], [], [[2.0]], 1.0), lag(0.5)]
    for samples in (5, 120):
        norm = trial_norm(plants[1], lowpass, L, samples)[0]
        assert largest_trial_norm(plants, lowpass, L, samples) == pytest.approx(norm, rel=1e-7)
