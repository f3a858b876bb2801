"""The loop noted in a log."""

import json

import control
import numpy as np
import pytest

from ilctools import Law, current_trial_loop, load_log, run_trials, save_log, zero_phase_butterworth
from ilctools.errors import LogError
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
