from itertools import pairwise

import control
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from plants import furnace, stage, tanks

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    Rod,
    current_trial_loop,
    midr,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.ilc import trial_map
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.trials.run import rms, state_sequence
from rodlib.paper import published


@pytest.fixture(scope="module")
def L():
    return LearningFilter(published.matrix("L_diagonal"), 1.0)


@given(st.integers(1, 6), st.integers(1, 70), st.integers(0, 2**32 - 1))
def test_state_sequence_is_the_recursion(n, samples, seed):
    rng = np.random.default_rng(seed)
    A, forcing, x = (
        rng.uniform(-0.5, 0.5, (n, n)),
        rng.standard_normal((samples, n)),
        np.ones(n),
    )
    states = state_sequence(A, forcing, x)
    for p in range(samples):
        np.testing.assert_allclose(states[p], x, atol=1e-10)
        x = A @ x + forcing[p]


def test_one_trial_agrees_with_python_controls_forced_response(loop, Q, L):
    rng = np.random.default_rng(0)
    reference, disturbance = (
        rng.standard_normal((300, 2)),
        rng.standard_normal((300, 3)),
    )
    run = run_trials(loop, Law(Q, L), reference, disturbance, 1)
    inputs = np.hstack([reference, disturbance]).T
    response = control.forced_response(loop.closed, inputs=inputs)
    np.testing.assert_allclose(run.y[0], response.outputs.T, atol=1e-9)
    plant_inputs = np.hstack([run.u.values[0], disturbance]).T
    plant = control.forced_response(loop.plant, inputs=plant_inputs)
    np.testing.assert_allclose(plant.outputs.T, run.y[0], atol=1e-8)  # u is (18)


def test_trials_follow_the_ilc_law_written_out(loop, Q, L):
    reference, disturbance = assumed_reference(400), assumed_disturbance(400, 3, 2)
    run = run_trials(loop, Law(Q, L), reference, disturbance, 3)
    v = np.zeros((400, 2))
    for k in range(3):
        np.testing.assert_allclose(run.v[k], v, atol=1e-10)
        w = np.hstack([reference + v, disturbance[k]])
        e = reference - control.forced_response(loop.closed, inputs=w.T).outputs.T
        np.testing.assert_allclose(run.e[k], e, atol=1e-9)
        v = Q.apply(v + L.apply(e))


def test_a_sinusoid_is_learned_at_the_rate_of_its_frequency(loop, Q, L):
    """In the middle of a long trial the error obeys E_{k+1} = M E_k + constant (36)."""
    omega = 2 * np.pi * 8 / 2000
    wave = np.sin(omega * np.arange(8000))[:, None] * np.array([1.0, 0.0])
    run = run_trials(loop, Law(Q, L), wave, None, 4)
    steps = np.diff(run.e.values[:, 3000:5000], axis=0)
    phasors = steps.transpose(0, 2, 1) @ np.exp(-1j * omega * np.arange(2000))
    grid = np.array([omega])
    M = convergence_matrix(
        loop.frequency_response(grid),
        Q.frequency_response(grid),
        L.frequency_response(grid),
    )
    np.testing.assert_allclose(
        phasors[1], M[0] @ phasors[0], atol=1e-3 * abs(phasors[0]).max()
    )
    np.testing.assert_allclose(
        phasors[2], M[0] @ phasors[1], atol=1e-3 * abs(phasors[1]).max()
    )


def test_errors_converge_at_least_as_fast_as_lemma_1_says(loop, Q, L, omega):
    M = convergence_matrix(
        loop.frequency_response(omega),
        Q.frequency_response(omega),
        L.frequency_response(omega),
    )
    gamma = largest_singular_values(M).max()
    run = run_trials(loop, Law(Q, L), assumed_reference(), None, 80)
    distance = np.sqrt(((run.e - run.e[-1]) ** 2).sum(["time", "channel"])).values[:25]
    assert np.all(distance[1:] <= gamma * distance[:-1])


