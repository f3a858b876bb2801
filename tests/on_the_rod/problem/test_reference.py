"""The prediction for a reference, on the rod."""

import numpy as np

from ilctools import rms, run_trials, synthesise
from rodlib import assumed_reference


def test_a_reference_beats_the_band_on_its_own_task(loop, Q, omega):
    """Of the paper's loop, whose ends the prediction leaves out."""
    reference, kind = assumed_reference(), {"structure": "full", "order": 10}
    band = synthesise(loop, Q, omega[::4], band=(1e-4, 0.02), **kind)
    own = synthesise(loop, Q, omega[::4], reference=reference, **kind)
    by_band, e = (
        rms(run_trials(loop, design.law(), reference, trials=2).e).values for design in (band, own)
    )
    assert e[1] < 0.85 * by_band[1]
    predicted = [*own.certificate.predicted.values()]
    np.testing.assert_allclose(predicted[:2], e, rtol=0.08)
    assert band.certificate.predicted is None
