"""Trials against python-control's simulation with the law written out, and what they promise."""

from itertools import pairwise

import control
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from plants import PUMPS, tanks
from rods import PRINTED as L

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    run_trials,
    trial_map,
    zero_phase_butterworth,
)
from ilctools.models import state_sequence
from ilctools.trials.rms import rms
from rodlib import Rod, midr
from rodlib.case import assumed_disturbance, assumed_reference

pytestmark = pytest.mark.filterwarnings("ignore:commands were", "ignore:the reference")
ZERO = np.zeros((50, 2))
PUSHED = ClosedLoop(control.ss(0.5, np.eye(1, 2), [[1], [0]], 0, 1.0), disturbances=["push"])


@given(st.integers(1, 6), st.integers(1, 70), st.integers(0, 2**32 - 1))
def test_state_sequence_is_the_recursion(n, samples, seed):
    rng = np.random.default_rng(seed)
    A, forcing = rng.uniform(-0.5, 0.5, (n, n)), rng.standard_normal((samples, n))
    x = np.ones(n)
    states = state_sequence(A, forcing, x)
    for p in range(samples):
        np.testing.assert_allclose(states[p], x, atol=1e-10)
        x = A @ x + forcing[p]


@pytest.mark.parametrize("another", [False, True])
def test_trials_follow_the_law_on_python_controls_simulation(loop, Q, another):
    """Around the model of the design, and around a rod of another order."""
    rod = loop.plant
    if another:
        rod = control.sample_system(midr(Rod(conductivity=60.0), 5), 1.0, "zoh")
    references = np.multiply.outer([1.0, 0.8, -0.5], assumed_reference(300))
    disturbance = assumed_disturbance(300, 3, 2)
    x, trials = 0.1 * np.ones(rod.nstates), (references, disturbance, 3)
    plant = rod if another else None
    run = run_trials(loop, Law(Q, L), *trials, plant=plant, initial_state=x)
    closed, start = loop.around(rod), np.concatenate([x, np.zeros(12)])
    np.testing.assert_array_equal(run.reference, references)
    np.testing.assert_array_equal(run.e, references - run.y)
    alone, v = rod[:, [*loop.controls, *loop.disturbances]], np.zeros((300, 2))
    for k, reference in enumerate(references):
        w = np.hstack([reference + v, disturbance[k]]).T
        y = control.forced_response(closed, inputs=w, initial_state=start).outputs.T
        np.testing.assert_allclose(run.y[k], y, atol=1e-9)
        flows = np.hstack([run.u[k], disturbance[k]]).T  # u is (18)
        y = control.forced_response(alone, inputs=flows, initial_state=x).outputs.T
        np.testing.assert_allclose(run.y[k], y, atol=1e-8)
        np.testing.assert_allclose(run.v[k], v, atol=1e-10)
        v = Q.apply(v + L.apply(reference - y))


def test_the_first_trial_may_begin_with_a_signal(loop, Q):
    """With that of a later trial it goes on from there; without learning it stays."""
    law, r = Law(Q, L, rest=5), assumed_reference(200)
    run = run_trials(loop, law, r, None, 4)
    later = run_trials(loop, law, r, None, 2, v=run.v.values[2])
    for name in ("v", "y", "u"):
        np.testing.assert_array_equal(later[name], run[name][2:])
    unlearned = run_trials(loop, Law(Q, None, rest=5), r, None, 2, v=np.ones((200, 2)))
    v = unlearned.v.values
    assert (v[:, :-5] == 1).all() and not v[:, -5:].any()


def test_rms_is_the_papers_definition():
    e = np.random.default_rng(2).standard_normal((1, 50, 2))
    expected = np.sqrt(sum(e[0, p] @ e[0, p] for p in range(50)) / 50)
    labelled = xr.DataArray(e, dims=("trial", "time", "channel"))
    assert rms(labelled).item() == pytest.approx(expected)
    log = xr.Dataset({"reference": 2 * labelled[0], "y": labelled})
    assert rms(log).item() == rms(labelled).item()
    with pytest.raises(ValueError, match="e has dimensions"):
        rms(labelled[:, :, 0])


