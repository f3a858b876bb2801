"""Estimated outputs against a Luenberger observer written out, combinations against least squares."""

import warnings

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import furnace, stage, tanks
from scipy.optimize import minimize

from rodlib import (
    ClosedLoop,
    NormOptimal,
    Rod,
    combinations,
    current_trial_loop,
    estimated,
    load_log,
    midr,
    minimal_realisation,
    record,
    run_trials,
    save_log,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.laboratory import Controller
from rodlib.ilc.models import frequency_response
from rodlib.ilc.trials import learn
from rodlib.rigs import RestartingRig, RigParameters

PLACES = tuple(np.linspace(0.01, 0.31, 9))


def all_states(plant, controls=None):
    """A loop around a plant, and the plant with its states as further outputs."""
    C = np.vstack([plant.C, np.eye(plant.nstates)])
    names = [*plant.output_labels, *(f"x{i}" for i in range(plant.nstates))]
    D = np.vstack([plant.D, np.zeros((plant.nstates, plant.ninputs))])
    model = control.ss(plant.A, plant.B, C, D, plant.dt, inputs=plant.input_labels, outputs=names)
    return current_trial_loop(model[: plant.noutputs, :], controls), model


@pytest.fixture(scope="module")
def rod_case():
    model = midr(Rod(sensors=(0.12, 0.28, *PLACES)), 3)
    model = control.sample_system(minimal_realisation(model, ["Q1", "Q3"]), 1.0)
    return current_trial_loop(model[:2, :], ["Q1", "Q3"]), model


CASES = {
    "stage": lambda: all_states(stage(1e-3), ["F"]),  # in millimetres, one channel
    "tanks": lambda: all_states(tanks(), ["pump A", "pump B", "pump C"]),
    "furnace": lambda: all_states(control.ss(furnace())),  # thirty samples late
}


@pytest.mark.parametrize("name", [*CASES, "rod"])
def test_estimates_are_those_of_the_observer_written_out(name, rod_case):
    """Noise and a disturbance included: sample by sample, as (16) says it."""
    loop, model = rod_case if name == "rod" else CASES[name]()
    rng, Q = np.random.default_rng(0), zero_phase_butterworth(2, 0.3 / loop.Ts, loop.Ts)
    shape = 2, 60, len(loop.outputs)
    d = rng.standard_normal((60, len(loop.disturbances)))
    noise = 0.1 * rng.standard_normal(shape)
    run = run_trials(loop, Q, None, rng.standard_normal(shape), d, 2, noise=noise)
    z_hat = estimated(run, loop, model)
    assert z_hat.dims == ("trial", "time", "estimate")
    assert z_hat.estimate.values.tolist() == model.output_labels
    B, K = loop.plant.B[:, : shape[2]], loop.KL
    for k in range(2):
        x, n = np.zeros(loop.plant.nstates), loop.plant.nstates
        for p in range(60):
            np.testing.assert_allclose(z_hat.values[k, p], model.C @ x, atol=1e-7, rtol=1e-6)
            trial = run.isel(trial=k, time=p)
            surprise = trial.y.values - loop.plant.C @ x
            x = loop.plant.A @ x + B @ (trial.u.values + trial.delta.values) + K[:n] @ surprise


def test_without_disturbance_estimates_are_right_and_with_one_elsewhere_wrong(rod_case):
    loop, model = rod_case
    r, Q = np.tile(np.linspace(0, 5, 800)[:, None], 2), zero_phase_butterworth()
    names = loop.controls + loop.disturbances
    for size in (0.0, 3.0):
        d = np.zeros((800, 3))
        d[:, loop.disturbances.index("Q2")] = size
        run = run_trials(loop, Q, None, r, d, 1)
        inputs = np.hstack([run.u.values[0], d]).T
        z = control.forced_response(model[:, names], inputs=inputs).outputs.T
        off = np.abs(z - estimated(run, loop, model).values[0]).max(axis=0)
        if size == 0:
            np.testing.assert_allclose(off, 0, atol=1e-8)
        else:  # at rest at the sensors it is right, but not at the end of the rod
            assert off[2] > 1
            assert np.abs(z - estimated(run, loop, model).values[0])[-1, :2].max() < 0.05


def test_a_log_gives_the_same_estimates_and_tells_of_an_observer_that_was_not_at_rest(
    rod_case, tmp_path
):
    loop, model = rod_case
    rig = RestartingRig(Rod(), RigParameters(modes=20, noise=0.0, quantum=0.0))
    r = np.tile(np.linspace(0, 2, 200)[:, None], 2)
    with warnings.catch_warnings(action="ignore"):
        log = record(rig, loop, zero_phase_butterworth(), None, r, trials=2, decimals={})
    save_log(log, tmp_path / "log")
    z_hat = estimated(log, loop, model)
    np.testing.assert_allclose(estimated(load_log(tmp_path / "log"), loop, model), z_hat, atol=1e-3)
    controller, seen = Controller(loop), []
    for y, w in zip(log.y.values[1], (log.reference + log.v).values[1], strict=True):
        seen.append(model.C @ controller._x_hat)
        controller.step(y, w)
    np.testing.assert_allclose(z_hat.values[1], seen, atol=1e-8)
    log["delta"][1] += 1.0
    with pytest.warns(UserWarning, match="in trial 2 the observer was not at rest"):
        estimated(log, loop, model)
