"""Logs with accidents: each is read, or refused in a few printable words."""

import warnings

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    law_of,
    load_log,
    replay,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.law.notes import with_law

HOSTILE = [
    *["-1", "0", "1e999", "nan", "1e-99", "1e-7", "1" * 5000, "1_000", "٣", "null", "{}", "[]"],
    *['"', "\\", '"\\b"', '"\\ud800"', "\\u202e", "\x1b[2J", "\x85", "\u200b", "\x00", "\ufeff"],
    *["\n", "\r", ",", "#", ":", "# Ts: 1 s\n", "[" * 2000, '{"a": 1, "a": 2}', "$\\frac{$", ""],
]
ACCIDENTS = st.lists(
    st.tuples(
        st.booleans(),  # in the head
        st.floats(0, 1),  # where
        st.sampled_from([0, 1, 3, 30, 3000]),  # how much goes
        st.sampled_from(HOSTILE) | st.text(max_size=3) | st.none(),  # what comes; or it twice
    ),
    min_size=1,
    max_size=3,
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """With a law and a loop, without a reset, with limits."""
    path, texts = tmp_path_factory.mktemp("logs") / "log.csv", []
    model = control.ss(0.8, 0.2, 1, 0, 0.1, inputs=["w"], outputs=["x"])
    loop = ClosedLoop(model, units={"x": "mm"})
    Q, L = zero_phase_butterworth(2, 3.0, 0.1), LearningFilter([[[0.5]]], 0.1)
    for limits, reset in (({}, True), ({}, False), ({"w": (-0.5, 0.9)}, True)):
        law = Law(Q, L, limits=limits, loop=loop)
        with warnings.catch_warnings(action="ignore"):
            run = run_trials(loop, law, bump(90, [1.0]), trials=3, reset=reset)
        save_log(with_law(run, law), path)
        texts.append(path.read_text(encoding="utf-8"))
    return path, texts


@settings(max_examples=90)
@given(st.integers(0, 2), ACCIDENTS)
def test_a_log_with_accidents_is_read_or_refused_in_a_few_printable_words(logs, kind, accidents):
    path, texts = logs
    text = texts[kind]
    for in_head, where, length, new in accidents:
        start = int(where * (text.rfind("\n#") + 200 if in_head else len(text)))
        old = text[start : start + length]
        text = text[:start] + (2 * old if new is None else new) + text[start + length :]
    path.write_bytes(text.encode(errors="surrogatepass"))
    try:
        with warnings.catch_warnings(action="ignore"):
            log = load_log(path)
            assert all(np.isfinite(log[name]).all() for name in ("reference", "v", "y"))
            law_of(log)
            said = str(replay(log))
    except ValueError as error:  # a LogError is one
        said = str(error)
        assert len(said) < 5000
    assert said.replace("\n", "").isprintable()
