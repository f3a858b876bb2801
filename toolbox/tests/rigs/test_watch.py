"""What a trial is warned of, and how often."""

import warnings
from functools import partial

import numpy as np
import pytest
from plants import LOOPS, RestartingModel, bump

from ilctools import Law, record, zero_phase_butterworth
from ilctools.rigs.watch import EACH_TRIAL, warn_once

STAGE = LOOPS["stage"]()


def test_most_kinds_are_said_once_and_those_of_a_single_trial_each_time():
    kinds, before = ["pause", "limits", "rig", "grows", "start", "clock"], set()
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        for _ in range(3):
            warn_once({kind: kind for kind in kinds} | {"nothing": ""}, before)
    said = [str(warning.message) for warning in seen]
    assert sorted(said) == sorted([*kinds, *EACH_TRIAL, *EACH_TRIAL])


def test_late_samples_are_counted_from_a_tenth_of_the_sampling_period_on():
    rig, times = RestartingModel(STAGE.plant, STAGE.commands), np.arange(1000) * STAGE.Ts
    times[3::60] += 0.09 * STAGE.Ts  # in each trial of 60 samples, this one is near enough
    times[[5, 7]] += [0.11 * STAGE.Ts, -0.5 * STAGE.Ts]
    times[60:] += 0.3  # s: samples are due from the first one of a trial on
    rig.clock = partial(next, iter(times))
    with pytest.warns(
        UserWarning, match="2 samples were not on time; the largest deviation was 0.0005 s"
    ) as seen:
        law = Law(zero_phase_butterworth(2, 300.0, STAGE.Ts), None)
        record(rig, STAGE, law, bump(60, [2.0]), trials=2)
    assert len([warning for warning in seen if "not on time" in str(warning.message)]) == 1
