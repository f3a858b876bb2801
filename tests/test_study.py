"""What the benchmark `study` says of drawn rods, against trials of a model with many modes."""

import numpy as np
import pytest
import study
from rods import modal_model

from ilctools import Law, LearningFilter, rms, run_trials
from rodlib import Spread, draw
from rodlib.paper import published

SPREAD = Spread.of_all(0.3)


@pytest.mark.parametrize("kind", study.FILTERS)
def test_trials_are_those_of_run_trials(kind):
    table = study.judged(SPREAD, [1]).set_index("filter")
    L = LearningFilter(published.matrix(f"L_{kind}"), 1.0)
    plant = modal_model(draw(SPREAD, 1), 1.0, 150)
    trials = run_trials(study.LOOP, Law(study.Q, L), study.R, trials=study.TRIALS, plant=plant)
    assert table.stable[kind]
    assert table.rms[kind] == pytest.approx(rms(trials.e).values[-1], rel=0, abs=1e-9)


def test_an_unstable_loop_has_no_rate(monkeypatch):
    monkeypatch.setattr(study, "unstable_poles", lambda loop, rods: np.arange(len(rods)))
    table = study.judged(SPREAD, range(2))
    assert table.stable.tolist() == [True, False] * 2
    for name in ("gamma", "spectral_radius", "rms"):
        assert (table[name].isna() == ~table.stable).all()
