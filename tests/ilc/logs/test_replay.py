"""A log is replayed with the law and the loop that it names; what it lacks is left out."""

import json
import warnings

import control
import numpy as np
import pandas as pd
import pytest
from plants import furnace, random_plant, stage, tanks

from rodlib import (
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    paper_loop,
    record,
    replay,
    run_trials,
    zero_phase_butterworth,
)
from rodlib.ilc import law_of
from rodlib.ilc.law.io import with_law
from rodlib.ilc.logs.replay import rms_by_trial
from rodlib.ilc.loop.notes import LogError, loop_of
from rodlib.paper import ROOT

PUMPS = ["pump A", "pump B", "pump C"]
LEVELS = ["left", "middle", "right"]
TANK_UNITS = dict.fromkeys([*PUMPS, "leak"], "ml/s") | dict.fromkeys(LEVELS, "cm")
STAGE_UNITS = {"x": "mm", "F": "N", "friction": "N"}
LOOPS = {
    "stage": current_trial_loop(stage(), ["F"], {"x": 1.0, "F": 10.0}, STAGE_UNITS),
    "tanks": current_trial_loop(tanks(), PUMPS, units=TANK_UNITS),
    "furnace": current_trial_loop(furnace(), sizes={"valve": 0.1}),
    "feedthrough": current_trial_loop(
        random_plant(np.random.default_rng(3)), ["u1", "u2"]
    ),
}


class Itself:
    """The plant of the design as a rig, which measures its disturbances; trials begin at zero."""

    def __init__(self, loop, gain=1.0):
        self.loop, self.gain = loop, gain
        self.begin(0)

    def begin(self, trial):
        self.trial, self.sample, self.x = trial, 0, np.zeros(self.loop.plant.nstates)

    @property
    def measured(self):
        """Waves that differ from trial to trial."""
        wave = self.trial * np.sin(0.05 * self.sample)
        return {name: wave + i for i, name in enumerate(self.loop.disturbances)}

    def read(self):
        plant, d = self.loop.plant, list(self.measured.values())
        return plant.C @ self.x + plant.D[:, plant.noutputs :] @ d

    def apply(self, commands):
        plant, d = self.loop.plant, list(self.measured.values())
        self.x = plant.A @ self.x + plant.B @ np.concatenate([self.gain * commands, d])
        self.sample += 1


def law_for(loop, rest=0, gain=1.0):
    m = len(loop.outputs)
    L = LearningFilter(np.eye(m)[..., None] * [0, 0, 0, 0, 0, 0.5], loop.Ts)
    Q = zero_phase_butterworth(2, 0.06 / loop.Ts, loop.Ts)
    return Law(Q, L, rest, gain, loop=loop)


def bump(m, samples=150):
    rise = np.sin(np.pi * np.arange(samples) / samples) ** 2
    return np.outer(rise, 1.0 + np.arange(m))


def recorded(name, path, trials=3, plant_gain=1.0, **options):
    """A log made on one of the plants, from the disk."""
    loop = LOOPS[name]
    reference, path = bump(len(loop.outputs)), path / "log.csv"
    law = law_for(loop, **options)
    rig = Itself(loop, plant_gain)
    record(rig, loop, law, reference, trials=trials, pause=0, path=path)
    return load_log(path)


def simulated(name, trials=4):
    """A log made by simulation."""
    loop = LOOPS[name]
    law = law_for(loop)
    return with_law(run_trials(loop, law, bump(len(loop.outputs)), None, trials), law)


@pytest.mark.parametrize("options", [{}, {"rest": 20, "gain": 0.3}])
@pytest.mark.parametrize("name", LOOPS)
def test_with_the_right_model_simulation_and_prediction_are_the_log(
    name, options, tmp_path
):
    replayed = replay(recorded(name, tmp_path, **options))
    y, names = replayed.trials.y.values, replayed.loop.disturbances
    tolerance = {"rtol": 0, "atol": 1e-9 * np.abs(y).max()}
    np.testing.assert_allclose(replayed.simulated.y.values, y, **tolerance)
    np.testing.assert_allclose(replayed.predicted, y, **tolerance)
    np.testing.assert_allclose(replayed.fit, 1, atol=1e-8)
    assert replayed.departure.to_numpy().max() < tolerance["atol"] / 1000
    assert replayed.agreement == "the recorded v is that of the law in every trial"
    assert replayed.omissions == [] and replayed.sources == names
    if names:
        without = ["disturbance", "source", "source_unit"]
        blind = replay(replayed.trials.drop_vars(without))
        for other in (blind.simulated.y.values, blind.predicted):
            assert np.abs(other - y).max() > 1e6 * tolerance["atol"]