def test_each_trial_may_have_its_own_reference(loop, Q, L):
    rng = np.random.default_rng(11)
    references, noise = rng.standard_normal((2, 3, 60, 2))
    run = run_trials(loop, Law(Q, L), references, None, 3, noise=noise)
    np.testing.assert_array_equal(run.reference, references)
    np.testing.assert_array_equal(run.e, references - run.y.values)
    for k in range(1, 3):
        v = Law(Q, L).next(run.v.values[k - 1], run.e.values[k - 1])
        np.testing.assert_allclose(run.v[k], v)
    for k, w in enumerate(
        references + run.v.values
    ):  # what the loop follows in this trial
        alone = run_trials(loop, Law(Q, None), w, None, 1, noise=noise[[k]])
        np.testing.assert_allclose(run.y[k], alone.y[0], atol=1e-12)
    same = run_trials(
        loop, Law(Q, L), np.broadcast_to(references[0], (3, 60, 2)), None, 3
    )
    np.testing.assert_array_equal(
        same.y, run_trials(loop, Law(Q, L), references[0], None, 3).y
    )
    with pytest.raises(
        ValueError, match=r"shape \(3, 60, 2\), but must have shape \(4, time"
    ):
        run_trials(loop, Law(Q, L), references, None, 4)


def test_the_first_trial_may_begin_with_a_signal(loop, Q, L):
    """With that of a later trial it goes on from there; without learning it stays."""
    r, rest = assumed_reference(200), 5
    run = run_trials(loop, Law(Q, L, rest=rest), r, None, 4)
    for name in ("v", "y", "u"):
        later = run_trials(loop, Law(Q, L, rest=rest), r, None, 2, v=run.v.values[2])
        np.testing.assert_array_equal(later[name], run[name][2:])
    kept = run_trials(
        loop, Law(Q, None, rest=rest), r, None, 2, v=np.ones((200, 2))
    ).v.values
    assert (kept[:, :-rest] == 1).all() and not kept[:, -rest:].any()
    with pytest.raises(
        ValueError, match=r"v has shape \(4, 200, 2\), but must have shape"
    ):
        run_trials(loop, Law(Q, L), r, v=run.v.values)


def test_rms_is_the_papers_definition():
    e = np.random.default_rng(2).standard_normal((1, 50, 2))
    expected = np.sqrt(sum(e[0, p] @ e[0, p] for p in range(50)) / 50)
    assert rms(
        xr.DataArray(e, dims=("trial", "time", "channel"))
    ).item() == pytest.approx(expected)


def test_the_sensors_noise_reaches_error_and_observer(loop, Q, L):
    noise = np.zeros((1, 40, 2))
    noise[0, 10] = 1.0
    run = run_trials(loop, Law(Q, L), np.zeros((40, 2)), None, 1, noise=noise)
    np.testing.assert_allclose(run.y[0, :10], 0)
    np.testing.assert_allclose(run.e[0, 10], -1)
    np.testing.assert_allclose(run.delta[0, 11], loop.KL[10:] @ [1, 1])


def test_initial_state_is_that_of_the_plant(loop, Q):
    x = np.random.default_rng(3).standard_normal(10)
    run = run_trials(loop, Law(Q, None), np.zeros((5, 2)), None, 2, initial_state=x)
    np.testing.assert_allclose(run.y[:, 0], np.tile(loop.plant.C @ x, (2, 1)))
    np.testing.assert_allclose(run.u[:, 0], 0)


@pytest.mark.parametrize("limits", [None, {"Q1": (-5.0, 5.0)}])
@pytest.mark.parametrize("controller", ["ours", "on the rig"])
def test_without_reset_trials_are_one_long_simulation(loop, Q, limits, controller):
    """Plant and observer go on; only python-control's, or one long trial's, states count."""
    rng = np.random.default_rng(12)
    references, noise = rng.standard_normal((2, 3, 60, 2))
    if controller == "on the rig":
        loop = ClosedLoop(loop.P)
        limits = limits and {"w1": limits["Q1"]}
    disturbance = rng.standard_normal((3, 60, len(loop.disturbances)))
    x = rng.standard_normal(loop.P.nstates)
    law = Law(Q, None, limits=limits)
    parts = run_trials(
        loop, law, references, disturbance, 3, noise=noise, initial_state=x, reset=False
    )
    whole = run_trials(
        loop, law, references.reshape(180, 2), disturbance.reshape(180, -1), 1,
        noise=noise.reshape(1, 180, 2), initial_state=x,
    )  # fmt: skip
    np.testing.assert_allclose(parts.y.values.reshape(180, 2), whole.y[0], atol=1e-9)
    apart = run_trials(loop, law, references, disturbance, 3, noise=noise)
    assert np.abs(apart.y[1:] - parts.y[1:]).max() > 0.01


