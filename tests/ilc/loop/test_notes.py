"""The loop noted in a log."""

import json
import re
from dataclasses import fields

import control
import numpy as np
import pytest

from rodlib import (
    Law,
    current_trial_loop,
    load_log,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from rodlib.ilc.law.io import with_law
from rodlib.ilc.loop.notes import LogError, loop_of


def assert_alike(one, two):
    for part in fields(one):
        a, b = getattr(one, part.name), getattr(two, part.name)
        if isinstance(a, control.StateSpace):
            assert (a.dt, a.input_labels, a.output_labels) == (
                b.dt,
                b.input_labels,
                b.output_labels,
            )
            for name in "ABCD":
                assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        else:
            assert np.array_equal(a, b)


def test_the_loop_is_rebuilt_to_the_last_digit(loop, tmp_path):
    plant = control.ss(
        0.7, 1 / 3, 1, 0, 0.1, inputs=['the "valve"'], outputs=["level, ϑ"]
    )
    named = control.ss(
        0.7, 1 / 3, 1, 0, 0.1, inputs=["B"], outputs=["A"]
    )  # as its matrices
    for made in (loop, current_trial_loop(plant), current_trial_loop(named)):
        Q = zero_phase_butterworth(Ts=made.Ts)
        reference = np.ones((9, made.plant.noutputs))
        run = run_trials(made, Law(Q, None), reference, None, 1)
        save_log(with_law(run, Law(Q, None, loop=made)), tmp_path / "log.csv")
        rebuilt = loop_of(load_log(tmp_path / "log.csv"))
        assert_alike(made, rebuilt)
        assert run_trials(rebuilt, Law(Q, None), reference, None, 1).identical(run)


@pytest.mark.parametrize(
    "note", ["{}", "3", "null", "", '{"plant": {"A": 1}}', '{"colour": 1}']
)
def test_a_loop_that_is_none_is_refused(loop, Q, note):
    run = run_trials(loop, Law(Q, None), np.ones((9, 2)), None, 1)
    assert loop_of(run) is None
    with pytest.raises(LogError, match="loop cannot be understood"):
        loop_of(run.assign_attrs(loop=note))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"KL": [["a"] * 2] * 3}, "KL holds values of type <U1, but must hold numbers"),
        ({"KL": [[1.0]]}, r"KL has shape \(1, 1\), but must have shape"),
        ({"N": [[True, 0.5], [0.5, 1.0]]}, "N holds True or False"),
        ({"Ks": None}, "Ks holds values of type object"),
        ({"units": {"Q1": "W"}}, r"units\['Q3'\] = None must be a str"),
        ({"units": ["K", "W"]}, r"units = \['K', 'W'\] must be a dict"),
        ({"dt": True}, "plant.dt = True must be a sampling period"),
    ],
)
def test_a_loop_with_a_part_that_is_none_is_refused(loop, Q, changes, message):
    run = with_law(
        run_trials(loop, Law(Q, None), np.ones((9, 2)), None, 1),
        Law(Q, None, loop=loop),
    )
    note = json.loads(run.attrs["loop"])
    for name, value in changes.items():
        (note if name in note else note["plant"])[name] = value
    with pytest.raises(
        LogError, match=f"metadata: loop cannot be understood: .*{message}"
    ):
        loop_of(run.assign_attrs(loop=json.dumps(note)))


def test_the_loop_of_other_signals_is_refused(loop, Q):
    run = with_law(
        run_trials(loop, Law(Q, None), np.ones((9, 2)), None, 1),
        Law(Q, None, loop=loop),
    )
    with pytest.raises(
        LogError, match=r"loop.outputs = \['y1', 'y2'\], log.outputs = \['a', 'b'"
    ):
        loop_of(run.assign_coords(output=("channel", ["a", "b"])))
    with pytest.raises(LogError, match=r"loop\.Ts = 1\.0, log\.Ts = 2\.0"):
        loop_of(run.assign_attrs(Ts=2.0))


def test_the_loop_in_other_units_is_refused():
    units = {"depth": "mm", "valve": "l/min", "rain": "l/s"}
    plant = control.ss(
        0.9, [[0.1, 0.2]], 1, 0, 1.0, inputs=["valve", "rain"], outputs=["depth"]
    )
    Q, made = (
        zero_phase_butterworth(),
        current_trial_loop(plant, ["valve"], units=units),
    )
    run = with_law(
        run_trials(made, Law(Q, None), np.ones((9, 1)), None, 1),
        Law(Q, None, loop=made),
    )
    for role, unit in {"output": "m", "control": "m**3/s", "source": "l/h"}.items():
        dimension = "source" if role == "source" else "channel"
        other = run.assign_coords({f"{role}_unit": (dimension, [unit])})
        with pytest.raises(
            LogError, match=f"loop has .* but log in '{re.escape(unit)}'"
        ):
            loop_of(other)
    unknown = run.assign_coords(output_unit=("channel", [""]))
    assert_alike(loop_of(unknown), made)
