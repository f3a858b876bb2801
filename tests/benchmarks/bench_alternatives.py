"""Time of the other designs: one filter, from the model to the first trial that it is applied to.

`make bench` runs these, too.
"""

from functools import cache

import numpy as np
import pytest
from bench_synthesis import measure

from rodlib import paper_loop, synthesise, zero_phase_butterworth
from rodlib.case import assumed_reference
from rodlib.ilc import NormOptimal
from rodlib.ilc.alternatives import (
    gradient,
    h_infinity,
    p_type,
    stable_inversion,
    zero_phase_inversion,
)

DESIGNS = {
    "P-type": lambda loop, Q: p_type(1.0, 89, 2, loop.Ts),
    "gradient": lambda loop, Q: gradient(loop.P, 1.0),
    "stable inversion": lambda loop, Q: stable_inversion(loop.P, 1.0, 0.1),
    "zero-phase inversion": lambda loop, Q: zero_phase_inversion(loop.P, 1.0, 0.1),
    "norm-optimal": lambda loop, Q: NormOptimal(loop.P, 1e-3, 2500),
    "H-infinity": lambda loop, Q: h_infinity(loop.P, Q, 0.5, 1e-3),
    "(39)": lambda loop, Q: (
        synthesise(loop, Q, np.geomspace(1e-4, np.pi, 1000), loop.Ts).filter
    ),
}


@cache
def task():
    return paper_loop(), zero_phase_butterworth(), assumed_reference()


def design_and_apply(name):
    loop, Q, error = task()
    DESIGNS[name](loop, Q).apply(error)


@pytest.mark.parametrize("name", DESIGNS)
def test_designs(benchmark, name):
    task()  # what all share is not counted
    measure(benchmark, "alternatives", name, design_and_apply, name)
