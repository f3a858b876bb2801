"""What a trial is warned of, how often, and in which line of whose program."""

import warnings

import numpy as np
import pytest
from plants import LOOPS, RestartingModel, bump

from ilctools import Law, multisine, record, shake, zero_phase_butterworth
from ilctools.rigs.watch import EACH_TRIAL, warn_once

STAGE = LOOPS["stage"]()
Q = zero_phase_butterworth(2, 300.0, STAGE.Ts)


def test_most_kinds_are_said_once_and_those_of_a_single_trial_each_time():
    kinds, before = ["pause", "limits", "rig", "grows", "start", "clock"], set()
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        for _ in range(3):
            warn_once({kind: kind for kind in kinds} | {"nothing": ""}, before)
    said = [str(warning.message) for warning in seen]
    assert sorted(said) == sorted([*kinds, *EACH_TRIAL, *EACH_TRIAL])


def limited():
    rig = RestartingModel(STAGE.plant, STAGE.commands)
    rig.limits = dict.fromkeys(STAGE.commands, (-1.0, 1.0))
    return rig


def recorded():
    record(limited(), STAGE, Law(Q, None, limits={}), bump(60, [2.0]), trials=2)


def shaken():
    excitation = multisine(STAGE, 0.1 / STAGE.Ts, 1.0 / STAGE.Ts, 1.0, 0.4 * STAGE.Ts, lines=8)
    shake(limited(), STAGE, excitation)


@pytest.mark.parametrize("run", [recorded, shaken])
def test_a_warning_names_the_line_that_called(run):
    """However many functions lie between it and the trial."""
    with pytest.warns(UserWarning, match="the law does not know these limits") as seen:
        run()
    first, count = run.__code__.co_firstlineno, len([*run.__code__.co_lines()])
    for warning in seen:
        assert warning.filename == __file__ and first < warning.lineno <= first + count


def test_late_samples_are_counted_from_a_tenth_of_the_sampling_period_on():
    rig, times = limited(), np.arange(1000) * STAGE.Ts
    times[3::60] += 0.09 * STAGE.Ts  # in each trial of 60 samples, this one is near enough
    times[[5, 7]] += [0.11 * STAGE.Ts, -0.5 * STAGE.Ts]
    ticks = iter(times)
    rig.clock, rig.limits = lambda: next(ticks), {}
    with pytest.warns(
        UserWarning, match="2 samples were not on time; the largest deviation"
    ) as seen:
        record(rig, STAGE, Law(Q, None), bump(60, [2.0]), trials=2)
    assert len([warning for warning in seen if "not on time" in str(warning.message)]) == 1
