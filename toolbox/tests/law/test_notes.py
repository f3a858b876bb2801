"""Loops and laws noted in a log, and in a file of a law."""

import json
from dataclasses import replace

import control
import numpy as np
import pytest

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    current_trial_loop,
    law_of,
    load_law,
    load_log,
    run_trials,
    save_law,
    save_log,
    synthesise,
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


def trials_of(loop, rows=9):
    """A trial whose metadata name the loop."""
    law = Law(zero_phase_butterworth(2, 0.1, loop.Ts), None, loop=loop)
    return with_law(run_trials(loop, law, np.ones((rows, len(loop.outputs))), None, 1), law)


def test_the_loop_is_rebuilt_to_the_last_digit(loop, tmp_path):
    for each in (loop, LOOP):
        save_log(trials_of(each), tmp_path / "log.csv")
        rebuilt = loop_of(load_log(tmp_path / "log.csv"))
        assert loop_note(rebuilt) == loop_note(each)
        assert rebuilt.plant.A.tobytes() == each.plant.A.tobytes()
        assert trials_of(rebuilt).identical(trials_of(each))


NOTE = json.loads(trials_of(LOOP).attrs["loop"])
REFUSALS = [  # what the metadata say of the loop, and what the error names
    ("", None),
    ("", {"plant": {"A": 1}}),
    ("KL has shape", NOTE | {"KL": [[1.0]]}),
    ("units", NOTE | {"units": ["K", "W"]}),
    ("plant.dt = True", NOTE | {"plant": NOTE["plant"] | {"dt": True}}),
]


@pytest.mark.parametrize(("message", "note"), REFUSALS)
def test_a_note_that_is_no_loop_is_refused(message, note):
    with pytest.raises(LogError, match=f"loop cannot be understood: .*{message}"):
        loop_of(trials_of(LOOP).assign_attrs(loop=json.dumps(note)))


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


def test_a_filter_that_looks_back_is_noted_in_the_newer_formats(tmp_path):
    law, path = replace(LAW, L=LearningFilter([[[0.1, 0.2]]], 0.1, first=-1)), tmp_path / "file"
    save_law(path, law)
    assert json.loads(path.read_text())["format"] == "rodlib law 2"
    assert load_law(path).L.first == -1
    path.unlink()
    save_log(with_law(trials_of(LOOP), law), path)
    assert path.read_text().startswith("# format: rodlib trial log 3\n")


Q2 = zero_phase_butterworth(3, 1 / 3, 1.0, ends="hold")
L = LearningFilter(1e9 * np.random.default_rng(0).standard_normal((2, 2, 3)), 1.0, "hold")


def test_a_law_is_kept_to_the_last_digit_by_a_log_and_by_a_file(loop, tmp_path):
    limits, note, log, file = {"Q1": (-1.0, 1 / 3)}, 'ε\n"', tmp_path / "log", tmp_path / "law"
    law = Law(Q2, L, rest=7, gain=1 / 3, limits=limits, loop=loop)
    save_log(with_law(trials_of(loop, rows=30), law), log)
    save_law(file, law, note=note)
    assert json.loads(file.read_text(encoding="utf-8"))["note"] == note
    of_log = law_of(load_log(log))
    assert of_log.bound_to(loop) is of_log
    for kept in (of_log, load_law(file)):
        assert (kept.Q, kept.rest, kept.gain, kept.limits) == (Q2, 7, 1 / 3, limits)
        np.testing.assert_array_equal(kept.L.coefficients, L.coefficients)
        assert (kept.L.Ts, kept.L.ends) == (1.0, "hold")


def test_what_is_usual_is_not_noted(loop, Q):
    trials = run_trials(loop, Law(Q, None), np.zeros((30, 2)), trials=2)
    plain = with_law(trials, Law(Q, None))
    assert plain.attrs.keys() == {"Ts", "Q", "L"}  # defaults are not written
    assert law_of(plain).L is None and law_of(plain).loop is None
    assert law_of(trials) is None
    base = synthesise(loop, Q).filter.B  # alone, it is no filter of a design
    assert law_of(with_law(trials, Law(Q, base))) is None
    operator = NormOptimal(loop.P, 1.0, 30, errors=np.eye(30, 2) + 0.5)
    noted = law_of(with_law(trials, Law(Q, operator))).L
    e = np.random.default_rng(0).normal(size=(30, 2))
    np.testing.assert_allclose(noted.apply(e), operator.apply(e), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "note",
    [{"L": '{"coefficients": 3}'}, {"L": "[" * 9999}, {"Q": "{}"},
     {"rest": "soon"}, {"step": "NaN"}, {"actuators": '{"Q9": [0, 1]}'}],
)  # fmt: skip
def test_a_note_that_is_not_a_law_is_refused(loop, Q, note):
    with pytest.raises(LogError, match="law cannot be understood"):
        law_of(with_law(trials_of(loop), Law(Q, L, loop=loop)).assign_attrs(note))
    wide = Law(Q, LearningFilter(np.ones((3, 3, 4)), 1.0))  # of another plant
    with pytest.raises(LogError, match="log has 2 outputs, but law has 3 outputs"):
        law_of(with_law(trials_of(loop), wide))


@pytest.mark.parametrize(
    "other",
    [b"[]", b"{}", b"Chapter 1", b'{"Ts": 1, "Ts": 2}', b"[" * 9999, b"\xff\xfe\x00" * 9999],
)
def test_only_a_law_is_read_and_replaced_by_a_law(tmp_path, Q, other):
    path = tmp_path / "law.json"
    path.write_bytes(other)
    with pytest.raises(ValueError, match=r"law.json' is not a law saved by save_law") as error:
        load_law(path)
    assert len(str(error.value)) < 1000
    with pytest.raises(ValueError, match=r"law.json' is a file of another kind"):
        save_law(path, Law(Q, L))
    assert path.read_bytes() == other
    path.unlink()
    with pytest.raises(ValueError, match="L = None"):
        save_law(path, Law(Q, None))
    for gain in (1.0, 0.5):
        save_law(path, Law(Q, L, gain=gain))
    assert load_law(path).gain == 0.5
