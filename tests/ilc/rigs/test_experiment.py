import os
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

from rodlib import (
    Law,
    LearningFilter,
    NormOptimal,
    Rod,
    current_trial_loop,
    load_log,
    paper_loop,
    record,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.ilc import Controller, law_of
from rodlib.ilc.loop.notes import loop_of
from rodlib.ilc.rigs.protocol import RigError
from rodlib.ilc.trials.run import rms
from rodlib.paper import published
from rodlib.paper.repository import ROOT
from rodlib.paper.rig_logs import PARAMETERS, experiment
from rodlib.peltier_rig import PeltierRig
from rodlib.rigs import RestartingRig, RigParameters, VirtualRig

IDEAL = RigParameters(noise=0, quantum=0, lag=0, limit=np.inf, ambient_rate=0)
PLANT = control.ss(
    [[0.9, 0.05], [0.0, 0.8]], [[0.1, 0.0, 0.02], [0.0, 0.3, 0.0]], np.eye(2), 0, 0.5,
    inputs=["pump, left", "heater", "rain"], outputs=["depth", "heat"],
)  # fmt: skip

PLANT_UNITS = {"pump, left": "l/min", "heater": "W", "depth": "mm", "heat": "degC"}


@pytest.fixture(scope="module")
def L():
    return LearningFilter(published.matrix("L_diagonal"), 1.0)


class Itself:
    """The plant itself as a rig, with inputs in an order of its own and a spare one."""

    inputs = ("spare", "heater", "rain", "pump, left")

    def __init__(self, plant=PLANT):
        self.plant, self.x = plant, np.zeros(plant.nstates)
        self.applied, self.ends = [], 0

    def read(self):
        return self.plant.C @ self.x

    def apply(self, commands):
        self.applied.append(np.array(commands))
        named = dict(zip(self.inputs, commands, strict=True))
        u = np.array([named[name] for name in self.plant.input_labels])
        self.x = self.plant.A @ self.x + self.plant.B @ u

    def safe(self):
        self.ends += 1


class Failing(VirtualRig):
    """Goes wrong in one sample, counted from 0."""

    def __init__(self, sample, how):
        super().__init__()
        self.sample, self.how, self.commands = sample, how, []

    def read(self):
        self.sample -= 1
        return self.how() if self.sample == -1 else super().read()

    def apply(self, heat_flows):
        self.commands.append(np.array(heat_flows))
        super().apply(heat_flows)


def raising(error):
    raise error


def test_controller_on_the_design_model_gives_the_simulated_trial(loop, Q):
    """Sample by sample as on hardware, and all at once: the same trial."""
    reference = assumed_reference(300) * 5
    run = run_trials(loop, Law(Q, None), reference, None, 1)
    for decimals, atol in ((None, 1e-10), (4, 2e-4)):
        x, controller = np.zeros(10), Controller(loop, decimals)
        outputs = []
        for w in reference:
            outputs.append(loop.plant.C @ x)
            x = loop.plant.A @ x + loop.plant.B[:, :2] @ controller.step(outputs[-1], w)
        np.testing.assert_allclose(outputs, run.y[0], atol=atol)


def test_ideal_rig_with_nominal_rod_agrees_with_the_simulation(loop, Q, L):
    reference, disturbance = assumed_reference(1200), assumed_disturbance(1200, 3, 2)
    log = record(VirtualRig(Rod(), IDEAL), loop, Law(Q, L), reference, disturbance, 3)
    run = run_trials(loop, Law(Q, L), reference, disturbance, 3)
    np.testing.assert_allclose(log.y, run.y, atol=0.02 * np.abs(reference).max())
    np.testing.assert_allclose(rms(log.e), rms(run.e), rtol=0.1)


def test_any_plant_is_run_by_the_names_of_its_signals():
    """A rig that is the loop's plant gives what the simulation gives."""
    loop = current_trial_loop(PLANT, PLANT.input_labels[:2], units=PLANT_UNITS)
    Q = zero_phase_butterworth(Ts=0.5)
    L = LearningFilter(0.3 * np.ones((2, 2, 4)), 0.5)
    rng = np.random.default_rng(0)
    reference, rain = rng.standard_normal((40, 2)), rng.standard_normal((3, 40, 1))
    device = Itself()
    device.begin = lambda trial: device.x.fill(0)
    log = record(device, loop, Law(Q, L), reference, rain, 3, pause=0)
    assert log.attrs["Ts"] == 0.5 and device.ends == 1
    run = run_trials(loop, Law(Q, L), reference, rain, 3)
    for name in run.data_vars:
        np.testing.assert_allclose(log[name], run[name], atol=1e-9)
    for name in (
        "output",
        "control",
        "source",
        "output_unit",
        "control_unit",
        "source_unit",
    ):
        assert list(log[name].values) == list(run[name].values)
    assert not np.any(np.array(device.applied)[:, 0])


def test_only_known_disturbances_are_recorded(loop, Q):
    device = VirtualRig()
    log = record(device, loop, Law(Q, None), np.zeros((5, 2)), None, 1)
    assert list(log.source.values) == ["theta_a", "Q2", "Q4"]
    driver = SimpleNamespace(read=device.read, inputs=["Q3", "Q1"])
    driver.apply = lambda flows: device.apply([flows[1], 0, flows[0], 0])
    log = record(driver, loop, Law(Q, None), np.zeros((5, 2)), None, 1)
    assert "disturbance" not in log and "source" not in log.coords
    driver.measured = {"theta_a": 0.5, "lights": 1.0}
    log = record(
        driver, loop, Law(Q, None), np.zeros((5, 2)), np.ones((5, 3)) * [1, 0, 0], 1
    )
    assert list(log.source.values) == ["theta_a"] and np.all(log.disturbance == 0.5)


def test_another_learning_operator_learns_on_the_rig_but_no_log_could_name_it(
    loop, Q, tmp_path
):
    reference, L = assumed_reference(1200), NormOptimal(loop.P, 0.01, 1200)
    run = record(
        VirtualRig(Rod(), IDEAL), loop, Law(Q, L), reference, trials=2, pause=300
    )
    assert rms(run.e)[1] < 0.1 * rms(run.e)[0]
    assert "L" not in run.attrs
    with pytest.raises(ValueError, match=r"L = .* must be a LearningFilter"):
        record(
            VirtualRig(Rod(), IDEAL),
            loop,
            Law(Q, L),
            reference,
            path=tmp_path / "log.csv",
        )


def test_v_rests_on_the_rig_too_and_the_log_says_so(loop, Q, L):
    reference = assumed_reference(60) * 0.02
    law = Law(Q, L, rest=15, gain=0.3)
    log = record(VirtualRig(), loop, law, reference, None, 3, pause=5)
    assert not log.v.values[:, -15:].any() and log.v.values[1:, -16].any()
    assert (law_of(log).rest, law_of(log).gain) == (15, 0.3)
    assert loop_of(log).Ts == 1.0
    for k in range(2):
        following = law.next(log.v.values[k], log.e.values[k])
        np.testing.assert_array_equal(log.v[k + 1], following)


def test_the_controller_runs_on_for_ten_minutes_between_two_trials(loop, Q):
    device = VirtualRig()
    record(device, loop, Law(Q, None), np.zeros((7, 2)), None, 3, pause=600)
    assert device.time == 3 * 7 + 2 * 600 + 1  # the last one with all at zero


@pytest.mark.parametrize(
    ("name", "seed", "trials"), [("learning", 1, 2), ("no-learning", 2, 1)]
)
def test_the_first_trials_of_a_tracked_log_are_recorded_again_alike(name, seed, trials):
    tracked = load_log(ROOT / "data" / "rig" / f"{name}.csv").isel(trial=slice(trials))
    L = (
        LearningFilter(published.matrix("L_diagonal"), 1.0)
        if name == "learning"
        else None
    )
    rig = PeltierRig(parameters=PARAMETERS, seed=seed)
    law = Law(zero_phase_butterworth(), L, limits={})
    log = record(rig, law=law, **experiment() | {"trials": trials})
    for role in tracked.data_vars:
        np.testing.assert_array_equal(log[role], tracked[role])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rig": VirtualRig(Ts=2.0)}, "rig.Ts = 2.0"),
        ({"law": Law(zero_phase_butterworth(Ts=2.0), None)}, "Ts"),
        ({"rig": "the red one"}, "rig = 'the red one'"),
        ({"rig": VirtualRig}, "rig = .* is a class: make one"),
        ({"trials": 3}, "disturbance has 2 trials, but trials = 3"),
        (
            {"disturbance": np.zeros((2, 9, 3))},
            r"disturbance has shape \(2, 9, 3\).*10, 3",
        ),
        ({"pause": -1}, "pause = -1"),
        ({"law": Law(zero_phase_butterworth(), None, 10)}, "rest = 10"),
        ({"decimals": {"y": 3}}, r"decimals is about \['y'\]"),
        ({"decimals": {"u": 0.5}}, "decimals.*u.* = 0.5 must be a whole number"),
        (
            {"loop": current_trial_loop(control.ss(0.5, 1, 1, 0, 1.0))},
            r"must name .*'u\[0\]'",
        ),
        ({"path": 3}, "path = 3 must be the path of a file"),
        ({"path": "nowhere/log.csv"}, "path = .*nowhere.log.csv.* must be in a folder"),
    ],
)
def test_an_experiment_that_cannot_work_is_not_begun(loop, Q, changes, message):
    made = {"rig": VirtualRig(), "loop": loop, "law": Law(Q, None)}
    made |= {
        "reference": np.zeros((10, 2)),
        "disturbance": np.zeros((2, 10, 3)),
        "trials": 2,
    }
    with pytest.raises(ValueError, match=message):
        record(**made | changes)
    assert made["rig"].time == 0


