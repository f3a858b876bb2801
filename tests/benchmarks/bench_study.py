"""Time of a study: as the number of rods grows, and of its trials against a loop over run_trials.

`make bench` runs these, too.
"""

from functools import cache

import control
import numpy as np
import pytest
import study
from bench_synthesis import measure

from rodlib import Law, draw, midr, run_trials

RODS = (100, 300, 1000)
SAMPLE = 20


@cache
def of_paper():
    return study.study(study.SPREADS["everything"])


def judged(rods):
    of_paper().run(rods)


def one_by_one(models):
    """Trials around models of the rods with as many states as the paper's."""
    of = of_paper()
    for model in models:
        plant = control.sample_system(model, 1.0, method="zoh")
        for L in of.filters.values():
            run_trials(of.loop, Law(of.Q, L), of.reference, trials=5, plant=plant)


@pytest.mark.parametrize("rods", RODS)
def test_growth_with_rods(benchmark, rods):
    measure(benchmark, "rods", rods, judged, rods, rounds=1)


@pytest.mark.parametrize("method", [one_by_one, judged])
def test_trials(benchmark, method):
    """Of each rod, five trials with each of two filters; times are for `SAMPLE` rods."""
    specimens = [draw(of_paper().spread, number) for number in range(SAMPLE)]
    models = []
    for specimen in specimens:
        gains = control.ss([], [], [], np.diag([*specimen.gains, 1]))
        model = midr(specimen.rod) * gains
        model.set_inputs(specimen.rod.inputs)
        model.set_outputs(specimen.rod.outputs)
        models.append(model)
    argument = models if method is one_by_one else SAMPLE
    benchmark.group = "trials"
    benchmark.extra_info.update(x=method.__name__, memory=0, rods=SAMPLE)
    benchmark.pedantic(method, (argument,), rounds=3)
