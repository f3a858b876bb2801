"""The first trial of another task, against plants whose inverse is known, and on many others."""

import warnings
from functools import partial

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import PUMPS, altered, axes, lag, lags, tanks

from ilctools import (
    ClosedLoop,
    Law,
    NormOptimal,
    current_trial_loop,
    load_log,
    replay,
    run_trials,
    save_log,
    synthesise,
    transfer,
    zero_phase_butterworth,
)
from ilctools.law.notes import with_law
from ilctools.models import from_rest
from ilctools.trials.rms import rms
from ilctools.trials.transfer import ROUNDED_POWER, _Fits

pytestmark = pytest.mark.filterwarnings(
    "ignore:(v for|F predicts|the convergence rate|commands were)"
)
Q = zero_phase_butterworth(2, 1.0, 1.0)


def steps(samples, *moves):
    """One column for each (start, up, down, height) of the moves, as quintic steps, from rest."""
    t = np.arange(samples)[:, None] / samples
    start, up, down, height = np.array(moves).T

    def step(s):
        s = np.clip(s, 0, 1)
        return s**3 * (10 - 15 * s + 6 * s**2)

    return height * (step((t - start) / up) - step((t - 0.9 + down) / down))


def coupled(gain=1.0):
    """Two coupled first-order lags, whose inverse has two taps; of any gain at frequency zero."""
    A, B = np.array([[0.6, 0.1], [0.0, 0.5]]), gain * np.array([[0.5, 0.1], [0.2, 0.4]])
    return control.ss(A, B, np.eye(2), 0, 1.0), A, B


OLD = steps(200, (0.1, 0.2, 0.2, 2.0), (0.25, 0.15, 0.3, -1.0))
NEW = steps(200, (0.2, 0.3, 0.2, -1.5), (0.1, 0.2, 0.25, 3.0))


def trials_of(loop, weight=1e-2, trials=5, reference=OLD, **more):
    law = Law(Q, NormOptimal(loop.P, weight, len(reference)))
    return run_trials(loop, law, reference, trials=trials, **more)


@settings(max_examples=4)
@given(st.floats(0.5, 2.0), st.integers(2, 4), st.integers(0, 2**32 - 1))
def test_of_a_plant_whose_inverse_is_short_f_is_that_inverse(gain, trials, seed):
    P, A, B = coupled(gain)
    v = np.random.default_rng(seed).standard_normal((200, 2))
    v[-30:] = 0  # or it matters what would come after the trial
    result = transfer(trials_of(ClosedLoop(P), 1.0, trials, v=v), NEW)
    inverse = np.linalg.inv(B)  # P^-1 = B^-1 (q - A)
    R = result.F.shape[2] // 2
    expected = np.zeros_like(result.F)
    expected[..., R - 1], expected[..., R] = inverse, -inverse @ A - np.eye(2)
    np.testing.assert_allclose(result.F, expected, atol=1e-4 * np.abs(expected).max())
    run = run_trials(ClosedLoop(P), Law(Q, None), NEW, trials=1, v=result.v)
    assert rms(run.e).item() < 1e-3 * np.abs(NEW).max()
    assert result.predicted.min() > 1 - 1e-6


@pytest.mark.parametrize("repeats", [0.0, 1.0])
def test_one_task_distinguishes_a_repeating_disturbance_from_the_reference(repeats):
    P = coupled()[0]
    answered = repeats * steps(200, (0.3, 0.1, 0.2, 0.7), (0.2, 0.3, 0.1, -0.9))
    came = np.broadcast_to(from_rest(P, -answered), (6, 200, 2))
    trials = trials_of(ClosedLoop(P), trials=6, noise=came)
    result = transfer(trials, NEW)
    np.testing.assert_allclose(result.compensation, answered, atol=0.05)
    assert np.abs(NEW - from_rest(P, NEW + result.v - answered)).max() < 0.1
    np.testing.assert_allclose(result.v, result.feedforward + result.compensation)
    alone = transfer(trials.isel(trial=[-1]), NEW)
    assert not alone.compensation.any()
    assert alone.uncertainty.min() > 0.5 * np.sqrt(np.mean(NEW**2))
    with pytest.warns(UserWarning, match="distinguish"):
        transfer(trials.isel(trial=-1), -OLD)