@pytest.mark.parametrize("rest", [0, 1, 15])
def test_v_rests_and_converges_as_the_finite_trials_map_says(loop, Q, L, rest):
    """v_{k+1} - v_k follows T of the certificate, which knows nothing of trials."""
    rng = np.random.default_rng(4)
    run = run_trials(loop, Law(Q, L, rest=rest), rng.standard_normal((120, 2)), None, 5)
    assert (
        not run.v.values[:, 120 - rest :].any() and run.v.values[1:, : 120 - rest].any()
    )
    steps = np.diff(run.v.values.reshape(5, -1), axis=0)
    T = trial_map(loop.P, Q, L, 120, rest)
    for before, after in pairwise(steps):
        np.testing.assert_allclose(
            T.matvec(before), after, atol=1e-9 * np.abs(steps).max()
        )


def test_units_and_names_are_in_the_dataset(loop, Q, L):
    run = run_trials(loop, Law(Q, L), np.zeros((20, 2)), None, 2)
    for name in ("reference", "v", "y", "e"):
        assert run[name].dims == ("trial", "time", "channel") and run[name].units == "K"
    assert run.u.units == run.delta.units == "W"
    assert run.disturbance.dims == ("trial", "time", "source")
    assert run.disturbance.units == "theta_a: K, Q2: W, Q4: W"
    assert list(run.trial.values) == [1, 2] and run.time.units == "s"
    names = {kind: list(run[kind].values) for kind in ("output", "control", "source")}
    assert names == {
        "output": ["y1", "y2"], "control": ["Q1", "Q3"], "source": ["theta_a", "Q2", "Q4"],
    }  # fmt: skip
    assert list(run.source_unit.values) == ["K", "W", "W"] and run.attrs == {"Ts": 1.0}


def there_and_back(samples, amplitude):
    """Smooth, from rest to `amplitude` and back to rest, shape (time, channel)."""
    phase = np.arange(samples) / samples
    rise, fall = (np.clip((phase - start) / 0.3, 0, 1) for start in (0.1, 0.55))
    smooth = [s**3 * (10 - 15 * s + 6 * s**2) for s in (rise, fall)]
    return (smooth[0] - smooth[1])[:, None] * np.asarray(amplitude)


