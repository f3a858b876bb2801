"""Time of a study: as the number of rods grows, and of its trials against a loop over run_trials.

`make bench` runs these, too.
"""

import tempfile
from functools import cache

import control
import numpy as np
import pytest
from bench_synthesis import measure

from rodlib import (
    Law,
    LearningFilter,
    Spread,
    Study,
    draw,
    midr,
    paper_loop,
    run_trials,
    zero_phase_butterworth,
)
from rodlib.paper import published
from rodlib.study import Course, run

RODS = (100, 1000, 10000)
SAMPLE = 20


@cache
def study():
    filters = {
        kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0)
        for kind in ("diagonal", "full")
    }
    return Study(paper_loop(), zero_phase_butterworth(), filters, Spread.of_all(0.2))


@cache
def course():
    of = study()
    return Course(of.loop, of.Q, [*of.filters.values()], of.reference, of.trials)


def run_afresh(rods):
    with tempfile.TemporaryDirectory() as folder:
        run(study(), rods, folder=folder)


def one_by_one(models):
    """Trials around models of the rods with as many states as the paper's."""
    for model in models:
        plant = control.sample_system(model, 1.0, method="zoh")
        for L in study().filters.values():
            run_trials(
                study().loop,
                Law(study().Q, L),
                study().reference,
                trials=5,
                plant=plant,
            )


def side_by_side(rods):
    for start in range(0, len(rods), 4):
        course().rms([rod.held(1.0) for rod in rods[start : start + 4]])


@pytest.mark.parametrize("rods", RODS)
def test_growth_with_rods(benchmark, rods):
    measure(benchmark, "rods", rods, run_afresh, rods, rounds=1)


@pytest.mark.parametrize("method", [one_by_one, side_by_side])
def test_trials(benchmark, method):
    """Of each rod, five trials with each of two filters; times are for `SAMPLE` rods."""
    drawn = [draw(study().spread, number) for number in range(SAMPLE)]
    side_by_side(drawn[:4])  # what all rods share is not counted
    models = [
        midr(each.rod) * control.ss([], [], [], np.diag([*each.gains, 1]))
        for each in drawn
    ]
    for model in models:
        model.set_inputs(drawn[0].rod.inputs)
        model.set_outputs(drawn[0].rod.outputs)
    argument = models if method is one_by_one else drawn
    benchmark.group = "trials"
    benchmark.extra_info.update(x=method.__name__, memory=0, rods=SAMPLE)
    benchmark.pedantic(method, (argument,), rounds=5)
