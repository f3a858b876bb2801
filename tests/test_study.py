"""What the benchmark `study` says of drawn rods, against loops of a model with many modes."""

import numpy as np
import study
from rods import modal_model

from ilctools import LearningFilter, convergence, frequency_response
from rodlib.paper import published


def test_shares_are_those_of_loops_around_a_model(monkeypatch):
    L = LearningFilter(published.matrix("L_full"), 1.0)
    monkeypatch.setattr(study, "laws", lambda: {"printed": (study.Q, L)})
    monkeypatch.setattr(study, "RODS", 12)
    loops = [study.LOOP.around(modal_model(rod, 1.0, 150)) for rod in study.rods("8 mm", 2, 12)]
    P = [frequency_response(loop[:, :2], study.CRITICAL) for loop in loops]
    result = convergence(np.array(P), study.Q, L, study.CRITICAL)
    ((converge, monotonically),) = study.shares("8 mm", 2)
    assert converge == np.mean(result.spectral_radius < 1)
    assert monotonically == np.mean(result.gamma < 1) and 0 < monotonically < 1
