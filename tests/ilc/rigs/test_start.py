"""Trials that start elsewhere than the first, and how long is waited until they would not."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_experiment import PLANT, SHORT, Itself
from test_stopping import bump

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    record,
    zero_phase_butterworth,
)
from rodlib.ilc.rigs.start import Start
from rodlib.ilc.trials.run import rms
from rodlib.paper import published
from rodlib.paper.repository import ROOT
from rodlib.rigs import VirtualRig


@pytest.fixture(scope="module")
def L():
    return LearningFilter(published.matrix("L_diagonal"), 1.0)


def warm_end(samples):
    """A reference that ends at 4 K, from which a rod takes a while to cool."""
    return np.outer(np.minimum(1, np.arange(samples) / samples * 1.5) ** 2, [4.0, 3.0])


def test_trials_that_follow_at_once_start_elsewhere_and_it_is_said(loop, Q, L):
    with pytest.warns(
        UserWarning, match=r"after trial 2: it starts [\d.]+ K in y1, .* K in y2"
    ):
        log = record(VirtualRig(), loop, Law(Q, L), warm_end(600), trials=3, pause=0)
    assert np.abs(log.y[1, 0] - log.y[0, 0]).max() > 1


def test_the_rig_is_waited_for_as_long_as_it_takes(loop, Q, L):
    """And no longer; with the count of samples that one forgot to change, it starts warm."""
    device, reference = VirtualRig(), warm_end(600)
    with warnings.catch_warnings(action="error"):
        log = record(device, loop, Law(Q, L, rest=100), reference, trials=4)
    pauses = (device.time - 4 * 600) / 3
    assert 60 < pauses < 1200
    assert np.abs(log.y[1:, 0] - log.y[0, 0]).max() < 0.3
    with pytest.warns(UserWarning, match="starts"):
        warm = record(
            VirtualRig(), loop, Law(Q, L, rest=100), reference, trials=4, pause=10
        )
    assert rms(warm.e).values[-1] > 1.5 * rms(log.e).values[-1]


def test_a_rig_that_does_not_come_back_is_not_waited_for_forever():
    """A leak that the controller does not know holds it: two trials, then it is said."""
    loop, Q = (
        current_trial_loop(PLANT, PLANT.input_labels[:2]),
        zero_phase_butterworth(Ts=0.5),
    )

    class Leaking(Itself):
        def apply(self, commands):
            super().apply(commands)
            self.x += 0.5 * np.sin(len(self.applied) / 3)

    device = Leaking()
    with pytest.warns(
        UserWarning, match="before trial 2 .* not back and still after 80 samples"
    ):
        warnings.filterwarnings("ignore", "after trial 2: it starts")
        record(device, loop, Law(Q, None), bump(40, [1.0, 1.0]), trials=2)
    assert len(device.applied) == 2 * 40 + 80


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_noise_is_no_other_start(seed):
    rng = np.random.default_rng(seed)
    reference, noise = (
        bump(rng.integers(50, 400), [3.0, -1.0]),
        10.0 ** rng.uniform(-4, 1, 2),
    )
    y, other = reference + noise * rng.standard_normal((2, *reference.shape))
    start = Start.of(y, reference, ["a", "b"], ["K", "K"])
    assert start.missed(other) is None and start.back(
        np.resize(other[:1], y.shape), reference[0]
    )
    assert "in b from where" in start.missed(other + np.array([0, 0.1 + 30 * noise[1]]))
    assert not start.back(y[:3], reference[0])


WAITING = """
import sys
from rodlib import Law, paper_loop, record, zero_phase_butterworth
from rodlib.rigs import RestartingRig
import numpy as np

class Waiting(RestartingRig):
    def begin(self, trial):
        print("began", flush=True)
        sys.stdin.read()

law = Law(zero_phase_butterworth(), None)
record(Waiting(), paper_loop(), law, np.ones((9, 2)), path=sys.argv[1])
"""


def test_two_processes_do_not_record_to_one_log(loop, Q, L, tmp_path):
    """The second is refused, by the name of the log, before anything is applied."""
    path, device = tmp_path / "log.csv", VirtualRig()
    first = [sys.executable, "-c", WAITING, path]
    with subprocess.Popen(
        first, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as process:
        assert process.stdout.readline() == b"began\n"
        with pytest.raises(
            RuntimeError, match=r"path = '.*log\.csv' is recorded to by another"
        ):
            record(device, loop, Law(Q, L), **SHORT, path=path)
        process.kill()
    assert device.time == 0 and not path.exists()
    record(device, loop, Law(Q, L), **SHORT, path=path)
    assert path.exists()
