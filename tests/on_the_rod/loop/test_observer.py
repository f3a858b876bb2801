"""Estimated outputs against an observer written out, combinations against least squares."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import PUMPS, tanks

from ilctools import (
    ClosedLoop,
    Law,
    NormOptimal,
    combinations,
    current_trial_loop,
    estimated,
    load_log,
    minimal_realisation,
    run_trials,
    save_log,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.models import frequency_response
from rodlib import Rod, midr


def rod_case():
    """The paper's rod with two measured outputs of four; noise and a disturbance."""
    model = midr(Rod(sensors=(0.12, 0.28, 0.01, 0.31)), 3)
    model = control.sample_system(minimal_realisation(model, ["Q1", "Q3"]), 1.0)
    return current_trial_loop(model[:2, :], ["Q1", "Q3"]), model


def tank_case():
    """Three levels, and the sum of them and its difference as outputs that are not measured."""
    plant = tanks()
    C = np.vstack([plant.C, [[1, 1, 1], [1, 0, -1]]])
    model = control.ss(plant.A, plant.B, C, 0, plant.dt, inputs=plant.input_labels)
    return current_trial_loop(model[:3, :], PUMPS), model


def run_of(loop):
    rng, Q = np.random.default_rng(0), zero_phase_butterworth(2, 0.3 / loop.Ts, loop.Ts)
    shape = 2, 60, len(loop.outputs)
    d = rng.standard_normal((60, len(loop.disturbances)))
    noise = 0.1 * rng.standard_normal(shape)
    r, v = rng.standard_normal(shape), rng.standard_normal(shape[1:])
    return run_trials(loop, Law(Q, None), r, d, 2, noise=noise, v=v)


@pytest.mark.parametrize("case", [rod_case, tank_case])
def test_estimates_are_those_of_the_observer_written_out(case, tmp_path):
    """Noise and a disturbance included: sample by sample, as (16) says it."""
    loop, model = case()
    run, n = run_of(loop), loop.plant.nstates
    z_hat = estimated(run, loop, model)
    assert z_hat.dims == ("trial", "time", "estimate")
    assert z_hat.estimate.values.tolist() == model.output_labels
    A, B, C = loop.plant.A, loop.plant.B[:, : len(loop.outputs)], loop.plant.C
    for k in range(2):
        x = np.zeros(n)
        for p in range(60):
            z = model.C @ x
            np.testing.assert_allclose(z_hat.values[k, p], z, atol=1e-7, rtol=1e-6)
            trial = run.isel(trial=k, time=p)
            innovation = trial.y.values - C @ x
            inputs = trial.u.values + trial.delta.values
            x = A @ x + B @ inputs + loop.KL[:n] @ innovation
    save_log(run, tmp_path / "log")
    again = estimated(load_log(tmp_path / "log"), loop, model)
    np.testing.assert_allclose(again, z_hat, atol=1e-9)
    run["delta"][1] += 0.1 * np.abs(run.u).max()
    with pytest.warns(UserWarning, match="in trial 2 the observer was not at rest"):
        estimated(run, loop, model)


def test_estimates_refuse_what_is_not_of_the_loop():
    loop, model = rod_case()
    run = run_of(loop)
    for wrong, message in (
        ((run, loop, loop.P), "model has"),
        ((run.drop_vars("y"), loop, model), "trials have no"),
        ((run, ClosedLoop(loop.P), model), "loop = "),
        ((run.isel(channel=[0]), loop, model), "trials.channels = 1"),
        ((run.assign_attrs(Ts=2.0), loop, model), "is 2 s"),
    ):
        with pytest.raises(ValueError, match=message):
            estimated(*wrong)


def tall(seed, p, m, n=5):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return control.ss(A, B, C, 0, 0.5), rng


