"""Loops and laws noted in a log, and in a file of a law."""

import json
from dataclasses import replace

import control
import numpy as np
import pytest

from ilctools import (
    Law,
    LearningFilter,
    current_trial_loop,
    law_of,
    load_law,
    load_log,
    run_trials,
    save_law,
    save_log,
    zero_phase_butterworth,
)
from ilctools.errors import LogError
from ilctools.law.limits import LimitsOf
from ilctools.law.notes import loop_note, loop_of, with_law

UNITS = {"depth, ϑ": "mm", 'the "valve"': "l/min", "rain": "l/s"}
PLANT = control.ss(
    0.7, [[1 / 3, 0.2]], 1, 0, 0.1, inputs=['the "valve"', "rain"], outputs=["depth, ϑ"]
)
LOOP = current_trial_loop(PLANT, ['the "valve"'], units=UNITS)


def trials_of(loop):
    """A trial whose metadata name the loop."""
    law = Law(zero_phase_butterworth(2, 0.1, loop.Ts), None, loop=loop)
    return with_law(run_trials(loop, law, np.ones((9, len(loop.outputs))), None, 1), law)


@pytest.mark.parametrize("name", ["the paper's", "one with odd names"])
def test_the_loop_is_rebuilt_to_the_last_digit(name, loop, tmp_path):
    loop = loop if name == "the paper's" else LOOP
    save_log(trials_of(loop), tmp_path / "log.csv")
    rebuilt = loop_of(load_log(tmp_path / "log.csv"))
    assert loop_note(rebuilt) == loop_note(loop)
    assert rebuilt.plant.A.tobytes() == loop.plant.A.tobytes()
    assert trials_of(rebuilt).identical(trials_of(loop))


NOTE = json.loads(trials_of(LOOP).attrs["loop"])
REFUSALS = [  # what the metadata say of the loop, and what the error names
    *(("", word) for word in ("null", '{"plant": {"A": 1}}')),
    ("KL has shape", NOTE | {"KL": [[1.0]]}),
    ("units", NOTE | {"units": ["K", "W"]}),
    ("plant.dt = True", NOTE | {"plant": NOTE["plant"] | {"dt": True}}),
]


@pytest.mark.parametrize(("message", "note"), REFUSALS)
def test_a_note_that_is_no_loop_is_refused(message, note):
    text = note if isinstance(note, str) else json.dumps(note)
    with pytest.raises(LogError, match=f"loop cannot be understood: .*{message}"):
        loop_of(trials_of(LOOP).assign_attrs(loop=text))


def test_the_loop_of_other_signals_or_units_is_refused():
    run = trials_of(LOOP)
    for other, message in (
        (run.assign_coords(output=("channel", ["a"])), "log.outputs"),
        (run.assign_coords(output_unit=("channel", ["m"])), r"log.units\['depth, ϑ'\] = 'm'"),
    ):
        with pytest.raises(LogError, match=message):
            loop_of(other)
    assert loop_note(loop_of(run.assign_coords(output_unit=("channel", [""])))) == loop_note(LOOP)


LAW = Law(zero_phase_butterworth(2, 0.1, 0.1), LearningFilter([[[0.5]]], 0.1))
VALVE = {'the "valve"': (-1.0, 1 / 3)}
STATED = [  # as a user states them, what the law has, and what its file says
    (None, LimitsOf.RIG, None),
    ({}, {}, {}),
    (VALVE, VALVE, {'the "valve"': [-1.0, 1 / 3]}),
]


@pytest.mark.parametrize(("limits", "meant", "noted"), STATED)
def test_a_file_keeps_whose_limits_a_law_has(limits, meant, noted, tmp_path):
    """The rig's, none at all, or its own; a log, which was made within some, leaves none to it."""
    path, again = tmp_path / "law.json", tmp_path / "again.json"
    save_law(path, replace(LAW, limits=limits))
    log = with_law(trials_of(LOOP), replace(LAW, limits=limits, loop=LOOP))
    assert law_of(log).limits == (limits or {}) and ("actuators" in log.attrs) == bool(limits)
    assert json.loads(path.read_text()).get("actuators") == noted
    law = load_law(path)
    assert law.limits == meant
    save_law(again, law)
    assert again.read_bytes() == path.read_bytes()


def test_a_file_of_a_law_with_the_limits_of_the_rig_has_the_bytes_that_it_always_had(tmp_path):
    """Written out as the first version of the toolbox wrote it."""
    save_law(tmp_path / "law.json", Law(LAW.Q, LAW.L, rest=3), note="old")
    Q = {"order": 2, "cutoff": 0.1, "ends": "zero"}
    L = {"coefficients": [[[0.5]]], "ends": "zero"}
    content = {"format": "rodlib law 1", "Ts": 0.1, "Q": Q, "L": L, "rest": 3, "note": "old"}
    content |= {"sections": LAW.Q.sections.tolist()}
    expected = json.dumps(content, indent=1) + "\n"
    assert (tmp_path / "law.json").read_text() == expected