def test_disturbances_that_the_rig_cannot_make_are_refused(loop, Q):
    driver = SimpleNamespace(read=lambda: [0, 0], apply=lambda flows: None)
    with pytest.raises(
        ValueError, match=r"disturbance is not zero for \['Q4'\], which are no"
    ):
        record(
            driver, loop, Law(Q, None), np.zeros((5, 2)), np.ones((5, 3)) * [0, 0, 1], 1
        )


@pytest.mark.parametrize(
    "bad", [[np.nan, 0.0], [0.0, np.inf], [0.0], [[0, 0]], None, ["1", "2"]]
)
def test_what_is_no_reading_never_reaches_the_actuators(loop, Q, L, tmp_path, bad):
    """The trial ends, the rig is made safe, the trials before it stay."""
    device = Failing(20 + 3 + 12, lambda: bad)
    made = (loop, Law(Q, L), assumed_reference(20), None, 3)
    with pytest.raises(
        RigError, match=r"trial 2, sample 13: reading .*Nothing was applied after"
    ):
        record(device, *made, pause=3, path=tmp_path / "log.csv")
    assert len(device.commands) == 20 + 3 + 12 + 1
    assert np.isfinite(device.commands).all() and not device.commands[-1].any()
    assert load_log(tmp_path / "log.csv").sizes["trial"] == 1
    with pytest.raises(RigError, match="pause before trial 2, sample 3"):
        record(Failing(20 + 2, lambda: bad), *made, pause=3)