@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(0, 3))
def test_combinations_are_those_of_weighted_least_squares_at_rest(seed, m, more):
    P, rng = tall(seed, m + more, m)
    W = rng.uniform(0.2, 5, m + more)
    G, r = P.dcgain().reshape(m + more, m), rng.standard_normal(m + more)
    if np.linalg.cond(G) > 1e3:
        return
    for weights, root in ((None, np.ones(m + more)), (W, np.sqrt(W))):
        T, loop = combinations(P, weights)
        best = np.linalg.lstsq(root[:, None] * G, root * r, rcond=None)[0]
        np.testing.assert_allclose(T @ r, best, rtol=1e-6, atol=1e-8)  # as T P(1) = I
    omega = np.linspace(0, 6, 7)
    response, expected = loop.frequency_response(omega), frequency_response(P, omega)
    np.testing.assert_allclose(response[0], np.eye(m), atol=1e-9)
    np.testing.assert_allclose(response, T @ expected, rtol=1e-9, atol=1e-12)


WIDE, TALL = tall(0, 1, 2)[0], tall(0, 3, 2)[0]
REFUSALS = [  # P, weights, and what the error names
    (WIDE, None, "P has 1 outputs for 2 inputs"),
    (control.ss(0.5, [[1.0, 2.0]], [[1.0], [3.0]], 0, 1.0), None, "condition"),
    (TALL, [1.0, 0.0, 0.0], "condition"),
    (TALL, [1.0, 1.0], "weights has shape"),
    (TALL, [1.0, 1.0, -1.0], "weights reach -1"),
    (control.ss(1.1, 1, [[1.0], [1.0]], 0, 1.0), None, "P is unstable"),
    (control.ss(-1.0, 1, [[1.0], [1.0]], 0), None, "continuous time"),
]


@pytest.mark.parametrize(("P", "weights", "message"), REFUSALS)
def test_combinations_that_are_not_determined_are_refused(P, weights, message):
    with pytest.raises(ValueError, match=message):
        combinations(P, weights)


def test_the_best_input_for_more_outputs_than_inputs_is_that_of_a_dense_solution():
    P, rng = tall(3, 4, 2)
    samples, weight, e = 25, 1e-3, rng.standard_normal((25, 4))
    units = np.eye(samples * 2).reshape(-1, samples, 2)
    responses = [control.forced_response(P, inputs=u.T).outputs.T for u in units]
    G = np.reshape(responses, (len(units), -1)).T
    right = np.linalg.solve(G.T @ G + weight * np.eye(2 * samples), G.T @ e.ravel())
    u = NormOptimal(P, weight, samples).apply(e)
    np.testing.assert_allclose(u.ravel(), right, atol=1e-9)


def test_learning_on_combinations_comes_to_what_no_constant_input_betters():
    """Three sensors, two inputs, a controller that is not ours: the end of a trial at rest."""
    A = np.diag([0.9, 0.8, 0.6])
    B = [[0.1, 0.0], [0.05, 0.15], [0.0, 0.4]]
    C = [[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, 0.4, 1.0]]
    P = control.ss(A, B, C, 0, 1.0, inputs=["a", "b"], outputs=["x", "y", "z"])
    T, loop = combinations(P, [1.0, 2.0, 1.0])
    Q = zero_phase_butterworth(2, 0.5, 1.0)
    design = synthesise(loop, Q, order=10)
    assert design.sigma_M.max() <= 0.9 + 1e-9 and loop.references == ["a", "b"]
    r = np.minimum(np.arange(400)[:, None] / 100, 1) * [1.0, -0.5, 2.0]
    run = run_trials(loop, Law(Q, design.filter), r @ T.T, trials=8)
    w = (run.reference + run.v).values[-1]
    z = control.forced_response(P, inputs=w.T).outputs.T[200]
    root = np.sqrt([1.0, 2.0, 1.0])
    _, (least,), *_ = np.linalg.lstsq(root[:, None] * P.dcgain(), root * r[200])
    assert np.sum((root * (r[200] - z)) ** 2) == pytest.approx(least, rel=1e-3)
