"""How long is waited until a trial of the rod would not start elsewhere than the first."""

import numpy as np
import pytest
from rods import PRINTED

from ilctools import Law, record
from ilctools.trials.rms import rms
from rodlib.rigs import VirtualRig


def test_the_rig_is_waited_for_as_long_as_it_takes(loop, Q):
    """And no longer; with the count of samples that one forgot to change, it starts warm."""
    law = Law(Q, PRINTED, rest=100)
    ramp = np.minimum(1, np.arange(600) / 600 * 1.5) ** 2  # it ends warm
    device, trials = VirtualRig(), (loop, law, np.outer(ramp, [4.0, 3.0]), None, 3)
    log = record(device, *trials)  # without a warning
    assert 60 < (device.time - 3 * 600) / 2 < 1200
    assert np.abs(log.y[1:, 0] - log.y[0, 0]).max() < 0.3
    message = r"after trial 2: it starts [\d.]+ in y1 \(K\), .* in y2 \(K\)"
    with pytest.warns(UserWarning, match=message):
        warm = record(VirtualRig(), *trials, pause=0)
    assert np.abs(warm.y[1, 0] - warm.y[0, 0]).max() > 1
    assert rms(warm.e).values[-1] > 1.5 * rms(log.e).values[-1]