def test_the_uncertainty_is_of_the_size_of_the_error():
    """Of three tanks in one noisy task; with what a disturbance might add, and so larger."""
    loop, plant = current_trial_loop(tanks(), PUMPS), altered(tanks(), B=0.85)
    old = steps(400, (0.05, 0.3, 0.3, 5.0), (0.1, 0.4, 0.2, 3.0), (0.2, 0.3, 0.4, -4.0))
    new = steps(400, (0.1, 0.2, 0.3, 3.0), (0.3, 0.2, 0.15, 4.0), (0.1, 0.3, 0.2, 2.0))
    law = Law(zero_phase_butterworth(2, 0.15, 2.0), NormOptimal(loop.P, 1e-2, 400))
    run = partial(run_trials, loop, law, plant=plant)
    best = run(new, trials=20).v.values[-1]
    noise, ratios = 0.02 * np.random.default_rng(0).standard_normal((2, 4, 400, 3)), []
    for white in noise:
        transferred = transfer(run(old, trials=4, noise=white), new)
        off = law.Q.apply(transferred.v - best)[:-20]
        ratios.append(np.sqrt(np.mean(off**2, axis=0)) / transferred.uncertainty)
    assert 0.1 < np.median(ratios) < 2
    # Where a disturbance is seen, the jackknife alone: the fit by differences is off by 0.0003.
    trials = run(old, 5 * np.sin(np.arange(400) / 30)[:, None], 4, noise=noise[0])
    assert transfer(trials, new).uncertainty.min() > 0.01


def test_it_takes_logs_parts_of_them_and_references_of_any_length(tmp_path):
    loop = current_trial_loop(coupled()[0], ["u[0]", "u[1]"])
    trials = trials_of(loop)
    save_log(trials, tmp_path / "log.csv")
    expected = transfer(trials, NEW)
    several = [trials.isel(trial=[0, 1]), trials.isel(trial=[2, 3, 4], channel=[1, 0])]
    for same in (load_log(tmp_path / "log.csv"), several):  # by names
        np.testing.assert_allclose(transfer(same, NEW).v, expected.v, atol=1e-9)
    longer = transfer(trials, np.vstack([NEW, np.zeros((50, 2))]))
    np.testing.assert_allclose(longer.feedforward[:100], expected.feedforward[:100], atol=1e-3)
    assert not longer.compensation[200:].any()
    still = (0 * trials).assign_attrs(trials.attrs)
    assert not transfer(still, NEW).v.any()


def test_a_disturbance_that_came_in_between_is_reported():
    came = np.zeros((8, 200, 2))
    came[4:] = steps(200, (0.3, 0.1, 0.2, 2.0), (0.2, 0.3, 0.1, -3.0))
    done = trials_of(ClosedLoop(coupled()[0]), 1.0, 8, noise=came)
    with pytest.warns(UserWarning, match="another disturbance came") as seen:
        transfer(done, NEW)
    assert seen[0].filename == __file__
    assert transfer(done.isel(trial=slice(4, None)), NEW).predicted.min() > 0.9


def test_units_do_not_matter():
    v, scale = np.random.default_rng(0).standard_normal((200, 2)), np.array([1e3, 1e-4])
    run = run_trials(ClosedLoop(coupled()[0]), Law(Q, None), OLD, trials=1, v=v)
    other = run.assign({name: scale * run[name] for name in ("v", "y", "reference")})
    P = coupled(1.2)[0]
    scaled = control.ss(P.A, P.B / scale, (P.C.T * scale).T, 0, 1.0)
    for models in ((None, None), (P, scaled)):
        here, there = transfer(run, NEW, models[0]), transfer(other, NEW * scale, models[1])
        np.testing.assert_allclose(there.v, here.v * scale, rtol=1e-6, atol=1e-6)


def test_what_does_not_belong_together_is_refused():
    done = trials_of(ClosedLoop(coupled()[0]), trials=2)
    other = done.assign_attrs(Ts=0.5)
    for trials, words in (
        ([done, other], "Ts"),
        ([done, done.isel(time=slice(100))], "trials.v has shape"),
        (done.drop_vars("y"), "trials lack"),
        (done.assign_attrs(reset="none"), "or a reset before each"),
    ):
        with pytest.raises(ValueError, match=words):
            transfer(trials, NEW)
    with pytest.raises(ValueError, match="reference has shape"):
        transfer(done, NEW[:, :1])


def test_trials_that_differ_by_noise_alone_leave_v_uncertain():
    task = ClosedLoop(coupled()[0]), Law(Q, None), OLD
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, 1, 200, 2))
    trials = [run_trials(*task, trials=1, noise=white) for white in noise]
    with pytest.warns(UserWarning, match="may be wrong by") as seen:
        assert len(repr(transfer(trials, -OLD))) < 200
    assert len(seen) == 2  # one for each output