def test_a_thermometer_in_the_room_that_fails_ends_the_trial(loop, Q):
    class Unplugged(VirtualRig):
        ambient = np.nan

    with pytest.raises(RigError, match="trial 1, sample 1: theta_a has 1 values"):
        record(Unplugged(), loop, Law(Q, None), np.zeros((5, 2)), None, 1)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, OSError("unplugged")])
def test_the_rig_is_made_safe_on_every_way_out(loop, Q, error):
    device = Failing(7, lambda: raising(error))
    with pytest.raises(error if isinstance(error, type) else type(error)) as caught:
        record(device, loop, Law(Q, None), np.ones((20, 2)), None, 2)
    assert len(device.commands) == 8 and not device.commands[-1].any()
    if isinstance(error, OSError):
        assert caught.value.__notes__ == ["in trial 1, sample 8"]
    device = Failing(99, lambda: None)
    record(device, loop, Law(Q, None), np.ones((20, 2)), None, 1)
    assert len(device.commands) == 21 and not device.commands[-1].any()


def test_samples_that_are_not_on_time_are_reported(loop, Q):
    class Late(VirtualRig):
        def clock(self):
            return self.time + (1.5 if 7 <= self.time < 9 else 0.05)

    with pytest.warns(
        UserWarning, match="trial 1: 2 samples were not on time, .* 8, by 1.45 s"
    ):
        record(Late(), loop, Law(Q, None), np.zeros((20, 2)), None, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record(VirtualRig(), loop, Law(Q, None), np.zeros((20, 2)), None, 2, pause=3)


def test_commands_that_the_rig_cuts_off_are_reported(loop, Q):
    """By the names of its inputs, which may be others and in another order than the controls."""

    def driver(**more):
        read = (
            np.random.default_rng(0).standard_normal(10**4).reshape(-1, 2).tolist().pop
        )
        return SimpleNamespace(read=read, apply=len, inputs=["Q3", "fan", "Q1"], **more)

    reference = np.zeros((20, 2))
    reference[5:10, 0] = 10.0  # 47 and 16 W by N alone
    with pytest.warns(UserWarning) as told:
        device = driver(limits={"Q1": (-60, 40), "fan": (0, 1)})
        law = Law(Q, None, limits={})
        log = record(device, loop, law, reference, trials=2, pause=0)
    share = np.mean(log.u.values[..., 0] > 40, axis=1)
    assert share.min() > 0
    assert [str(one.message).split(" of all")[0] for one in told] == [
        f"trial {k}: commands were beyond the limits of Q1 in {part:.1%}"
        for k, part in zip((1, 2), share, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record(driver(), loop, Law(Q, None), reference, trials=1)
        record(
            driver(limits={"Q1": (-60, 1e3)}), loop, Law(Q, None), reference, trials=1
        )
    with pytest.raises(ValueError, match=r"rig\.limits is about .*'Q2'"):
        record(driver(limits={"Q2": (0, 1)}), loop, Law(Q, None), reference)


def test_progress_is_shown_on_a_terminal_only(loop, Q, capfd, monkeypatch):
    record(VirtualRig(), loop, Law(Q, None), np.ones((20, 2)), None, 2, pause=3)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    record(VirtualRig(), loop, Law(Q, None), np.ones((20, 2)), None, 2, pause=3)
    shown = capfd.readouterr().err
    assert "trial 2 of 2" in shown and "43/43" in shown and "RMS 1.4" in shown


# Resuming

SHORT = {
    "reference": np.round(assumed_reference(25) * 0.02, 6),
    "trials": 3,
    "pause": 2,
}
KILLED = """
import os, signal, sys
import pyarrow.csv, scipy.signal
from rodlib import Law, LearningFilter, paper_loop, record, zero_phase_butterworth
from rodlib.paper import published
from rodlib.rigs import RestartingRig, RigParameters
from rodlib.case import assumed_reference

class Killed(RestartingRig):
    def read(self):
        if Killed.left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        Killed.left -= 1
        return super().read()

loop, Q = paper_loop(), zero_phase_butterworth()
L = LearningFilter(published.matrix("L_diagonal"), 1.0)
reference = (assumed_reference(25) * 0.02).round(6)
for samples in map(int, sys.argv[2:]):
    process = os.fork()
    if not process:
        Killed.left = samples
        path = os.path.join(sys.argv[1], f"{samples}.csv")
        rig = Killed(parameters=RigParameters(modes=10))
        record(rig, loop, Law(Q, L), reference, None, 3, pause=2, path=path)
    print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forks")
def test_a_killed_experiment_goes_on_as_if_nothing_had_been(loop, Q, L, tmp_path):
    """What is on disk are the trials that had ended; the rest comes out the same, bit for bit."""
    rig = RestartingRig(parameters=RigParameters(modes=10))
    whole = record(rig, loop, Law(Q, L), **SHORT, path=tmp_path / "whole.csv")
    kills = [3, 26, 52, 78]  # samples; a trial has 25, the pause before it 2
    outcome = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path, *map(str, kills)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert outcome.stdout.split() == [str(-signal.SIGKILL)] * len(kills), outcome.stderr
    for samples in kills:
        path = tmp_path / f"{samples}.csv"
        ended = (samples + 2) // 27
        assert path.exists() == (ended > 0)
        if ended:
            assert load_log(path).identical(whole.isel(trial=slice(ended)))
        assert record(rig, loop, Law(Q, L), **SHORT, path=path).identical(whole)
        assert path.read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_an_experiment_that_has_ended_leaves_rig_and_log_alone(loop, Q, L, tmp_path):
    path, device = tmp_path / "log.csv", VirtualRig()
    log = record(device, loop, Law(Q, L), **SHORT, path=path)
    content, time = path.read_bytes(), device.time
    assert record(device, loop, Law(Q, L), **SHORT, path=path).identical(log)
    with pytest.warns(
        UserWarning, match="has 3 trials, more than trials = 2: none is run, and al"
    ):
        assert record(
            device, loop, Law(Q, L), **SHORT | {"trials": 2}, path=path
        ).identical(log)
    assert path.read_bytes() == content and device.time == time
    assert load_log(path).identical(log)
    more = record(device, loop, Law(Q, L), **SHORT | {"trials": 4}, path=path)
    assert more.isel(trial=slice(3)).identical(log) and load_log(path).identical(more)


def test_notes_that_were_added_to_the_log_stay(loop, Q, tmp_path):
    path = tmp_path / "log.csv"
    record(VirtualRig(), loop, Law(Q, None), **SHORT | {"trials": 1}, path=path)
    save_log(load_log(path).assign_attrs(operator="Ada"), path)
    record(VirtualRig(), loop, Law(Q, None), **SHORT | {"trials": 2}, path=path)
    assert (
        load_log(path).attrs["operator"] == "Ada" and load_log(path).sizes["trial"] == 2
    )


@pytest.mark.parametrize(
    ("changes", "differing"),
    [
        ({"reference": SHORT["reference"] + 1}, "reference"),
        ({"L": None}, "L"),
        ({"gain": 0.5}, "step"),
        ({"rig": SimpleNamespace(read=len, apply=len)}, "actuators, disturbances"),
        ({"limits": {}}, "actuators"),
        ({"loop": paper_loop(degree=4)}, "loop"),
    ],
)
def test_another_experiment_does_not_go_on_with_the_log(
    loop, Q, L, tmp_path, changes, differing
):
    path = tmp_path / "log.csv"
    made = {"rig": VirtualRig(), "loop": loop, "law": Law(Q, L)} | SHORT
    record(**made | {"trials": 2}, path=path)
    parts = {name: changes[name] for name in vars(made["law"]) if name in changes}
    changes = {
        name: c for name, c in changes.items() if name not in parts or name == "loop"
    }
    parts.pop("loop", None)
    made["law"] = replace(made["law"], **parts)
    content, time = path.read_bytes(), made["rig"].time
    with pytest.raises(
        ValueError, match=f"holds another experiment, see its {differing}:"
    ):
        record(**made | changes, path=path)
    assert path.read_bytes() == content and made["rig"].time == time


def test_a_log_that_record_did_not_write_is_not_gone_on_with(loop, Q, L, tmp_path):
    path = tmp_path / "log.csv"
    record(VirtualRig(), loop, Law(Q, L), **SHORT, path=path)
    lines = path.read_text().splitlines(keepends=True)
    unnamed = "".join(line for line in lines if not line.startswith("# loop"))
    for text, message in (
        (unnamed, "another experiment, see its loop"),
        ("", "no line with the titles"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            record(VirtualRig(), loop, Law(Q, L), **SHORT, path=path)
        assert path.read_text() == text
