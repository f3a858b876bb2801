"""Loops whose controller is not ours: a PID in a PLC, a target that runs a trial by itself."""

import warnings
from types import SimpleNamespace

import control
import numpy as np
import pytest
from test_stopping import bump

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    Settings,
    current_trial_loop,
    load_log,
    measured_response,
    multisine,
    plot,
    record,
    run_trials,
    save_log,
    shake,
    synthesise,
    try_out,
    zero_phase_butterworth,
)
from rodlib.ilc.logs.replay import replay
from rodlib.ilc.loop.notes import loop_of
from rodlib.ilc.rigs.protocol import RigError, StoppedError
from rodlib.ilc.trials.run import rms
from rodlib.ilc.workbench.plant import Plant, plant_of_file

# Two PIDs of a coupled plant; P(0) is not I, as with proportional action alone.
P = control.ss(
    [[0.8, 0.1], [0.0, 0.7]], [[0.5, 0.0], [0.0, 0.9]], [[1.0, 0.2], [0.1, 1.0]], 0, 0.1,
    inputs=["set x", "set y"], outputs=["x", "y"],
)  # fmt: skip
Q, REFERENCE = zero_phase_butterworth(2, 3.0, 0.1), bump(150, [2.0, -1.0])
L = LearningFilter(0.1 * np.eye(2)[..., None], 0.1)
KNOWN, NAMED = (
    ClosedLoop(P),
    ClosedLoop(Ts=0.1, outputs=["x", "y"], units={"x": "mm", "y": "mm"}),
)


class Machine:
    """Its controller is on it; sample by sample, or a trial at a time."""

    def __init__(self, noise=0.0):
        self.noise, self.random, self.ends = noise, np.random.default_rng(0), 0
        self.begin(1)

    def begin(self, trial):
        self.state = np.zeros(2)
        self.measured = {"motor x": 0.0, "motor y": 0.0}

    def safe(self):
        self.ends += 1


class Sampled(Machine):
    def read(self):
        return P.C @ self.state + self.noise * self.random.standard_normal(2)

    def apply(self, w):
        self.state = P.A @ self.state + P.B @ w
        self.measured = {"motor x": 3.0 * w[0], "motor y": self.state[1]}


class Whole(Machine):
    def run(self, w):
        y = control.forced_response(P, inputs=w.T).outputs.T
        return y + self.noise * self.random.standard_normal(y.shape)


def test_a_loop_that_is_known_by_p_is_simulated():
    run = run_trials(KNOWN, Law(Q, L), REFERENCE, trials=5)
    assert "u" not in run and "delta" not in run and run.attrs["Ts"] == 0.1
    v = np.zeros_like(REFERENCE)
    for k in range(5):
        y = control.forced_response(P, inputs=(REFERENCE + v).T).outputs.T
        np.testing.assert_allclose(run.y[k], y, atol=1e-12)
        v = Law(Q, L).next(v, REFERENCE - y)
    x, noise = (
        np.array([1.0, -1.0]),
        np.random.default_rng(0).standard_normal((1, 150, 2)),
    )
    begun = run_trials(
        KNOWN, Law(Q, L), REFERENCE, None, 1, initial_state=x, noise=noise
    )
    np.testing.assert_allclose(begun.y[0, 0], P.C @ x + noise[0, 0])
    other = run_trials(KNOWN, Law(Q, L), REFERENCE, trials=1, plant=2 * P)
    np.testing.assert_allclose(other.y[0], 2 * run.y[0])
    for wrong, message in (
        (NAMED, "loop has no P"),
        (ClosedLoop(P, disturbances=["d"]), "disturbance is not zero"),
    ):
        with pytest.raises(ValueError, match=message):
            run_trials(
                wrong, Law(Q, L), REFERENCE, np.ones((150, len(wrong.disturbances)))
            )