@pytest.mark.parametrize("seed", range(10))
def test_what_a_fit_misses_below_rounding_makes_it_no_more_likely(seed):
    """Targets that the regressors give exactly: all fits that miss less than rounding are level.

    A fit with the weight w misses some w of a target, w^2 of its power, and rounding leaves some
    ten EPS of the power. With a floor of ROUNDED_POWER the logarithm differs by no more than their
    ratio.
    """
    rng = np.random.default_rng(seed)
    Phi, f = rng.standard_normal((3, 200, 4)), rng.standard_normal((4, 1))
    fits = _Fits(Phi, Phi @ f)
    faint = [fits.likelihood(1.0, 1.0, 1.0, weight)[0] for weight in (1e-9, 1e-10)]
    assert abs(np.diff(faint)) < len(Phi) * 10 * np.finfo(float).eps / ROUNDED_POWER
    strong = fits.likelihood(1.0, 1.0, 1.0, 1e-3)[0]
    assert strong < min(faint) - 10  # which misses 1e-6 of the power, far above rounding


def pulse(share):
    """A move that takes a share of a trial of 150 samples."""
    return np.sin(np.pi * np.clip((np.arange(150) / 150 - 0.1) / share, 0, 1)) ** 4


@pytest.mark.parametrize("P", [lag(0.8), lags(), axes()])
def test_between_trials_v_is_predicted_where_the_reference_changes(P, tmp_path):
    """The plant is 12 % stronger, and there is noise: from trial 2 on hardly more is left."""
    p, rng = P.noutputs, np.random.default_rng(0)
    r = np.array(
        [np.outer(pulse(rng.uniform(0.4, 0.8)), rng.uniform(0.5, 1.5, p)) for _ in range(5)]
    )
    loop, law, noise = ClosedLoop(P), synthesise(P).law(rest=4), 1e-3 * rng.normal(size=r.shape)
    task = {"trials": 5, "plant": altered(P, B=1.12), "noise": noise}
    with warnings.catch_warnings(action="ignore"):
        kept, predicted = (
            run_trials(loop, law, r, **task, between=between) for between in ("law", "transfer")
        )
        save_log(with_law(predicted, law.bound_to(loop)), tmp_path / "a.csv")
        replayed = replay(load_log(tmp_path / "a.csv"))
    assert not predicted.v[:, -4:].any()
    assert rms(predicted)[1] < 8e-3 < 0.1 * min(rms(predicted)[0], rms(kept)[1])
    assert rms(predicted)[2:].max() < 3e-3 * np.sqrt(p) < rms(kept)[2:].max()
    assert "the recorded v agrees with the law in every trial" in str(replayed)


@pytest.mark.parametrize("P", [lags(), axes()])
@pytest.mark.parametrize("seed", range(3))
def test_with_a_model_one_trial_says_more_and_a_wrong_model_does_no_harm(P, seed):
    """The plant has other gains, coupled ones among them; a new task of another length."""
    rng = np.random.default_rng(seed)
    *old, new = (np.outer(pulse(x), rng.uniform(0.5, 1.5, 2)) for x in (0.5, 0.7, 0.5, 0.6))
    old, new = np.array(old), np.pad(new, [(0, 30), (0, 0)])
    plant = P * (np.eye(2) + 0.05 * rng.standard_normal((2, 2)))
    loop, law = ClosedLoop(P), Law(zero_phase_butterworth(2, 1 / P.dt, P.dt), None)

    def left(trials, model):
        done = run_trials(loop, law, old[:trials], trials=trials, plant=plant, noise=noise[:trials])
        v = transfer(done, new, model).v
        return rms(run_trials(loop, law, new, trials=1, plant=plant, v=v)).item()

    noise = 1e-4 * rng.standard_normal((3, 150, 2))
    assert left(1, loop) < 0.5 * left(1, None)
    far_off = P * np.array([[1.5, 0.3], [-0.3, 0.7]])
    assert left(3, far_off) < max(2 * left(3, None), 1e-3)


def test_a_model_that_does_not_belong_to_the_trials_is_refused():
    done = trials_of(ClosedLoop(coupled()[0]), trials=2)
    for model, words in (
        (lag(), "model has 1 outputs and 1 inputs, but the trials have 2 outputs"),
        (ClosedLoop(Ts=1.0, outputs=["y1", "y2"]), "model is a loop without P"),
        (control.ss(np.eye(2), np.eye(2), np.eye(2), 0, 1.0), "model"),
        (control.ss([], [], [], np.eye(2), 0.5), "Ts"),
    ):
        with pytest.raises(ValueError, match=words):
            transfer(done, NEW, model)


def test_what_transfer_between_trials_needs_is_said():
    loop, r = ClosedLoop(lag()), np.zeros((50, 1))
    law = synthesise(lag()).law()
    with pytest.raises(ValueError, match="between = 'next' must be 'law' or 'transfer'"):
        run_trials(loop, law, r, between="next")
    torque = control.ss(0.8, [[0.1, 0.2]], 1, 0, 1.0, inputs=["w", "F"], outputs=["x"])
    beside = ClosedLoop(torque, references={"w": "x"}, learned=["F"])
    with pytest.raises(ValueError, match="between = 'transfer' needs a v that is added"):
        run_trials(beside, synthesise(beside).law(), r, between="transfer")
