import warnings

import control
import numpy as np
import pytest
from plants import furnace, random_plant, stage, tanks

from rodlib import (
    Law,
    LearningFilter,
    LogError,
    current_trial_loop,
    load_log,
    paper_loop,
    record,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from rodlib.ilc import law_of, loop_of, replay_of, with_law
from rodlib.ilc.report import (
    about_the_law,
    left_out,
    rms_by_trial,
    save_following,
    summary,
)
from rodlib.ilc.trials.run import dataset
from rodlib.paper.repository import ROOT

PUMPS = ["pump A", "pump B", "pump C"]
UNITS = {"pump A": "ml/s", "pump B": "ml/s", "pump C": "ml/s", "leak": "ml/s"}
LOOPS = {
    "stage": current_trial_loop(
        stage(), ["F"], {"x": 1.0, "F": 10.0}, {"x": "mm", "F": "N", "friction": "N"}
    ),
    "tanks": current_trial_loop(
        tanks(), PUMPS, units=UNITS | dict.fromkeys(["left", "middle", "right"], "cm")
    ),
    "furnace": current_trial_loop(
        furnace(), sizes={"valve": 0.1}, units={"valve": "%", "outlet": "K"}
    ),
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
        """A wave that is another one in each trial."""
        wave = self.trial * np.sin(0.05 * self.sample)
        return {name: wave + i for i, name in enumerate(self.loop.disturbances)}

    def read(self):
        plant, d = self.loop.plant, list(self.measured.values())
        return plant.C @ self.x + plant.D[:, plant.noutputs :] @ d

    def apply(self, commands):
        plant, d = self.loop.plant, list(self.measured.values())
        self.x = plant.A @ self.x + plant.B @ np.concatenate([self.gain * commands, d])
        self.sample += 1


def law(loop, order=6, rest=0, gain=1.0):
    m = loop.plant.noutputs
    coefficients = np.zeros((m, m, order))
    coefficients[range(m), range(m), -1] = 0.5
    Q = zero_phase_butterworth(2, 0.06 / loop.Ts, loop.Ts)
    return Law(Q, LearningFilter(coefficients, loop.Ts), rest, gain)


def bump(m, samples=150):
    return np.outer(
        np.sin(np.pi * np.arange(samples) / samples) ** 2, 1.0 + np.arange(m)
    )


def recorded(name, tmp_path, trials=3, gain=1.0, rest=0, step=1.0):
    """A log made on one of the plants, from the disk."""
    loop = LOOPS[name]
    path = tmp_path / "log.csv"
    reference = bump(loop.plant.noutputs)
    record(
        Itself(loop, gain), loop, law(loop, rest=rest, gain=step), reference,
        trials=trials, pause=0, path=path,
    )  # fmt: skip
    return load_log(path)


@pytest.mark.parametrize(("rest", "step"), [(0, 1.0), (20, 0.3)])
@pytest.mark.parametrize("name", LOOPS)
def test_where_the_model_is_right_the_log_is_what_is_simulated_and_predicted(
    name, rest, step, tmp_path
):
    """The disturbances differ from trial to trial and have names that are not the rod's."""
    replay = replay_of(recorded(name, tmp_path, rest=rest, step=step))
    y = replay.trials.y.values
    size = np.abs(y).max()
    np.testing.assert_allclose(replay.simulated.y.values, y, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(replay.predicted, y, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(replay.fit, 1, atol=1e-8)
    assert replay.departure.to_numpy().max() < 1e-12 * size
    assert about_the_law(replay) == "the recorded v is that of the law in every trial"
    assert left_out(replay) == []
    assert replay.loop.outputs == LOOPS[name].outputs
    if name != "furnace":  # which has no disturbance
        assert replay.sources == LOOPS[name].disturbances
        blind = replay_of(
            replay.trials.drop_vars(["disturbance", "source", "source_unit"])
        )
        for other in (blind.simulated.y.values, blind.predicted):
            assert np.abs(other - y).max() > 1e-3 * size


def test_a_model_that_is_wrong_is_measured_by_its_fit(tmp_path):
    replay = replay_of(recorded("tanks", tmp_path, gain=0.9))
    loop, trials = LOOPS["tanks"], replay.trials
    inputs = np.concatenate([trials.u.values[1], trials.disturbance.values[1]], axis=1)
    y_hat = control.forced_response(loop.plant, inputs=inputs.T).outputs.T
    np.testing.assert_allclose(replay.predicted[1], y_hat, atol=1e-10)
    y = trials.y.values[1]
    for c, output in enumerate(loop.outputs):
        expected = 1 - np.sqrt(
            np.sum((y[:, c] - y_hat[:, c]) ** 2)
            / np.sum((y[:, c] - y[:, c].mean()) ** 2)
        )
        assert replay.fit.loc[2, output] == pytest.approx(expected)
        assert 0.5 < expected < 0.95
    missed = np.abs(
        replay.trials.y - replay.simulated.y
    ).max()  # feedback forgives some of it
    assert missed < np.abs(replay.trials.y - replay.predicted).max() / 2


def test_an_output_that_never_moves_has_no_fit(tmp_path):
    trials = recorded("stage", tmp_path)
    trials["y"] = 0 * trials.y + 3.0
    assert replay_of(trials).fit.isna().all(axis=None)


def test_each_trial_has_its_own_reference(tmp_path):
    loop = LOOPS["stage"]
    Q, L = law(loop).Q, law(loop).L
    references = bump(1) * np.array([1.0, -2.0, 0.5])[:, None, None]
    push = np.random.default_rng(1).standard_normal((3, 150, 1))
    v, outputs = np.zeros((3, 150, 1)), np.zeros((3, 150, 1))
    for k in range(3):
        if k:
            v[k] = Law(Q, L).next(v[k - 1], references[k - 1] - outputs[k - 1])
        inputs = np.hstack([references[k] + v[k], push[k]])
        outputs[k] = control.forced_response(loop.closed, inputs=inputs.T).outputs.T
    u = np.zeros_like(v)
    made = dataset(
        loop.Ts, loop.outputs, loop.controls, loop.disturbances, loop.units,
        reference=references, v=v, u=u, y=outputs, disturbance=push,
    )  # fmt: skip
    save_log(with_law(made, Law(Q, L, loop=loop)), tmp_path / "log.csv")
    replay = replay_of(load_log(tmp_path / "log.csv"))
    np.testing.assert_allclose(replay.simulated.y.values, outputs, atol=1e-9)
    np.testing.assert_array_equal(replay.simulated.reference.values, references)
    assert replay.departure.to_numpy().max() < 1e-12


def test_without_a_loop_only_what_needs_no_model_is_done(tmp_path):
    trials = recorded("tanks", tmp_path, rest=15, step=0.4)
    del trials.attrs["loop"]
    replay = replay_of(trials)
    assert replay.loop is replay.simulated is replay.predicted is replay.fit is None
    assert replay.disturbance is None
    assert about_the_law(replay) == "the recorded v is that of the law in every trial"
    last = trials.isel(trial=-1)
    assert (law_of(trials).rest, law_of(trials).gain) == (15, 0.4)
    following = law_of(trials).next(last.v.values, last.e.values)
    np.testing.assert_array_equal(replay.following, following)
    assert not following[-15:].any() and following[-16].all()
    (reason,) = left_out(replay)
    assert reason.startswith(
        "simulation and prediction: the log does not say which loop made it"
    )
    assert f"left out: {reason}" in summary(replay)


def test_without_a_law_nothing_is_said_of_it(tmp_path):
    trials = recorded("stage", tmp_path)
    del trials.attrs["L"]
    replay = replay_of(trials)
    assert (
        replay.law is replay.departure is replay.following is replay.simulated is None
    )
    assert replay.predicted is not None
    assert "law: the log does not say which law made it" in summary(replay)
    assert left_out(replay)[0].startswith(
        "law check, next trial and simulation: the log does not"
    )
    with pytest.raises(ValueError, match="the log does not say which law made it"):
        save_following(replay, tmp_path / "next.csv")
    assert not (tmp_path / "next.csv").exists()


def test_the_simulation_of_the_tracked_log_is_told_of_what_it_shall_know():
    trials = load_log(ROOT / "data" / "rig" / "learning.csv").isel(trial=slice(5))
    full = replay_of(trials)
    told = replay_of(trials, untold=["theta_a"])
    assert "disturbances ['theta_a']: the simulation is not told of them" in left_out(
        told
    )
    for replay, rows in ((full, [0, 1, 2]), (told, [1, 2])):
        d = np.zeros((5, 2500, 3))
        d[..., rows] = trials.disturbance.values[..., rows]
        expected = run_trials(
            loop_of(trials), law_of(trials), trials.reference.values[0], d, 5
        )
        np.testing.assert_array_equal(replay.simulated.y, expected.y)
    assert rms_by_trial(told.simulated.e).iloc[4, 0] == pytest.approx(1.04, abs=0.005)


def test_other_disturbances_than_the_models_are_named(tmp_path):
    trials = recorded("stage", tmp_path)
    trials["source"] = ["draught"]
    replay = replay_of(trials)
    assert not replay.disturbance.any()
    assert left_out(replay) == [
        "disturbances ['draught']: the model does not know them"
    ]


def test_trials_are_known_by_their_numbers(tmp_path):
    trials = recorded("stage", tmp_path, trials=6)
    shuffled = replay_of(trials.sel(trial=[3, 1, 2, 6, 5, 4]))
    assert shuffled.trials.identical(trials)
    some = replay_of(trials.sel(trial=[5, 2, 3]))
    np.testing.assert_array_equal(
        some.following, replay_of(trials.sel(trial=[4, 5])).following
    )
    assert some.departure.isna().to_numpy().ravel().tolist() == [True, False, True]
    assert about_the_law(some) == (
        "the recorded v is that of the law, as far as the trials before 2, 5 tell"
    )
    assert some.simulated is None and some.predicted is not None
    assert left_out(some) == [
        "simulation: not all trials from 1 on are there, but [2, 3, 5]"
    ]


def test_a_signal_without_learning_is_zero_by_the_law():
    loop = LOOPS["stage"]
    Q = law(loop).Q
    run = with_law(
        run_trials(loop, Law(Q, None), bump(1), None, 3), Law(Q, None, loop=loop)
    )
    assert (
        about_the_law(replay_of(run))
        == "the recorded v is that of the law in every trial"
    )
    np.testing.assert_array_equal(replay_of(run).following, np.zeros((150, 1)))
    run["v"][1, 5] = 1e-6
    assert about_the_law(replay_of(run)).startswith(
        "v departs from the law from trial 2 on, by 1.0"
    )


def test_a_plant_that_needs_feedback_is_not_predicted_without():
    plant = control.ss(1.2, 1.0, 1.0, 0, 0.1, inputs=["F"], outputs=["tilt"])
    loop = current_trial_loop(plant)
    Q, L = law(loop).Q, law(loop).L
    replay = replay_of(
        with_law(run_trials(loop, Law(Q, L), bump(1), None, 2), Law(Q, L, loop=loop))
    )
    assert replay.predicted is replay.fit is None
    assert replay.simulated is not None
    assert left_out(replay) == ["prediction: without feedback the model is unstable"]
    assert "fit" not in summary(replay)


def test_what_does_not_belong_together_is_refused(tmp_path):
    trials = recorded("stage", tmp_path)
    with pytest.raises(ValueError, match="trials = None must be a Dataset"):
        replay_of(None)
    with pytest.raises(LogError, match="loop cannot be understood"):
        replay_of(trials.assign_attrs(loop="{}"))


def test_the_rate_that_was_reached_is_told_where_it_can_be():
    """On the model it is what the model foretells; a law, a loop and one reference are needed."""
    loop, Q, L = (
        paper_loop(),
        zero_phase_butterworth(),
        LearningFilter(np.eye(2)[..., None], 1.0),
    )
    w = np.outer(np.sin(np.pi * np.arange(400) / 400) ** 2, [8.0, 10.0])
    run = with_law(
        run_trials(loop, Law(Q, L, gain=0.5), w, None, 3),
        Law(Q, L, gain=0.5, loop=loop),
    )
    replay = replay_of(run)
    for trial in (2, 3):
        table = replay.reached(trial)
        np.testing.assert_allclose(table.reached, table.foretold, rtol=1e-6)
        ratio = np.linalg.norm(table.reached * table.before) / np.linalg.norm(
            table.before
        )
        seen = np.sqrt((run.e[trial - 1] ** 2).sum() / (run.e[trial - 2] ** 2).sum())
        assert ratio == pytest.approx(float(seen)) and np.all(table.promised >= 0.5)
    assert replay.reached(1) is None and replay.reached(4) is None
    run = run.copy(deep=True)
    run["reference"][2] *= 2
    with warnings.catch_warnings(action="ignore"):
        assert replay_of(run).reached(3) is None
        bare = run.assign_attrs()
        del bare.attrs["loop"]
        assert replay_of(bare).reached(2) is None