@pytest.mark.parametrize("loop", [KNOWN, NAMED], ids=["P", "names"])
@pytest.mark.parametrize("device", [Sampled, Whole])
def test_any_such_loop_learns_on_its_rig_as_in_the_simulation(loop, device, tmp_path):
    path, rig = tmp_path / "log.csv", device()
    log = record(rig, loop, Law(Q, L), REFERENCE, trials=3, path=path)
    run = run_trials(KNOWN, Law(Q, L), REFERENCE, trials=3)
    for name in ("v", "y", "e"):
        np.testing.assert_allclose(log[name], run[name], atol=1e-12)
    assert rig.ends == 1 and "u" not in log and "control" not in log.coords
    loaded = load_log(path)
    assert loaded.identical(log)
    again = loop_of(loaded)
    assert (again.Ts, again.outputs, again.units) == (loop.Ts, loop.outputs, loop.units)
    assert (again.P is None) == (loop.P is None)
    more = record(device(), loop, Law(Q, L), REFERENCE, trials=4, path=path)
    assert more.isel(trial=slice(3)).identical(log)
    with pytest.raises(ValueError, match="another experiment, see its loop"):
        record(device(), ClosedLoop(0.9 * P), Law(Q, L), REFERENCE, trials=5, path=path)


def test_a_log_of_such_a_loop_is_replayed(tmp_path):
    log = record(Sampled(), KNOWN, Law(Q, L), REFERENCE, trials=3)
    replayed = replay(log)
    np.testing.assert_allclose(replayed.simulated.y, log.y, atol=1e-12)
    assert replayed.fit.values.min() > 0.999999 and not replayed.departure.values.any()
    assert "fit of the model" in repr(replayed)
    silent = replay(record(Sampled(), NAMED, Law(Q, L), REFERENCE, trials=2))
    assert (
        silent.simulated is None
        and silent.fit is None
        and not silent.departure.values.any()
    )
    assert "simulation and prediction: the loop has no P" in repr(silent)


def test_its_commands_are_recorded_if_the_rig_tells_them(tmp_path):
    controls = ["motor x", "motor y"]
    loop = ClosedLoop(Ts=0.1, outputs=["x", "y"], controls=controls)
    log = record(
        Sampled(),
        loop,
        Law(Q, L),
        REFERENCE,
        trials=2,
        decimals={"u": 2},
        path=tmp_path / "l",
    )
    np.testing.assert_allclose(
        log.u[1, 1:, 0], 3 * (REFERENCE + log.v[1])[:-1, 0], atol=0.00501
    )
    assert (
        load_log(tmp_path / "l").identical(log) and list(log.control.values) == controls
    )
    with pytest.raises(
        ValueError, match=r"rig.measured must have the controls \['motor x'"
    ):
        record(SimpleNamespace(read=len, apply=len), loop, Law(Q, L), REFERENCE)
    whole = SimpleNamespace(run=lambda w: (w, 2 * w))
    downloaded = record(whole, loop, Law(Q, L), REFERENCE, trials=2)
    np.testing.assert_array_equal(
        downloaded.u[1], 2 * (REFERENCE + downloaded.v.values[1])
    )
    whole.run = lambda w: w
    with pytest.raises(RigError, match="trial 1: u holds values of type object"):
        record(whole, loop, Law(Q, L), REFERENCE)


@pytest.mark.parametrize(
    "bad", [np.full((150, 2), np.nan), np.zeros((149, 2)), None, "y"]
)
def test_what_is_downloaded_is_checked(bad, tmp_path):
    rig, path = Whole(), tmp_path / "log.csv"
    good = rig.run
    rig.run = lambda w: good(w) if not path.exists() else bad
    with pytest.raises(RigError, match="trial 2: y "):
        record(rig, NAMED, Law(Q, L), REFERENCE, trials=3, path=path)
    assert load_log(path).sizes["trial"] == 1 and rig.ends == 1
    far = SimpleNamespace(run=lambda w: 100 * w)
    with pytest.raises(
        StoppedError, match=r"trial 1, sample \d+: x = .* limits of stop"
    ):
        record(far, NAMED, Law(Q, L), REFERENCE)
    with pytest.raises(ValueError, match=r"pause = 3, but rig\.run begins"):
        record(Whole(), NAMED, Law(Q, L), REFERENCE, pause=3)
    broken = SimpleNamespace(run=lambda w: 1 / 0)
    with pytest.raises(ZeroDivisionError) as caught:
        record(broken, NAMED, Law(Q, L), REFERENCE)
    assert caught.value.__notes__ == ["in trial 1"]


