"""The law in the metadata of a log, and in a file of its own."""

import json

import numpy as np
import pytest

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    law_of,
    load_law,
    load_log,
    run_trials,
    save_law,
    save_log,
    zero_phase_butterworth,
)
from ilctools.errors import LogError
from ilctools.law.notes import with_law

L = LearningFilter(np.random.default_rng(0).standard_normal((2, 2, 3)), 1.0, "hold")


@pytest.fixture(scope="module")
def trials(loop, Q):
    return run_trials(loop, Law(Q, None), np.zeros((30, 2)), trials=2)


def by_log(law, trials, path):
    save_log(with_law(trials, law), path)
    return law_of(load_log(path))


def by_file(law, _, path):
    save_law(path, law, note='ε\n"')
    assert json.loads(path.read_text(encoding="utf-8"))["note"] == 'ε\n"'
    return load_law(path)


@pytest.mark.parametrize("keep", [by_log, by_file])
def test_a_law_is_kept_to_the_last_digit(keep, loop, trials, tmp_path):
    Q, limits = zero_phase_butterworth(3, 1 / 3, 1.0, ends="hold"), {"Q1": (-1.0, 1 / 3)}
    filter_ = LearningFilter(1e9 * L.coefficients, 1.0, "hold")
    law = Law(Q, filter_, rest=7, gain=1 / 3, limits=limits, loop=loop)
    kept = keep(law, trials, tmp_path / "law.csv")
    assert (kept.Q, kept.rest, kept.gain, kept.limits) == (Q, 7, 1 / 3, limits)
    np.testing.assert_array_equal(kept.L.coefficients, filter_.coefficients)
    assert (kept.L.Ts, kept.L.ends) == (1.0, "hold")
    assert kept.loop is None or kept.bound_to(loop) is kept


def test_what_is_usual_is_not_noted(loop, Q, trials):
    plain = with_law(trials, Law(Q, None))
    assert plain.attrs.keys() == {"Ts", "Q", "L"}  # defaults are not written
    assert law_of(plain).L is None and law_of(plain).loop is None
    assert law_of(trials) is None
    assert law_of(with_law(trials, Law(Q, L, rest=29))).rest == 29  # of 30
    operator = NormOptimal(loop.P, 1.0, 30)  # has no coefficients to write
    assert law_of(with_law(trials, Law(Q, operator))) is None


@pytest.mark.parametrize(
    "note",
    [{"L": "0"}, {"L": '{"coefficients": 3}'}, {"L": "[" * 9999}, {"Q": "{}"},
     {"rest": "soon"}, {"step": "NaN"}, {"actuators": '{"Q9": [0, 1]}'}],
)  # fmt: skip
def test_a_note_that_is_not_a_law_is_refused(loop, Q, trials, note):
    log = with_law(trials, Law(Q, L, loop=loop)).assign_attrs(note)
    with pytest.raises(LogError, match="law cannot be understood"):
        law_of(log)
    wide = Law(Q, LearningFilter(np.ones((3, 3, 4)), 1.0))  # of another plant
    with pytest.raises(LogError, match="channels"):
        law_of(with_law(trials, wide))


def test_a_file_that_is_not_a_law_is_refused(tmp_path, Q):
    path = tmp_path / "law.json"
    with pytest.raises(ValueError, match="L = None"):
        save_law(path, Law(Q, None))
    for other in (
        b"",
        b"[]",
        b"{}",
        b"Chapter 1",
        b'{"Ts": 1, "Ts": 2}',
        b"[" * 9999,
        b"\xff\xfe\x00" * 9999,
    ):
        path.write_bytes(other)
        with pytest.raises(ValueError, match=r"law.json' is not a law of save_law") as error:
            load_law(path)
        assert len(str(error.value)) <= 1000
    with pytest.raises(ValueError, match="is not a law of save_law"):
        load_law(tmp_path)


def test_only_a_law_is_replaced_by_a_law(tmp_path, Q):
    path = tmp_path / "thesis.txt"
    for content in (b"Chapter 1", b"\xff\xfe\x00", b"{}"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"thesis.txt' is a file of another kind"):
            save_law(path, Law(Q, L))
        assert path.read_bytes() == content
    path.unlink()
    for gain in (1.0, 0.5):
        save_law(path, Law(Q, L, gain=gain))
    assert load_law(path).gain == 0.5
