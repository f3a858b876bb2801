"""The default of b = 1 / (2 L_max), against the best of many for each plant, by trials of it."""

import control
import numpy as np
import pytest
from plants import bump

from ilctools import (
    ClosedLoop,
    InfeasibleError,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)

S = control.tf("s")
NOISE = 1e-3  # of the reference, as in figures/performance.md
WITHIN = 1.2  # times the best, the criterion there; with the gain at rest in the rule 4.3

FAST = np.repeat([0, 1, -0.5, 0], [30, 105, 105, 60])[:, None]  # as fast as a move can be
CASES = {  # plant, sampling period, cut-off in units of Nyquist's frequency, reference
    "time constants 1 : 1e4": (0.01 / (S + 1) + 0.99 / (1e4 * S + 1), 0.1, 0.064, bump(2000, [1])),
    "nearly up to Nyquist's frequency": (1 / (30 * S + 1), 1.0, 0.9, FAST),
}


def second_trial(P, design, reference):
    """RMS of its error, without the noise that the law is fed."""
    noise = NOISE * np.random.default_rng(7).standard_normal((2, len(reference), 1))
    e = run_trials(ClosedLoop(P), design.law(), reference, trials=2, noise=noise).e
    return float(rms(e + noise)[1])


@pytest.mark.parametrize("name", CASES)
def test_trial_2_is_nearly_that_of_the_best_b(name):
    plant, Ts, share, reference = CASES[name]
    P = control.sample_system(control.ss(plant), Ts)
    Q = zero_phase_butterworth(2, share * np.pi / Ts, Ts)
    design = synthesise(P, Q)
    ours, others = second_trial(P, design, reference), []
    for factor in 10.0 ** np.arange(-2, 2.1, 0.5):
        try:
            other = synthesise(P, Q, L_max=factor * design.problem.L_max)
        except InfeasibleError:  # b so large that next to nothing is learned
            continue
        others.append(second_trial(P, other, reference))
    assert ours < WITHIN * min(others)


def test_what_b_leaves_keeps_M_max_however_far_beyond_the_plant_the_cutoff_is():
    """A resonance at a thirtieth of the cut-off: 20 times the gain at rest leaves 0.97 there."""
    P = control.sample_system(control.ss(1 / (S**2 + S + 1)), 0.01)
    for M_max in (0.9, 0.5):
        design = synthesise(P, zero_phase_butterworth(2, 30.0, 0.01), M_max=M_max)
        assert design.certificate.failures == []
        # without a search: L = B leaves two thirds of that at most, where it is known
        assert design.problem.order == 1 and design.sigma_M.max() <= M_max / 1.5 * (1 + 1e-6)