def test_a_target_may_run_our_controller_by_itself():
    """At 10 kHz nobody calls apply from Python."""
    plant = control.ss(0.9, 0.1, 1, 0, 1e-4, inputs=["F"], outputs=["x"])
    loop, Q = current_trial_loop(plant), zero_phase_butterworth(2, 1000.0, 1e-4)

    def run(w):
        made = run_trials(loop, Law(Q, None), w, trials=1)
        return made.y.values[0], made.u.values[0]

    L = LearningFilter([[[0.5]]], 1e-4)
    log = record(SimpleNamespace(run=run), loop, Law(Q, L), bump(200, [1.0]), trials=3)
    same = run_trials(loop, Law(Q, L), bump(200, [1.0]), trials=3)
    for name in ("y", "u", "v"):
        np.testing.assert_allclose(log[name], same[name], atol=1e-12)
    assert "delta" not in log


@pytest.mark.parametrize("device", [Sampled, Whole])
def test_what_it_cannot_follow_is_warned_of_whoever_runs_the_trial(device):
    rig = device()
    rig.limits = {"set x": (-1.0, 1.5)}
    with pytest.warns(
        UserWarning, match="trial 1: commands were beyond the limits of set x"
    ) as seen:
        record(rig, KNOWN, Law(Q, None, limits={}), REFERENCE, trials=1)
    assert seen[0].filename == __file__


@pytest.mark.parametrize("loop", [KNOWN, NAMED], ids=["P", "names"])
@pytest.mark.parametrize("device", [Sampled, Whole])
def test_it_is_shaken_and_nothing_is_assumed_of_it_at_frequency_zero(loop, device):
    excitation = multisine(loop, 0.3, 20.0, 1.0, 0.2, 12)
    with warnings.catch_warnings(action="error"):
        measured = measured_response(shake(device(noise=0.001), loop, excitation))
    truth = KNOWN.frequency_response(measured.omega)
    assert np.linalg.norm(truth[0] - np.eye(2), 2) > 1
    off = np.linalg.norm(measured.response - truth, 2, axis=(1, 2))
    assert np.all(off < measured.radius(0.9999, jointly=True)) and off.max() < 0.01
    omega = np.array([0.0, 0.1, measured.omega[0], 1.0, 31.0])
    response, radius = measured.on(omega)
    off = np.linalg.norm(response - KNOWN.frequency_response(omega), 2, axis=(1, 2))
    assert np.all(off <= radius) and radius[:4].max() < 0.1
    assert "P(0)" not in "".join(measured.basis(omega)) + repr(measured)


def test_filters_are_designed_for_it_and_the_workbench_takes_it(tmp_path):
    grid = np.geomspace(1e-3, 31, 200)
    design = synthesise(KNOWN, Q, grid, order=5, band=(0.01, 1.0))
    run = run_trials(KNOWN, Law(Q, design.filter), REFERENCE, trials=5)
    assert rms(run.e).values[-1] < 0.05 * rms(run.e).values[0]
    save_log(
        record(Sampled(), KNOWN, Law(Q, L), REFERENCE, trials=2), tmp_path / "log.csv"
    )
    for plant in (Plant("loop", KNOWN), plant_of_file(tmp_path / "log.csv")):
        outcome = try_out(Settings.of(plant))
        assert outcome.design is not None and outcome.rms[-1] < 0.2 * outcome.rms[0]
    with pytest.raises(ValueError, match="response has no P"):
        Plant("loop", NAMED)
    shaken = shake(Whole(0.001), NAMED, multisine(NAMED, 0.3, 20.0, 1.0, 0.2, 12))
    save_log(shaken, tmp_path / "shaken.csv")
    outcome = try_out(Settings.of(plant_of_file(tmp_path / "shaken.csv")))
    assert outcome.design is not None and outcome.rms == ()
    plot(outcome)


def test_what_is_no_loop_is_refused():
    for given, message in (
        ({}, "then Ts and outputs must be given"),
        ({"P": P, "Ts": 0.2}, r"P.Ts = 0.1, loop.Ts = 0.2"),
        ({"P": control.ss(2.0, 1, 1, 0, 1.0)}, "P is unstable"),
        ({"P": control.ss(-1.0, 1, 1, 0)}, "P.dt = 0 must be a sampling period"),
        ({"P": P[0, :]}, "P has 2 inputs and 1 outputs"),
        ({"P": P, "outputs": ["a"]}, "outputs = "),
        ({"P": P, "controls": ["a"]}, "controls = "),
        ({"P": P, "outputs": ["a", "a"]}, "outputs = "),
        ({"P": P, "units": {"z": "mm"}}, "units is about"),
    ):
        with pytest.raises(ValueError, match=message):
            ClosedLoop(**given)
