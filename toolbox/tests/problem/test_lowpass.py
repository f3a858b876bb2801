"""Q by its samples, against the Butterworth filter that they are of, and what is no Q."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from ilctools import zero_phase_butterworth
from ilctools.problem.lowpass import lowpass_of

OMEGA = np.geomspace(1e-3, 2.0, 200)
BUTTERWORTH = zero_phase_butterworth(2, 0.3, 1.0)
SAMPLES = BUTTERWORTH.frequency_response(OMEGA)


def test_samples_are_splined_between_and_beyond_their_ends_as_there():
    sampled = lowpass_of(SAMPLES, OMEGA)
    between = np.geomspace(1e-3, 2.0, 777)
    exact = BUTTERWORTH.frequency_response(between)
    assert_allclose(sampled.frequency_response(between), exact, rtol=0, atol=1e-6)
    beyond = sampled.frequency_response(np.array([0.0, 3.0]))
    assert_allclose(beyond, SAMPLES[[0, -1]], rtol=1e-12)
    assert sampled.cutoff == pytest.approx(0.3, rel=1e-3)
    assert lowpass_of(BUTTERWORTH, OMEGA) is BUTTERWORTH


@pytest.mark.parametrize(
    ("Q", "message"),
    [
        (1.3 * SAMPLES, "Q has a gain of 1.3 at 0.00"),
        (SAMPLES * np.exp(0.1j), "Q shifts the phase by up to 0.1 rad"),
    ],
)
def test_what_is_no_low_pass_filter_is_refused(Q, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        lowpass_of(Q, OMEGA)
