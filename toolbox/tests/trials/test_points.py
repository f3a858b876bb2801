"""Points in the place of paths: what is asked, and learned, at some samples alone."""

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from plants import RestartingModel, altered, as_matrix, bump, lag, lags, lifted, random_stable

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    load_law,
    load_log,
    record,
    replay,
    rms,
    run_trials,
    save_law,
    trial_norm,
    zero_phase_butterworth,
)
from ilctools.trials.points import filled

ALL = zero_phase_butterworth(1, 3.1, 1.0)  # which lets nearly everything pass


def points(samples, p, at, seed=0):
    """From rest to places at some samples, in turn in each of p outputs."""
    r = np.full((samples, p), np.nan)
    r[0] = 0
    for k, sample in enumerate(at):
        r[sample, k % p] = np.random.default_rng([seed, k]).uniform(-1, 1)
    return r


@pytest.mark.parametrize("seed", range(3))
def test_weights_of_errors_are_those_of_dense_algebra(seed):
    rng, samples = np.random.default_rng(seed), 40
    P = random_stable(seed, m=2, Ts=1.0)
    errors = rng.uniform(0, 1, (samples, 2)) * (rng.random((samples, 2)) < 0.4)
    L, P_N, W = NormOptimal(P, 0.05, samples, errors), lifted(P, samples), np.diag(errors.ravel())
    dense = np.linalg.solve(P_N.T @ W @ P_N + 0.05 * np.eye(2 * samples), P_N.T @ W)
    size = np.abs(dense).max()
    assert_allclose(as_matrix(L.apply, samples, 2), dense, rtol=0, atol=1e-10 * size)
    assert_allclose(as_matrix(L.apply_transposed, samples, 2), dense.T, rtol=0, atol=1e-10 * size)
    norm, *_ = trial_norm(P, ALL, L, samples)
    Q_N = as_matrix(ALL.apply, samples, 2)
    made, sizes, _ = np.linalg.svd(Q_N @ dense)
    made = made[:, : np.count_nonzero(sizes > 1e-10 * sizes[0])]  # what the law makes of errors
    assert norm == pytest.approx(np.linalg.norm((Q_N - Q_N @ dense @ P_N) @ made, 2), rel=1e-6)
    assert norm < 1


@pytest.mark.parametrize("P", [lag(0.8), lags(), random_stable(1, m=2, Ts=1.0)])
def test_points_are_reached_and_the_rest_is_free(P):
    """With less effort than along a path through the same points."""
    at, p = (20, 45, 60, 80, 99), P.noutputs
    r = points(120, p, at)
    law = Law(ALL, NormOptimal(P, 1e-5, 120))
    run = run_trials(ClosedLoop(P), law, r, trials=4)
    path, asked = filled(r)
    along = run_trials(ClosedLoop(P), law, path, trials=4)
    assert not run.e.values[:, asked == 0].any()
    assert np.abs(run.e[-1]).max() < 5e-3 * np.abs(run.e[0]).max()
    effort = [float(np.sum(trials.v[-1] ** 2)) for trials in (run, along)]
    assert effort[0] < effort[1]
    of_points = [e[mask > 0] for e, mask in zip(run.e[-1].values.T, asked.T, strict=True)]
    expected = np.sqrt(sum(np.mean(e**2) for e in of_points))
    assert_allclose([rms(run)[-1], rms(run.e)[-1]], [expected] * 2)


def test_a_rig_is_stopped_gone_on_with_and_replayed(tmp_path):
    P = control.ss(0.8, 0.3, 1, 0, 1.0, inputs=["w"], outputs=["x"])
    rig = RestartingModel(altered(P, B=0.8))
    r, loop, path = points(60, 1, (20, 50)), ClosedLoop(P), tmp_path / "log.csv"
    law = Law(ALL, NormOptimal(P, 1e-3, 60))
    whole = record(rig, loop, law, r, trials=4)
    record(rig, loop, law, r, trials=2, path=path)
    parts = record(rig, loop, law, r, trials=4, path=path)
    np.testing.assert_array_equal(parts.v, whole.v)
    read = load_log(path)
    np.testing.assert_array_equal(read.asked, whole.asked)
    assert_allclose(rms(read), rms(whole))
    assert "the recorded v agrees with the law in every trial" in str(replay(read))
    with pytest.raises(ValueError, match="another experiment, which differs in L, points"):
        record(rig, loop, law, filled(r)[0], trials=5, path=path)
    save_law(tmp_path / "law.json", Law(ALL, NormOptimal(P, 1e-3, 60, errors=whole.asked)))
    v, e = whole.v[1].values, whole.e[1].values
    again = load_law(tmp_path / "law.json").next(v, e)
    assert_allclose(again, whole.v[2].values, rtol=0, atol=1e-12)


def test_labels_stay_and_numbers_stand_between_points():
    r = points(9, 2, (4, 6))
    table = pd.DataFrame(r, columns=["b", "a"])
    array = xr.DataArray(r, dims=("time", "output"), coords={"output": ["b", "a"]})
    whole, asked = filled(r)
    assert_allclose(whole[:5, 0], np.arange(5) * r[4, 0] / 4)
    assert_allclose(whole[4:, 0], r[4, 0])
    for labelled in (table, array):
        values, mask = filled(labelled)
        np.testing.assert_array_equal(values, whole)
        np.testing.assert_array_equal(mask, asked)
        assert type(values) is type(labelled)
    assert filled(whole)[1] is None and filled("text") == ("text", None)


def test_what_points_need_is_said():
    P, r = lag(), points(40, 1, (20,))
    of_all, L = LearningFilter([[[0.5]]], 1.0), NormOptimal(P, 0.01, 40)
    for operator, reference, message in (
        (of_all, r, r"NaN at 95% .* L = NormOptimal\(P, weight, samples\)"),
        (L, r[1:], "reference begins with NaN"),
        (L, np.array([r, bump(40, [1.0])]), "NaN at the same samples of all trials"),
    ):
        with pytest.raises(ValueError, match=message):
            run_trials(ClosedLoop(P), Law(ALL, operator), reference, trials=2)
    for errors, message in ((np.zeros(40), "errors range from 0 to 0"), ([1.0], "has shape")):
        with pytest.raises(ValueError, match=message):
            NormOptimal(P, 0.01, 40, errors)
