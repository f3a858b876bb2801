"""The predicted RMS of the error, against simulated trials."""

import numpy as np
import pytest
from plants import LOOPS, axes, bump

from ilctools import ClosedLoop, rms, run_trials, synthesise, zero_phase_butterworth
from rodlib import assumed_reference

OF_TRIAL = [1, 2, 3, 5, 10]
CUTOFFS = {"stage": 60.0, "furnace": 0.1, "axes": 10.0}


def learned(loop, design, reference):
    e = run_trials(loop, design.law(), reference, trials=10).e
    return rms(e).sel(trial=OF_TRIAL).values


@pytest.mark.parametrize("kind", CUTOFFS)
def test_trials_that_begin_and_end_at_rest_do_what_is_predicted(kind):
    """Where Q cuts, a part of the first error stays: it is predicted, too."""
    loop = LOOPS[kind]() if kind in LOOPS else ClosedLoop(axes())
    Q = zero_phase_butterworth(2, CUTOFFS[kind], loop.Ts)
    amplitude = 1.0 + np.arange(len(loop.outputs))
    reference = np.pad(bump(300, amplitude), [(300, 300), (0, 0)])
    # Below the first frequency P counts as constant, a millionth of the first error: from further
    # down, so that it does not show where trials leave no more.
    omega = np.geomspace(Q.cutoff / 1e4, np.pi / Q.Ts, 200)
    # what is equally large does not change what an RMS is
    choices = {"order": 15, "M_max": 0.95, "L_max": 1e3, "scale": 2.0 * amplitude}
    design = synthesise(loop, Q, omega, reference=reference, **choices)
    predicted = design.certificate.predicted
    trials = learned(loop, design, reference)
    np.testing.assert_allclose([predicted[k] for k in OF_TRIAL], trials, rtol=1e-3)
    assert f"{predicted[2]:.3g} in trial 2" in str(design)


def test_a_reference_beats_the_band_on_its_own_task(loop, Q, omega):
    """Of the paper's loop, whose ends the prediction leaves out."""
    reference = assumed_reference()
    kind = {"structure": "full", "order": 10}
    band = synthesise(loop, Q, omega[::4], band=(1e-4, 0.02), **kind)
    own = synthesise(loop, Q, omega[::4], reference=reference, **kind)
    e = learned(loop, own, reference)
    assert e[1] < 0.85 * learned(loop, band, reference)[1]
    predicted = [*own.certificate.predicted.values()]
    np.testing.assert_allclose(predicted[:2], e[:2], rtol=0.08)
    assert band.certificate.predicted is None