def test_noise_initial_state_and_feedthrough_are_in_error_and_observer(loop, Q):
    x = np.random.default_rng(3).standard_normal(10)
    run = run_trials(loop, Law(Q, None), ZERO, None, 2, initial_state=x)
    np.testing.assert_allclose(run.y[:, 0], np.tile(loop.plant.C @ x, (2, 1)))
    np.testing.assert_allclose(run.u[:, 0], 0)
    pulse = np.zeros((50, 1))
    pulse[10] = 2.0
    noisy = run_trials(loop, Law(Q, L), ZERO, None, 1, noise=pulse[None] * [1, 1])
    np.testing.assert_allclose(noisy.y[0, :10], 0)
    np.testing.assert_allclose(noisy.e[0, 10], -2)
    np.testing.assert_allclose(noisy.delta[0, 11], loop.KL[10:] @ [2, 2])
    # A draught on the thermometer: seen at once, held by no state.
    plant = control.ss(0.9, [[0.1, 0.0]], 1, [[0.0, 1.0]], 1.0, inputs=["u", "draught"])
    draughty = current_trial_loop(plant, ["u"]), Law(Q, None), 0 * pulse
    run = run_trials(*draughty, pulse, 1)
    noisy = run_trials(*draughty, None, 1, noise=pulse[None])
    np.testing.assert_allclose(run.y, noisy.y, rtol=0, atol=1e-12)


@pytest.mark.parametrize("rest", [0, 15])
def test_v_rests_and_converges_as_the_finite_trials_map_says(loop, Q, rest):
    """v_{k+1} - v_k follows T of the certificate, which knows nothing of trials."""
    reference = np.random.default_rng(4).standard_normal((120, 2))
    v = run_trials(loop, Law(Q, L, rest=rest), reference, None, 5).v.values
    assert not v[:, 120 - rest :].any() and v[1:, 119 - rest].all()
    steps = np.diff(v.reshape(5, -1), axis=0)
    T, size = trial_map(loop.P, Q, L, 120, rest), np.abs(steps).max()
    for before, after in pairwise(steps):
        np.testing.assert_allclose(T.matvec(before), after, atol=1e-9 * size)


def test_units_and_names_are_in_the_dataset(loop, Q):
    run = run_trials(loop, Law(Q, L), ZERO, None, 2)
    for name in ("reference", "v", "y", "e"):
        assert run[name].dims == ("trial", "time", "channel") and run[name].units == "K"
    assert run.u.units == run.delta.units == "W"
    assert run.disturbance.dims == ("trial", "time", "source")
    assert run.disturbance.units == "theta_a: K, Q2: W, Q4: W"
    assert run.trial.values.tolist() == [1, 2] and run.time.units == "s"
    names = [run[kind].values.tolist() for kind in ("output", "control", "source")]
    assert names == [["y1", "y2"], ["Q1", "Q3"], ["theta_a", "Q2", "Q4"]]
    assert list(run.source_unit.values) == ["K", "W", "W"] and run.attrs == {"Ts": 1.0}


def test_another_plant_is_simulated_with_its_own_order_of_signals():
    """Tanks whose pipes leak as foreseen, in another order; the model has no such input."""
    loop = current_trial_loop(tanks(), PUMPS)
    law = Law(
        zero_phase_butterworth(2, 0.02, 2.0), LearningFilter(0.3 * np.eye(3)[:, :, None], 2.0)
    )
    rng = np.random.default_rng(8)
    reference, leak = rng.standard_normal((50, 3)), rng.standard_normal((50, 1))
    x = np.array([1.0, -2.0, 0.5])
    run = run_trials(loop, law, reference, leak, 3, initial_state=x)
    turned = tanks()[["right", "left", "middle"], ["leak", *PUMPS[::-1]]]
    again = run_trials(loop, law, reference, leak, 3, plant=turned, initial_state=x)
    xr.testing.assert_allclose(again, run, rtol=1e-9, atol=1e-12)
    dry = run_trials(loop, law, reference, leak, 3, plant=tanks()[:, PUMPS])
    still = run_trials(loop, law, reference, None, 3)
    np.testing.assert_allclose(dry.y, still.y, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reference": np.zeros((3, 50, 2))}, r"reference has shape \(3, 50, 2\)"),
        ({"disturbance": np.zeros((3, 50, 3))}, r"disturbance has shape \(3, 50, 3\)"),
        ({"noise": np.zeros((2, 50, 3))}, "noise has shape"),
        ({"initial_state": np.zeros(13)}, r"initial_state has shape \(13,\)"),
        ({"v": np.zeros((2, 50, 2))}, r"v has shape \(2, 50, 2\)"),
        ({"loop": PUSHED, "disturbance": np.ones((50, 1))}, "loop.P has no input for disturb"),
    ],
)
def test_bad_arguments_are_refused(loop, Q, changes, message):
    with pytest.raises(ValueError, match=message):
        run_trials(**{"loop": loop, "law": Law(Q, L), "reference": ZERO, "trials": 2} | changes)
