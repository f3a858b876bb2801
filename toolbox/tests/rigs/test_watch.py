"""What a trial is warned of, how often, and in which line of whose program."""

import warnings

import pytest
from plants import LOOPS, RestartingModel, bump

from ilctools import Law, LearningFilter, multisine, record, shake, zero_phase_butterworth
from ilctools.rigs.watch import EACH_TRIAL, Warner

STAGE = LOOPS["stage"]()
Q = zero_phase_butterworth(2, 300.0, STAGE.Ts)


def said(texts):
    """How often each kind is warned of in three trials."""
    warner = Warner()
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        for _ in range(3):
            warner.warn(texts)
    return [str(warning.message) for warning in seen]


def test_most_kinds_are_said_once_and_those_of_a_single_trial_each_time():
    kinds = ["pause", "limits", "rig", "grows", "start", "clock"]
    texts = said({kind: kind for kind in kinds})
    assert {kind: texts.count(kind) for kind in kinds} == {
        kind: 3 if kind in EACH_TRIAL else 1 for kind in kinds
    }
    assert said({"limits": "", "clock": ""}) == []


def limited():
    rig = RestartingModel(STAGE.plant, STAGE.commands)
    rig.limits = dict.fromkeys(STAGE.commands, (-1.0, 1.0))
    return rig


def recorded_within():
    record(limited(), STAGE, Law(Q, LearningFilter([[[0.3]]], STAGE.Ts)), bump(60, [2.0]), trials=2)


def recorded_without():
    record(limited(), STAGE, Law(Q, None, limits={}), bump(60, [2.0]), trials=2)


def shaken():
    excitation = multisine(STAGE, 0.1 / STAGE.Ts, 1.0 / STAGE.Ts, 1.0, 0.4 * STAGE.Ts, lines=8)
    shake(limited(), STAGE, excitation)


@pytest.mark.parametrize(
    ("run", "message", "times"),
    [
        (recorded_within, "they were cut off; v is learned within", 1),
        (recorded_without, "what the rig cuts off, the law does not know", 2),
        (shaken, "what the rig cuts off, the law does not know", None),
    ],
)
def test_a_warning_names_the_line_that_called(run, message, times):
    """However many functions lie between it and the trial."""
    with pytest.warns(UserWarning) as seen:
        run()
    about = [warning for warning in seen if message in str(warning.message)]
    assert len(about) == times or (times is None and about)
    first, count = run.__code__.co_firstlineno, len([*run.__code__.co_lines()])
    for warning in about:
        assert warning.filename == __file__ and first < warning.lineno <= first + count