def test_the_fit_measures_how_wrong_a_model_is(tmp_path):
    replayed = replay(recorded("tanks", tmp_path, plant_gain=0.9))
    plant, trial = LOOPS["tanks"].plant, replayed.trials.isel(trial=1)
    inputs = np.hstack([trial.u, trial.disturbance])
    y_hat = control.forced_response(plant, inputs=inputs.T).outputs.T
    np.testing.assert_allclose(replayed.predicted[1], y_hat, atol=1e-10)
    y = trial.y.values
    expected = 1 - np.sqrt(np.sum((y - y_hat) ** 2, axis=0) / y.var(axis=0) / len(y))
    np.testing.assert_allclose(replayed.fit.loc[2], expected)
    assert np.all((expected > 0.5) & (expected < 0.95))
    still = replayed.trials.assign(y=0 * replayed.trials.y + 3.0)
    assert replay(still).fit.isna().all(axis=None)


def test_without_a_loop_the_law_is_checked(tmp_path):
    trials = recorded("tanks", tmp_path, rest=15, gain=0.4)
    del trials.attrs["loop"]
    replayed = replay(trials)
    for name in ("loop", "simulated", "predicted", "fit", "disturbance"):
        assert getattr(replayed, name) is None
    assert replayed.agreement.endswith("in every trial")
    last = trials.isel(trial=-1)
    following = law_of(trials).next(last.v.values, last.e.values)
    np.testing.assert_array_equal(replayed.following, following)
    assert not following[-15:].any() and following[-16].all()
    (reason,) = replayed.omissions
    assert "does not name its loop" in reason and f"left out: {reason}" in repr(
        replayed
    )


def test_without_a_law_the_model_is_checked(tmp_path):
    trials = recorded("stage", tmp_path)
    del trials.attrs["L"]
    replayed = replay(trials)
    for name in ("law", "departure", "following", "simulated"):
        assert getattr(replayed, name) is None
    assert replayed.fit is not None and replayed.warnings == ()
    assert "law: the log does not name its law" in repr(replayed)
    with pytest.raises(ValueError, match="does not name its law"):
        replayed.save_following(tmp_path / "next.csv")
    assert not (tmp_path / "next.csv").exists()


def test_disturbances_may_count_as_unmeasured_or_not_be_in_the_model(tmp_path):
    trials = load_log(ROOT / "data" / "rig" / "learning.csv").isel(trial=slice(5))
    partial = replay(trials, unmeasured=["theta_a"])
    assert partial.omissions == [
        "disturbances ['theta_a']: the simulation ignores them"
    ]
    for replayed, columns in ((replay(trials), [0, 1, 2]), (partial, [1, 2])):
        d = np.zeros((5, 2500, 3))
        d[..., columns] = trials.disturbance.values[..., columns]
        reference = trials.reference.values[0]
        run = run_trials(loop_of(trials), law_of(trials), reference, d, 5)
        np.testing.assert_array_equal(replayed.simulated.y, run.y)
    simulation = partial.rms["RMS (K), simulation"]
    assert simulation[5] == pytest.approx(1.04, abs=0.005)  # of notebook 5
    trials = recorded("stage", tmp_path)
    trials["source"] = ["draught"]
    replayed = replay(trials)
    assert not replayed.disturbance.any()
    assert replayed.omissions == ["disturbances ['draught']: they are not in the model"]


def test_trials_are_identified_by_their_numbers(tmp_path):
    trials = recorded("stage", tmp_path, trials=6)
    assert replay(trials.sel(trial=[3, 1, 2, 6, 5, 4])).trials.identical(trials)
    some, last = replay(trials.sel(trial=[5, 2, 3])), replay(trials.sel(trial=[4, 5]))
    np.testing.assert_array_equal(some.following, last.following)
    assert some.departure.x.isna().tolist() == [True, False, True]
    assert "but in 2, 5, without a trial before" in some.agreement
    assert some.simulated is None and some.predicted is not None
    assert "simulation" in some.omissions[0] and "[2, 3, 5]" in some.omissions[0]


def test_without_learning_v_is_zero():
    loop = LOOPS["stage"]
    law = Law(law_for(loop).Q, None, loop=loop)
    run = with_law(run_trials(loop, law, bump(1), None, 3), law)
    assert replay(run).agreement.endswith("in every trial")
    assert not replay(run).following.any() and replay(run).error_by_octave(2) is None
    run["v"][1, 5] = 1e-6
    assert "departs from the law from trial 2 on, by 1.0" in replay(run).agreement


@pytest.mark.parametrize("exponent", [-9, 9])
@pytest.mark.parametrize(("trial", "channel"), [(1, 0), (4, 2)])
def test_a_departure_from_the_law_is_found_in_any_unit(trial, channel, exponent):
    run = simulated("tanks")
    for name in ("reference", "v", "u", "delta", "y", "e"):
        run[name] = 10.0**exponent * run[name]
    largest = np.abs(run.v.values[..., channel]).max()
    assert np.all(replay(run).departure <= 1e-12 * 10.0**exponent)
    run["v"][trial - 1, 70, channel] += 1e-3 * largest
    text = replay(run).agreement
    assert text.startswith(f"v departs from the law from trial {trial} on, by ")
    assert text.endswith(f" cm in {LEVELS[channel]}")
    amount = float(text.split("by ")[1].split()[0])
    assert amount == pytest.approx(1e-3 * largest, rel=0.06)


