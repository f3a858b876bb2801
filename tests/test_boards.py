import sys

import control
import numpy as np
import pytest

from rodlib import (
    Law,
    boards,
    current_trial_loop,
    load_log,
    measured_response,
    multisine,
    record,
    run_trials,
    shake,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.boards import TemperatureControlLab, heat_balance
from rodlib.ilc import law_of
from rodlib.ilc.loop.notes import loop_of
from rodlib.ilc.rigs.protocol import RigError

tclab = pytest.importorskip("tclab")

UNITS = {"T1": "K", "T2": "K", "Q1": "%", "Q2": "%"}
SIZES = {"T1": 10.0, "T2": 8.0, "Q1": 30.0, "Q2": 40.0}
TRUE = [
    200 / 5720,
    100 / 5720,
    1 / 20,
    1 / 100,
    140.0,
]  # of the emulator: TCLabModel.update
Q = zero_phase_butterworth(Ts=2.0)


@pytest.fixture(scope="module")
def loop():
    return current_trial_loop(heat_balance(*TRUE, 2.0), sizes=SIZES, units=UNITS)


@pytest.fixture(scope="module")
def L(loop):
    omega = np.geomspace(1e-3, np.pi / 2, 200)
    return synthesise(loop, Q, omega, 2.0, L_max=5.0, band=(1e-3, 0.03)).filter


REFERENCE = np.outer(np.sin(np.pi * np.linspace(0, 1, 250)) ** 2, [10.0, 8.0])


def undisturbed(monkeypatch):
    """The emulator with thermometers that show what is there."""
    monkeypatch.setattr(tclab.TCLabModel, "measurement", lambda self, T: T)


def test_the_emulator_is_a_heat_balance(monkeypatch):
    """Solved by Euler's method: half the step, half the difference."""
    undisturbed(monkeypatch)
    u = np.repeat([[20.0, 0.0], [0.0, 0.0], [-10.0, 40.0]], 100, axis=0)
    model = control.forced_response(heat_balance(*TRUE, 2.0), inputs=u.T).outputs.T
    differences = []
    for step in (0.2, 0.1):
        rig = TemperatureControlLab(wait=3000.0)
        rig.lab.maxstep = step
        rig.begin(1)
        read = []
        for heaters in u:
            read.append(rig.read())
            rig.apply(heaters)
        differences.append(np.abs(np.asarray(read) - np.asarray(model)).max())
    assert differences[0] < 0.005 * np.ptp(model)
    assert differences[1] == pytest.approx(differences[0] / 2, rel=0.05)


def test_what_the_heaters_give_the_air_takes():
    model = heat_balance(0.03, 0.02, 0.05, 0.01, 100.0, 2.0)
    for u in ([10.0, 0.0], [3.0, 7.0]):
        at_rest = model.dcgain() @ u
        assert 0.05 * at_rest.sum() == pytest.approx(np.dot([0.03, 0.02], u), rel=1e-9)
    assert model.input_labels == ["Q1", "Q2"] and model.output_labels == ["T1", "T2"]
    lag = heat_balance(1.0, 1.0, 10.0, 0.0, 100.0, 2.0)  # its heaters are fast
    assert lag.poles().real.max() == pytest.approx(np.exp(-2 / 100))


def test_every_trial_begins_at_rest(monkeypatch):
    undisturbed(monkeypatch)
    rig = TemperatureControlLab(wait=3000.0)
    with pytest.raises(RuntimeError, match="call begin first"):
        rig.read()
    for trial in (1, 2):
        rig.begin(trial)
        zero = rig.zero
        assert np.abs(rig.read()).max() < 1e-6
        for _ in range(100):
            rig.apply([20, 20])
        assert rig.read().min() > 5
    assert rig.zero is zero and np.all(zero > [35, 30])


def test_the_last_minute_of_the_wait_counts(monkeypatch):
    shown = []
    monkeypatch.setattr(
        tclab.TCLabModel, "measurement", lambda self, T: shown.append(T) or T
    )
    rig = TemperatureControlLab(wait=200.0)  # so short that the temperatures still rise
    rig.begin(1)
    read = np.reshape(shown, (100, 2))
    np.testing.assert_allclose(rig.zero, read[-30:].mean(axis=0), rtol=1e-12)
    assert np.all(read[-30:] - read[-31] > 0)


def test_heaters_are_cut_off_where_they_end():
    rig = TemperatureControlLab(rest=(30, 40))
    assert rig.limits == {"Q1": (-30, 70), "Q2": (-40, 60)}
    for asked, applied in [([10, -10], (40, 30)), ([-31, 61], (0, 100))]:
        rig.apply(asked)
        assert (rig.lab.Q1(), rig.lab.Q2()) == applied
    rig.safe()
    assert (rig.lab.Q1(), rig.lab.Q2()) == (0, 0)
    with pytest.raises(ValueError, match="heaters"):
        rig.apply([1, 2, 3])


def test_an_experiment_depends_on_the_seed_alone(loop, L):
    one, same, other = (
        record(
            TemperatureControlLab(seed=seed),
            loop,
            Law(Q, L),
            REFERENCE,
            trials=2,
            pause=0,
        )
        for seed in (1, 1, 2)
    )
    assert one.identical(same) and not np.array_equal(one.y, other.y)


def test_trials_of_the_emulator_are_those_of_the_simulation(loop, L, monkeypatch):
    undisturbed(monkeypatch)
    rig = TemperatureControlLab(wait=3000.0)
    rig.lab.maxstep = 0.05
    recorded = record(rig, loop, Law(Q, L), REFERENCE, trials=4, pause=0)
    simulated = run_trials(loop, Law(Q, L), REFERENCE, trials=4)
    assert np.abs(recorded.y - simulated.y).max() < 1e-3
    assert np.abs(simulated.e[0]).max() > 1 > 10 * np.abs(recorded.e[3]).max()
    assert (rig.lab.Q1(), rig.lab.Q2()) == (0, 0)


ROUGH = [
    0.03,
    0.02,
    0.05,
    0.0,
    100.0,
]  # what a loop is designed on that is then measured


def measure(rest=(50.0, 50.0)):
    """The loop shaken around a state of rest; its measured response and the true one."""
    loop = current_trial_loop(heat_balance(*ROUGH, 2.0), sizes=SIZES, units=UNITS)
    excitation = multisine(loop, 8e-3, 0.3, [2.5, 1.5], 1.5, lines=16)
    rig = TemperatureControlLab(rest=rest, wait=3000.0)
    rig.lab.maxstep = 0.1
    measured = measured_response(shake(rig, loop, excitation))
    return measured, loop.frequency_response(measured.omega, heat_balance(*TRUE, 2.0))


def test_without_noise_the_measured_response_is_that_of_the_heat_balance(monkeypatch):
    """Around another state of rest; Euler's method makes the difference."""
    undisturbed(monkeypatch)
    measured, truth = measure(rest=(40.0, 60.0))
    assert not measured.findings
    assert np.linalg.norm(measured.response - truth, 2, axis=(1, 2)).max() < 5e-3
    model = measured.loop.frequency_response(measured.omega)
    assert np.linalg.norm(model - truth, 2, axis=(1, 2)).max() > 0.5


def test_with_noise_the_region_covers_it(monkeypatch):
    monkeypatch.setattr(tclab.TCLabModel, "quantize", lambda self, T: T)
    measured, truth = measure()
    assert not measured.findings
    radius = measured.radius(0.999, jointly=True)
    assert np.all(
        np.linalg.norm(measured.response - truth, 2, axis=(1, 2)) < radius + 5e-3
    )
    assert radius.max() < 0.1


def test_the_converter_shows_and_is_within_what_the_finding_says():
    with pytest.warns(UserWarning, match="the loop is not linear") as told:
        measured, truth = measure()
    said = float(str(told[0].message).split("off by about ")[1].split(",")[0])
    off = np.linalg.norm(measured.response - truth, 2, axis=(1, 2))
    assert np.all(off < measured.radius(0.99, jointly=True) + said)


@pytest.fixture(scope="module")
def log(loop, L, tmp_path_factory):
    """A short log of the emulator, as notebook 11 records it."""
    path = tmp_path_factory.mktemp("log") / "lab.csv"
    record(
        TemperatureControlLab(),
        loop,
        Law(Q, L),
        REFERENCE,
        trials=3,
        pause=0,
        path=path,
    )
    return path


def test_a_log_of_the_lab_has_what_a_replay_needs(loop, L, log):
    found = load_log(log)
    assert found.control_unit.values.tolist() == ["%", "%"]
    law = law_of(found)
    assert law.Q == Q and np.array_equal(law.L.coefficients, L.coefficients)
    for k in range(2):
        following = Law(law.Q, law.L).next(found.v.values[k], found.e.values[k])
        np.testing.assert_allclose(found.v.values[k + 1], following, rtol=0, atol=1e-12)
    noted = loop_of(found)
    model = control.forced_response(noted.plant, inputs=found.u.values[-1].T).outputs.T
    assert (
        np.abs(found.y.values[-1] - model).max() < 0.6
    )  # resolution 0.32 K, noise 0.04 K
    assert np.array_equal(noted.KL, loop.KL)


def test_a_broken_thermometer_turns_the_heaters_off(loop, L, monkeypatch):
    rig = TemperatureControlLab()
    rig.begin(1)
    monkeypatch.setattr(type(rig.lab), "T2", property(lambda self: float("nan")))
    with pytest.raises(RigError, match="trial 1, sample 1: reading has 1 values"):
        record(rig, loop, Law(Q, L), REFERENCE, trials=1)
    assert (rig.lab.Q1(), rig.lab.Q2()) == (0, 0)


class Kit:
    """Stands in for tclab.TCLab."""

    T1 = T2 = 21.0

    def __init__(self):
        self.heaters = {}

    def Q1(self, value):
        self.heaters["Q1"] = value

    def Q2(self, value):
        self.heaters["Q2"] = value


class Clock:
    """Stands in for the module time: it stands still but for sleep."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def test_the_kit_is_waited_for_and_a_delay_is_caught_up(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(tclab, "TCLab", Kit)
    monkeypatch.setattr(boards, "time", clock)
    rig = TemperatureControlLab(kit=True)
    clock.now += 100  # of no concern before it begins
    rig.begin(1)
    assert rig.clock() == 2000 and rig.lab.heaters == {"Q1": 30, "Q2": 40}
    assert rig.read().tolist() == [0, 0]
    clock.now += 0.5
    rig.apply([1.0, 2.0])
    assert clock.now == 2002 and rig.lab.heaters == {"Q1": 31, "Q2": 42}
    clock.now += 2.5
    rig.apply([0, 0])
    assert clock.now == 2004.5
    rig.apply([0, 0])
    assert clock.now == 2006
    rig.safe()
    assert rig.lab.heaters == {"Q1": 0, "Q2": 0}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("kit", "yes"),
        ("rest", (30, 101)),
        ("rest", (-1, 40)),
        ("Ts", 61.0),
        ("wait", 59.0),
        ("seed", -1),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_connected(
    name, value, monkeypatch
):
    monkeypatch.setitem(sys.modules, "tclab", None)
    with pytest.raises(ValueError, match=name):
        TemperatureControlLab(**{name: value})
    with pytest.raises(ImportError, match=r"rodlib\[tclab\]"):
        TemperatureControlLab()
