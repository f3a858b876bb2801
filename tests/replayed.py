"""Trials whose log names its law and its loop, to be replayed."""

import warnings

import numpy as np
from plants import bump

from ilctools import Law, LearningFilter, run_trials, zero_phase_butterworth
from ilctools.law.notes import with_law


def law_for(loop, rest=0, gain=1.0, learning=0.5):
    m = len(loop.outputs)
    L = LearningFilter(np.eye(m)[..., None] * [0, 0, 0, 0, 0, learning], loop.Ts)
    Q = zero_phase_butterworth(2, 0.06 / loop.Ts, loop.Ts)
    return Law(Q, L, rest, gain, loop=loop)


def trials_of(loop, law=None, trials=3, plant=None):
    """A smooth reference; disturbances that differ from trial to trial."""
    law, time = law or law_for(loop), np.arange(150)
    m, d = len(loop.outputs), len(loop.disturbances)
    r = bump(150, 1.0 + np.arange(m))
    waves = np.multiply.outer(1.0 + np.arange(trials), np.sin(0.05 * time)) + 1
    waves = np.repeat(waves[..., None], d, axis=2)
    with warnings.catch_warnings(action="ignore"):  # not all of them converge
        run = run_trials(loop, law, r, waves, trials, plant=plant)
    return with_law(run, law)