PUMPS = ["pump A", "pump B", "pump C"]
OTHERS = {
    "stage": (stage(), ["F"], {"x": 5.0, "F": 20.0}, [5.0], 10),
    "tanks": (tanks(), PUMPS, dict.fromkeys(PUMPS, 20.0), [10.0, 5.0, 8.0], 10),
    "furnace": (furnace(), None, {"valve": 0.1}, [3.0], 40),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_from_a_plant_that_is_not_the_papers_to_converged_trials(name):
    plant, controls, sizes, amplitude, order = OTHERS[name]
    loop = current_trial_loop(plant, controls, sizes)
    cutoff = 0.05 / loop.Ts
    grid = np.geomspace(1e-3, np.pi, 100) / loop.Ts
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    band = (grid[0], cutoff / 3)
    L = synthesise(loop, Q, grid, loop.Ts, order=order, band=band).filter
    reference = there_and_back(600, amplitude)
    push = np.full((600, len(loop.disturbances)), 0.1)  # the same in every trial
    run = run_trials(loop, Law(Q, L), reference, push, 8)
    measure = rms(run.e).values
    assert measure[-1] < measure[0] / 10 and measure[-1] < 0.02 * max(amplitude)
    assert abs(measure[-1] - measure[-2]) < 1e-3 * measure[0]
    assert list(run.output.values) == plant.output_labels
    assert list(run.control.values) == loop.controls


def test_another_plant_is_simulated_with_its_own_state_and_disturbances():
    """Tanks whose pipes leak as foreseen, in another order; the model has no such input."""
    without_leak = tanks()[:, PUMPS]
    loop = current_trial_loop(tanks(), PUMPS)
    Q, L = (
        zero_phase_butterworth(2, 0.02, 2.0),
        LearningFilter(0.3 * np.eye(3)[:, :, None], 2.0),
    )
    rng = np.random.default_rng(8)
    reference, leak = rng.standard_normal((50, 3)), rng.standard_normal((50, 1))
    x = np.array([1.0, -2.0, 0.5])
    own = run_trials(loop, Law(Q, L), reference, leak, 3, initial_state=x)
    for plant in (
        tanks(),
        tanks()[["right", "left", "middle"], ["leak", *PUMPS[::-1]]],
    ):
        again = run_trials(
            loop, Law(Q, L), reference, leak, 3, plant=plant, initial_state=x
        )
        xr.testing.assert_allclose(again, own, rtol=1e-9, atol=1e-12)
    dry = run_trials(loop, Law(Q, L), reference, leak, 3, plant=without_leak)
    xr.testing.assert_allclose(
        dry.drop_vars("disturbance"),
        run_trials(loop, Law(Q, L), reference, None, 3).drop_vars("disturbance"),
        rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    assert np.array_equal(dry.disturbance[0], leak)


def test_the_controller_learns_on_a_plant_of_another_order(loop, Q, L):
    """Against python-control's simulation, with the law written out."""
    rod = control.sample_system(midr(Rod(conductivity=60.0), 5), 1.0, method="zoh")
    reference, disturbance = assumed_reference(300), assumed_disturbance(300, 2, 1)
    x = 0.1 * np.ones(rod.nstates)
    run = run_trials(
        loop, Law(Q, L), reference, disturbance, 2, plant=rod, initial_state=x
    )
    start = np.concatenate([x, np.zeros(12)])
    v = np.zeros((300, 2))
    for k in range(2):
        inputs = np.hstack([reference + v, disturbance[k]]).T
        y = control.forced_response(
            loop.around(rod), inputs=inputs, initial_state=start
        ).outputs.T
        np.testing.assert_allclose(run.y[k], y, rtol=0, atol=1e-9)
        flows = np.hstack([run.u[k], disturbance[k]])
        names = [*loop.controls, *loop.disturbances]
        alone = control.forced_response(
            rod[:, names], inputs=flows.T, initial_state=x
        ).outputs.T
        np.testing.assert_allclose(
            y, alone, rtol=0, atol=1e-8
        )  # u is what the plant was given
        v = Q.apply(v + L.apply(reference - y))
    assert (
        np.abs(run.y - run_trials(loop, Law(Q, L), reference, disturbance, 2).y).max()
        > 0.1
    )


def test_feedthrough_of_a_disturbance_is_in_the_output():
    """A draught on the thermometer: seen at once, held by no state."""
    plant = control.ss(0.9, [[0.1, 0.0]], 1, [[0.0, 1.0]], 1.0, inputs=["u", "draught"])
    loop = current_trial_loop(plant, ["u"])
    pulse = np.zeros((30, 1))
    pulse[4] = 2.0
    run = run_trials(
        loop, Law(zero_phase_butterworth(), None), np.zeros((30, 1)), pulse, 1
    )
    assert run.y[0, 4, 0] == 2.0 and not run.y[0, :4].any() and not run.u[0, :5].any()
    np.testing.assert_allclose(run.delta[0, 5], 2 * loop.KL[1:, 0])
    sensor = np.zeros((1, 30, 1))
    sensor[0, 4] = 2.0
    noisy = run_trials(
        loop,
        Law(zero_phase_butterworth(), None),
        np.zeros((30, 1)),
        None,
        1,
        noise=sensor,
    )
    np.testing.assert_allclose(run.y, noisy.y, rtol=0, atol=1e-12)


def test_a_plant_that_the_controller_does_not_hold_is_refused(loop, Q, L):
    crossed = control.sample_system(midr(Rod(sensors=(0.28, 0.12))), 1.0, method="zoh")
    with pytest.raises(
        ValueError, match="plant makes the loop unstable: a pole at z = "
    ):
        run_trials(loop, Law(Q, L), np.zeros((20, 2)), plant=crossed)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"reference": np.zeros((50, 3))},
            r"reference has shape \(50, 3\).*\(time, 2\)",
        ),
        (
            {"disturbance": np.zeros((50, 2))},
            r"disturbance has shape \(50, 2\).*\(50, 3\)",
        ),
        ({"disturbance": np.zeros((3, 50, 3))}, r"disturbance has shape \(3, 50, 3\)"),
        ({"noise": np.zeros((2, 50, 3))}, "noise has shape"),
        ({"initial_state": np.zeros(13)}, r"initial_state has shape \(13,\)"),
    ],
)
def test_bad_arguments_are_refused(loop, Q, L, arguments, message):
    arguments = {"reference": np.zeros((50, 2)), "trials": 2} | arguments
    with pytest.raises(ValueError, match=message):
        run_trials(loop, Law(Q, L), **arguments)
