"""Experiments that go wrong while somebody watches: what is said of them, and what is kept."""

from types import SimpleNamespace

import control
import numpy as np
import pytest
from plants import furnace
from test_experiment import PLANT, SHORT, Itself

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    multisine,
    record,
    shake,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.rigs.limits import stop_limits
from rodlib.ilc.rigs.protocol import RigError, StoppedError
from rodlib.ilc.trials.run import rms
from rodlib.rigs import RestartingRig, VirtualRig

Q_SHORT = zero_phase_butterworth(Ts=0.5)


def bump(samples, amplitude):
    """From rest to an amplitude and back."""
    return np.outer(np.sin(np.pi * np.arange(samples) / samples) ** 2, amplitude)


class Model(Itself):
    """A plant as a rig that begins at rest, with noise, and as one's mistakes make it."""

    def __init__(self, plant, *, signs=1.0, limit=np.inf, noise=0.0):
        super().__init__(plant)
        self.inputs = plant.input_labels
        self.signs, self.limit, self.noise = signs, limit, noise
        self.random = np.random.default_rng(0)

    def begin(self, trial):
        self.x[:] = 0

    def read(self):
        return super().read() + self.noise * self.random.standard_normal(
            self.plant.noutputs
        )

    def apply(self, commands):
        super().apply(
            np.clip(self.signs * np.asarray(commands), -self.limit, self.limit)
        )


@pytest.fixture(scope="module")
def small():
    return current_trial_loop(PLANT, PLANT.input_labels[:2])


def test_an_actuator_of_the_wrong_sign_does_not_run_away(small):
    """Without limits it did, to 1e50, and not a word."""
    device, reference = Model(PLANT, signs=[-1.0, 1.0, 1.0]), bump(200, [5.0, 3.0])
    with pytest.raises(
        StoppedError, match=r"trial 1, sample \d+: depth = .* limits of stop"
    ) as at:
        record(device, small, Law(Q_SHORT, None), reference, trials=2)
    assert np.abs(device.applied).max() < 1e3 and device.ends == 1
    assert at.value.trials is None and "0 trial(s) are kept" in str(at.value)
    assert isinstance(at.value, RigError)


def test_what_was_learned_before_a_stop_is_kept(loop, Q, tmp_path):
    """With a path in the log, in any case with the error; and the same call goes on."""
    L, path = LearningFilter(np.eye(2)[..., None], 1.0), tmp_path / "log.csv"
    whole = record(RestartingRig(), loop, Law(Q, L), **SHORT)

    class Knocked(RestartingRig):
        def read(self):
            return super().read() + (
                100.0 if self.time == 7 and self.trial == 3 else 0.0
            )

        def begin(self, trial):
            self.trial = trial
            super().begin(trial)

    with pytest.raises(
        StoppedError, match=r"trial 3, sample 6: y1 = .*2 trial.s. are kept in"
    ) as at:
        record(Knocked(), loop, Law(Q, L), **SHORT, path=path)
    assert "stop" in str(at.value) and str(path) in str(at.value)
    assert load_log(path).identical(at.value.trials)
    assert at.value.trials.identical(whole.isel(trial=slice(2)))
    assert record(RestartingRig(), loop, Law(Q, L), **SHORT, path=path).identical(whole)
    told = {"stop": {"y1": (-200.0, 200.0), "y2": None, "Q1": (-60.0, 60.0)}}
    with pytest.raises(StoppedError, match="trial 3, sample 7: Q1 = "):
        record(Knocked(), loop, Law(Q, L), **SHORT, **told)


def test_limits_follow_from_the_reference_and_the_rig_unless_they_are_given(loop, Q):
    reference = np.array([[0.0, 1.0, 0.0], [2.0, -1.0, 0.0]])
    units = {"a": "K", "b": "K", "c": "m"}
    loop_of_three = SimpleNamespace(
        outputs=["a", "b", "c"], commands=["u", "x"], units=units
    )
    given = reference, loop_of_three, {"u": (0.0, 2.0)}
    assert stop_limits(None, *given) == {
        "a": (-10, 12),
        "b": (-11, 11),
        "u": (-99, 101),
    }
    own = stop_limits({"a": None, "c": (-1, 1), "u": (0, 1)}, *given)
    assert own == {"b": (-11, 11), "c": (-1, 1), "u": (0, 1)}
    for wrong, message in (
        ({"z": (0, 1)}, "stop is about"),
        ({"y1": (1, 0)}, "stop.*lower and a"),
    ):
        with pytest.raises(ValueError, match=message):
            record(VirtualRig(), loop, Law(Q, None), np.ones((9, 2)), stop=wrong)


def test_a_loop_that_is_shaken_is_stopped_too(small):
    excitation = multisine(small, 0.1, 3.0, 1.0, 0.2, 5)
    with pytest.raises(StoppedError, match=r"heat = .* is not from -6 to 6"):
        shake(Model(PLANT, signs=[1.0, -1.0, 1.0]), small, excitation)


def test_a_furnace_that_is_a_tenth_off_is_told_of_while_there_is_time():
    loop = current_trial_loop(furnace(30), None, {"valve": 0.1})
    Q, grid = zero_phase_butterworth(2, 0.4, 1.0), np.geomspace(1e-4, np.pi, 200)
    L = synthesise(loop, Q, grid, 1.0, order=40, band=(1e-4, 0.1)).filter
    delayed = np.append([1.0, -0.95], np.zeros(33))
    plant = control.ss(control.tf([0.22], delayed, 1.0))
    device = Model(control.ss(plant, inputs=["valve"], outputs=["outlet"]), noise=0.02)
    with pytest.warns(
        UserWarning, match="after trial [678]: the error grows.*Measure P"
    ) as told:
        log = record(device, loop, Law(Q, L), bump(600, [10.0]), trials=10)
    assert told[0].filename == __file__ and rms(log.e).values[-1] > 1
    assert len([one for one in told if "the error grows" in str(one.message)]) == 1