def test_an_unstable_plant_is_simulated_but_not_predicted():
    plant = control.ss(1.2, 1.0, 1.0, 0, 0.1, inputs=["F"], outputs=["tilt"])
    loop = current_trial_loop(plant)
    law = law_for(loop)
    replayed = replay(with_law(run_trials(loop, law, bump(1), None, 2), law))
    assert replayed.predicted is replayed.fit is None
    assert replayed.simulated is not None and "fit" not in repr(replayed)
    assert replayed.omissions == ["prediction: without feedback the model is unstable"]


def test_what_is_not_a_log_is_refused():
    with pytest.raises(ValueError, match="trials = None"):
        replay(None)
    with pytest.raises(LogError, match="loop"):
        replay(simulated("stage").assign_attrs(loop="{}"))
    with pytest.raises(ValueError, match="unmeasured"):
        replay(simulated("stage"), unmeasured="friction")


def test_the_error_by_octave_is_the_predicted_one_on_the_model():
    loop = paper_loop()
    L = LearningFilter(np.eye(2)[..., None], 1.0)
    law = Law(zero_phase_butterworth(), L, gain=0.5, loop=loop)
    run = with_law(run_trials(loop, law, 4 * bump(2, 400), None, 3), law)
    for trial in (2, 3):
        table = replay(run).error_by_octave(trial)
        np.testing.assert_allclose(table.measured, table.predicted, rtol=1e-6)
        after, before = (run.e.sel(trial=k).values for k in (trial, trial - 1))
        ratio = np.linalg.norm(table.measured * table.before)
        ratio /= np.linalg.norm(table.before)
        assert ratio == pytest.approx(np.linalg.norm(after) / np.linalg.norm(before))
        assert np.all(table.bound >= 0.5)
    assert replay(run).error_by_octave(1) is replay(run).error_by_octave(4) is None
    run = run.copy(deep=True)
    run["reference"][2] *= 2
    with warnings.catch_warnings(action="ignore"):
        assert replay(run).error_by_octave(3) is None
        del run.attrs["loop"]
        assert replay(run).error_by_octave(2) is None


@pytest.mark.parametrize("names", [LEVELS, ['a, "b"', "# 2", "ϑ / K"]])
def test_the_next_v_is_read_back_equal(names, tmp_path):
    trials = simulated("tanks").assign_coords(output=("channel", names))
    del trials.attrs["loop"]  # of the plant's former names
    replayed, path = replay(trials), tmp_path / "next.csv"
    replayed.save_following(path)
    titles = [f"v_{name}" for name in names]
    read = pd.read_csv(path, comment="#", nrows=0).columns.tolist()
    assert read == ["time", *titles]
    table = np.loadtxt(path, delimiter=",", skiprows=3)
    np.testing.assert_array_equal(table[:, 0], trials.time)
    np.testing.assert_array_equal(table[:, 1:], replayed.following)
    first, second = path.read_text(encoding="utf-8").splitlines()[:2]
    assert first == "# ILC signal v of trial 5, to be added to the reference"
    units = {"time": "s"} | dict.fromkeys(titles, "cm")
    assert json.loads(second.removeprefix("# units: ")) == units


def test_errors_are_summed_over_channels_of_one_unit():
    e = simulated("tanks").e.assign_coords(output_unit=("channel", ["cm", "", "cm"]))
    table = rms_by_trial(e)
    squares = (e.values**2).mean(axis=1)
    assert table.columns.tolist() == ["RMS of left, right (cm)", "RMS of middle"]
    np.testing.assert_allclose(
        table**2, np.c_[squares[:, [0, 2]].sum(1), squares[:, 1]]
    )


def test_a_replay_is_printed_in_lines_and_warns():
    lines = repr(replay(simulated("stage"))).splitlines()
    assert lines[0] == "4 trials of 150 samples, Ts = 0.001 s"
    assert lines[1].endswith("in every trial") and "mm" in lines[3]
    for k, line in enumerate(lines[5:9], 1):
        number, log, simulation = line.split()
        assert int(number) == k and log == simulation
    assert lines[9].endswith("x 100 %") and 14 <= len(lines) <= 20
    loop, law = LOOPS["tanks"], law_for(LOOPS["tanks"])
    wrong = Law(law.Q, LearningFilter(-4 * law.L.coefficients, 2.0), loop=loop)
    with warnings.catch_warnings(action="ignore"):
        run = with_law(run_trials(loop, wrong, bump(3), trials=6), wrong)
    with pytest.warns(UserWarning, match="the error grows") as caught:
        replayed = replay(run)
    assert caught[0].filename == __file__ and len(caught) == 1
    assert "WARNING: the error grows" in repr(replayed)
    with warnings.catch_warnings(action="error"):
        assert replay(run.isel(trial=[0, 2, 5])).warnings == ()
