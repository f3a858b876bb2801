"""Trials that start elsewhere than the first, and how long is waited until they would not."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import ModelRig, boiler, bump

from ilctools import Law, current_trial_loop, record, zero_phase_butterworth
from ilctools.trials.start import Start

LOOP = current_trial_loop(boiler(), boiler().input_labels[:2])
LAW = Law(zero_phase_butterworth(2, 0.1, 0.5), None)


def test_a_rig_is_waited_for_as_long_as_it_takes_and_no_longer():
    """Which the count of samples that one forgot to change is not."""
    trials = LOOP, LAW, np.linspace(0, [1.0, 1.0], 40) ** 2, None, 2  # it ends warm
    device = ModelRig(boiler())
    log = record(device, *trials)  # without a warning
    assert 5 < len(device.sent) - 2 * 40 < 80
    assert np.abs(log.y[1, 0] - log.y[0, 0]).max() < 0.03
    with pytest.warns(
        UserWarning, match=r"after trial 2: this trial starts [\d.]+ in depth, .* heat"
    ):
        warm = record(ModelRig(boiler()), *trials, pause=0)
    assert np.abs(warm.y[1, 0] - warm.y[0, 0]).max() > 0.3


def test_a_rig_that_does_not_come_back_is_not_waited_for_forever():
    """A leak that the controller does not know holds it: two trials, then it is said."""

    class Leaking(ModelRig):
        def apply(self, commands):
            super().apply(commands)
            self.x += 0.5 * np.sin(len(self.sent) / 3)

    device = Leaking(boiler())
    with pytest.warns(UserWarning, match="before trial 2 .* after 80 samples"):
        warnings.filterwarnings("ignore", "after trial 2: this trial starts")
        record(device, LOOP, LAW, bump(40, [1.0, 1.0]), trials=2)
    assert len(device.sent) == 2 * 40 + 80


@given(st.integers(0, 2**32 - 1))
def test_noise_is_no_other_start(seed):
    rng, units = np.random.default_rng(seed), {"a": "K", "b": "K"}
    loop = SimpleNamespace(outputs=[*units], units=units)
    reference = bump(rng.integers(50, 400), [3.0, -1.0])
    noise = 10.0 ** rng.uniform(-4, 1, 2)
    y, other = reference + noise * rng.standard_normal((2, *reference.shape))
    start = Start.of(y, reference, loop)
    assert start.missed(other) == ""
    assert start.near(other[0], reference[0])
    moved = other + np.array([0, 0.1 + 30 * noise[1]])
    assert " in b (K) away from where" in start.missed(moved)
    assert not start.near(moved[0], reference[0])
