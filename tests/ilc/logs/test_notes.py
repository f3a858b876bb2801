import json
import re
from dataclasses import fields

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rodlib import (
    LearningFilter,
    LogError,
    current_trial_loop,
    load_law,
    load_log,
    run_trials,
    save_law,
    save_log,
    zero_phase_butterworth,
)
from rodlib.ilc import law_of, loop_of, rest_of, step_of, with_law


def test_the_law_is_noted_and_found_again(loop, Q):
    rng = np.random.default_rng(0)
    L = LearningFilter(rng.standard_normal((2, 2, 3)), 1.0, "hold")
    run = run_trials(loop, Q, L, np.zeros((30, 2)), None, 2)
    noted_Q, noted_L = law_of(with_law(run, Q, L))
    assert noted_Q == Q
    np.testing.assert_array_equal(noted_L.coefficients, L.coefficients)
    assert noted_L.ends == "hold"
    assert law_of(with_law(run, Q, None))[1] is None
    assert law_of(run) is None


@pytest.mark.parametrize(
    "L", ["{}", "0", "false", "[]", "null, 1", '{"coefficients": 3}', "[" * 9999]
)
def test_a_law_that_is_none_is_refused(loop, Q, L):
    run = run_trials(loop, Q, None, np.zeros((5, 2)), None, 1)
    with pytest.raises(LogError, match="L cannot be understood"):
        law_of(with_law(run, Q, None).assign_attrs(L=L))
    with pytest.raises(LogError, match="Q cannot be understood"):
        law_of(run.assign_attrs(Q=L, L="null"))


def test_a_law_for_other_channels_is_refused(loop, Q):
    run = run_trials(loop, Q, None, np.zeros((5, 2)), None, 1)
    with pytest.raises(
        LogError, match=r"shape \(3, 3, 4\), but must have shape \(2, 2, order\)"
    ):
        law_of(with_law(run, Q, LearningFilter(np.ones((3, 3, 4)), 1.0)))


def test_the_rest_is_noted_and_found_again(loop, Q, tmp_path):
    run = run_trials(loop, Q, None, np.zeros((30, 2)), None, 2)
    assert rest_of(run) == rest_of(with_law(run, Q, None)) == 0
    assert with_law(run, Q, None).attrs.keys() == {"Ts", "Q", "L"}
    save_log(with_law(run, Q, None, rest=7), tmp_path / "log.csv")
    assert "# rest: 7\n" in (tmp_path / "log.csv").read_text()
    assert rest_of(load_log(tmp_path / "log.csv")) == 7
    assert rest_of(run.assign_attrs(rest="29")) == 29
    for note in ("30", "-1", "1.5", "soon", 3):
        with pytest.raises(LogError, match="rest cannot be understood"):
            rest_of(run.assign_attrs(rest=note))


def test_the_step_is_noted_and_found_again(loop, Q, tmp_path):
    run = run_trials(loop, Q, None, np.zeros((30, 2)), None, 2)
    assert step_of(run) == step_of(with_law(run, Q, None)) == 1
    save_log(with_law(run, Q, None, step=1 / 3), tmp_path / "log.csv")
    assert step_of(load_log(tmp_path / "log.csv")) == 1 / 3
    for note in ("0", "1.1", "-1", "NaN", "true", "[1]", "soon", 3):
        with pytest.raises(LogError, match="step cannot be understood"):
            step_of(run.assign_attrs(step=note))


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
        run = run_trials(made, Q, None, reference, None, 1)
        save_log(with_law(run, Q, None, 0, made), tmp_path / "log.csv")
        rebuilt = loop_of(load_log(tmp_path / "log.csv"))
        assert_alike(made, rebuilt)
        assert run_trials(rebuilt, Q, None, reference, None, 1).identical(run)


@pytest.mark.parametrize(
    "note", ["{}", "3", "null", "", '{"plant": {"A": 1}}', '{"colour": 1}']
)
def test_a_loop_that_is_none_is_refused(loop, Q, note):
    run = run_trials(loop, Q, None, np.ones((9, 2)), None, 1)
    assert loop_of(run) is None
    with pytest.raises(LogError, match="loop cannot be understood"):
        loop_of(run.assign_attrs(loop=note))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"KL": [["a"] * 2] * 3}, "KL holds values of type <U1, but must hold numbers"),
        ({"KL": [["1_0"] * 2] * 8}, "KL holds values of type <U3"),
        ({"KL": "strong"}, "KL holds values of type <U6"),
        ({"KL": [[1.0]]}, r"KL has shape \(1, 1\), but must have shape"),
        ({"N": [[True, 0.5], [0.5, 1.0]]}, "N holds True or False"),
        ({"Ks": None}, "Ks holds values of type object"),
        ({"units": {"Q1": "W"}}, r"units\['Q3'\] = None must be a str"),
        ({"units": ["K", "W"]}, r"units = \['K', 'W'\] must be a dict"),
        ({"dt": True}, "plant.dt = True must be a sampling period"),
        ({"A": [["1"]]}, "plant.A holds values of type <U1"),
    ],
)
def test_a_loop_with_a_part_that_is_none_is_refused(loop, Q, changes, message):
    run = with_law(
        run_trials(loop, Q, None, np.ones((9, 2)), None, 1), Q, None, 0, loop
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
        run_trials(loop, Q, None, np.ones((9, 2)), None, 1), Q, None, 0, loop
    )
    with pytest.raises(
        LogError, match=r"loop has the outputs \['y1', 'y2'\], but the log \['a', 'b'"
    ):
        loop_of(run.assign_coords(output=("channel", ["a", "b"])))
    with pytest.raises(LogError, match=r"log.Ts = 2.0 s, loop.Ts = 1.0 s"):
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
        run_trials(made, Q, None, np.ones((9, 1)), None, 1), Q, None, 0, made
    )
    for role, unit in {"output": "m", "control": "m**3/s", "source": "l/h"}.items():
        dimension = "source" if role == "source" else "channel"
        other = run.assign_coords({f"{role}_unit": (dimension, [unit])})
        with pytest.raises(
            LogError, match=f"loop has .* but the log in '{re.escape(unit)}'"
        ):
            loop_of(other)
    unknown = run.assign_coords(output_unit=("channel", [""]))
    assert_alike(loop_of(unknown), made)


# A law in a file of its own

COEFFICIENTS = arrays(float, (2, 2, 3), elements=st.floats(-1e9, 1e9))


@settings(max_examples=5)
@given(
    COEFFICIENTS,
    st.integers(1, 4),
    st.floats(0.1, 0.9),
    st.floats(1e-4, 1e4),
    st.text(),
)
def test_filters_come_back_to_the_last_digit(
    tmp_path_factory, coefficients, order, share, Ts, note
):
    path = tmp_path_factory.mktemp("law") / "law.json"
    Q = zero_phase_butterworth(order, share * np.pi / Ts, Ts, ends="hold")
    L = LearningFilter(coefficients, Ts, "hold")
    save_law(path, Q, L, note)
    again, learning = load_law(path)
    assert again == Q
    np.testing.assert_array_equal(learning.coefficients, coefficients)
    assert (learning.Ts, learning.ends) == (Ts, "hold")
    assert json.loads(path.read_text(encoding="utf-8"))["note"] == note


@pytest.fixture
def law(Q):
    return Q, LearningFilter(np.ones((1, 1, 2)), 1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "rodlib law 9"}, "format 'rodlib law 9' is not 'rodlib law 1'"),
        ({"Ts": -1.0}, "Ts = -1.0 must be a positive sampling period"),
        ({"Q": {"order": 2}}, "KeyError"),
        ({"L": None}, "L = None must be a LearningFilter"),
        ({"L": {"coefficients": [1.0], "ends": "zero"}}, "coefficients has shape"),
        (
            {"L": {"coefficients": [[[True, 0.5]]], "ends": "zero"}},
            "holds True or False",
        ),
        ({"Ts": float("nan")}, "NaN is no number"),
    ],
)
def test_a_file_that_is_no_law_is_refused(tmp_path, law, changes, message):
    path = tmp_path / "law.json"
    save_law(path, *law)
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(
        ValueError, match=r"law.json' is no law of save_law: .*"
    ) as error:
        load_law(path)
    assert message in str(error.value)


def test_what_a_file_says_twice_is_refused(tmp_path, law):
    path = tmp_path / "law.json"
    save_law(path, *law)
    path.write_text(path.read_text().replace('"Ts"', '"Ts": 2.0, "Ts"'))
    with pytest.raises(ValueError, match="a name stands there twice"):
        load_law(path)


@pytest.mark.parametrize("text", ["", "[]", "3", "{}", "trial,time\n1,0", "[" * 9999])
def test_any_other_text_is_refused(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="is no law of save_law"):
        load_law(path)


def test_nothing_is_written_that_could_not_be_used(tmp_path, law):
    path = tmp_path / "law.json"
    with pytest.raises(ValueError, match=r"Q.Ts = 1.0 s, L.Ts = 2.0 s"):
        save_law(path, law[0], LearningFilter(np.ones((1, 1, 2)), 2.0))
    with pytest.raises(ValueError, match="L = None must be a LearningFilter"):
        save_law(path, law[0], None)
    with pytest.raises(ValueError, match="note = 3 must be a str"):
        save_law(path, *law, note=3)
    assert not path.exists()
    with pytest.raises(OSError):
        load_law(path)
