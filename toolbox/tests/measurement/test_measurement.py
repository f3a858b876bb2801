"""The door: units, and known disturbances, which are inputs of an estimate beside those of P."""

import numpy as np
import pandas as pd
import pytest
from plants import lag, lags
from records import answer, covers, held, log_of
from scipy.signal import lfilter

from ilctools import load_log, measured_response, read_table, save_log
from ilctools.errors import LogError
from ilctools.signals import dataset

pytestmark = pytest.mark.filterwarnings("ignore:.* may not settle")  # the records are short


def record_of(seed, m=1, size=1.0):
    """A log under steps of the reference, while others switch a heater, and the air drifts.

    It is short: the time of an estimate grows as the cube of its lags and inputs.
    """
    rng, N = np.random.default_rng(seed), 100
    w = 2 * np.stack([held(rng, N, samples=n) for n in (15, 21)])[:m]
    heater = 60.0 * np.repeat(rng.integers(0, 2, 20), 18)[:N]
    air = 20 + np.sin(2 * np.pi * (np.arange(N) / 100 + rng.uniform()))
    air = air + 0.02 * np.cumsum(rng.standard_normal(N))
    y = answer(lags()[:m, :m], w - w[:, :1]) + 0.02 * rng.standard_normal(w.shape)
    y = y + size * lfilter([0, 0.006], [1, -0.8], heater - heater[0])
    y = y + size * lfilter([0, 0.1], [1, -0.9], air - air[0])
    reference, y, known = (signal.T[None] for signal in (w, y, np.stack([heater, air])))
    names = ["T1", "T2"][:m], [], ["heater", "air"]
    return dataset(1.0, *names, {}, reference=reference, v=0 * y, y=y, disturbance=known)


def replaced(log, heater):
    """The log with another signal of the heater, (trial, time)."""
    known = log.disturbance.values.copy()
    known[..., 0] = heater
    return log.assign(disturbance=(log.disturbance.dims, known))


def same(one, other):
    """Whether two estimates are the same numbers."""
    return np.array_equal(one.response, other.response) and np.array_equal(
        one.radius(), other.radius()
    )


def test_a_heater_and_the_air_are_no_noise():
    """The truth is within the joint radius of 99 %: `make measure WHAT=regions` counts 200 draws.

    The radius is less than half of that which the same log has without them.
    """
    for seed in range(2):
        log = record_of(seed, m=2)
        estimate, bare = measured_response(log), measured_response(log.drop_vars("disturbance"))
        assert covers(estimate, lags())
        assert np.median(estimate.radius() / bare.radius()) < 1 / 2
        assert "the known disturbances heater, air, other" in str(estimate) and "known" not in str(
            bare
        )


def test_it_is_the_estimate_of_a_plant_with_more_inputs():
    """Without a reference commands and disturbances are treated alike: P is a block of it."""
    rng = np.random.default_rng(0)
    u = held(rng, 4, 120)
    y = answer(lags(), u[:2]) + answer(lags(0.5), u[2:]) + 0.01 * rng.standard_normal((2, 120))
    whole, part = measured_response(log_of(u, y)), measured_response(log_of(u[:2], y, d=u[2:]))
    np.testing.assert_allclose(part.response, whole.response[..., :2], rtol=1e-7)
    assert np.all(part.radius() < whole.radius())
    for fit, own in zip(whole.fits, part.fits, strict=True):
        (S, of_A), (own_S, of_own_A) = (one.covariance(np.array([0.01, 0.3])) for one in (fit, own))
        kept = np.ix_([0, 1], [0, 1, 4, 5], [0, 1, 4, 5])  # the real parts stand first
        atol = 1e-6 * np.abs(own_S).max()  # the units of the inputs are those of all moves in both
        np.testing.assert_allclose(own_S, S[kept], rtol=1e-5, atol=atol)
        np.testing.assert_allclose(of_own_A, of_A, rtol=1e-5)
    assert part.model().ninputs == 2 and covers(part, part.model())


def test_a_disturbance_that_rests_in_each_trial_adds_nothing():
    """Also but for rounding, and if it rests elsewhere in the next trial."""
    log = record_of(0, size=0.0)  # nothing but w moves y
    bare = log.drop_vars("disturbance")
    rest = 21.3 + 0 * log.disturbance + 1e-13 * np.sin(np.arange(100))[None, :, None]
    rests = log.assign(disturbance=rest)
    estimate, plain = measured_response(rests), measured_response(bare)
    assert same(estimate, plain) and str(estimate) == str(plain)
    twice = [rests, log.assign(disturbance=rest + 3)]
    assert same(measured_response(twice), measured_response([bare, bare]))
    some = measured_response(replaced(log, 21.3))  # the air moves
    assert "the known disturbances air, other" in str(some)


def test_a_disturbance_that_is_an_input_is_refused():
    """Nothing shows which of both moved y: so the radius is as large as P."""
    log = record_of(0, m=2)
    w = log.reference.values
    heater = np.round(7 - 3 * w[..., 0] - 0.1 * w[..., -1], 5)  # as a log of few digits has it
    with pytest.raises(LogError, match="moved alike, or as heater, air did"):
        measured_response(replaced(log, heater))


def test_a_disturbance_may_come_later_than_all_lags_reach():
    """90 samples later, where A and B have 75 lags; the commanded input is 20 samples late."""
    rng, N = np.random.default_rng(0), 300
    u, d = held(rng, 2, N, samples=4)
    plant, of_d = lag() * lag(0.0) ** 20, lag(0.8, gain=0.5) * lag(0.0) ** 90
    y = answer(plant, u[None]) + answer(of_d, d[None]) + 0.01 * rng.standard_normal(N)
    log, bare = log_of(u[None], y, d=[d]), log_of(u[None], y)
    estimate, known = measured_response(log), measured_response(log, delay=20)
    assert covers(estimate, plant) and covers(known, plant)  # a delay of the commanded input alone
    assert np.median(estimate.radius() / measured_response(bare).radius()) < 1 / 2


def test_a_log_that_lacks_a_disturbance_is_one_in_which_it_rests():
    """Disturbances are found by name, in any order."""
    first, second = record_of(0), record_of(1, size=0.0)
    bare = second.drop_vars("disturbance")
    rests = second.assign(disturbance=0 * second.disturbance)
    lacking = measured_response([first, bare])
    assert same(lacking, measured_response([first, rests]))
    assert np.median(lacking.radius() / measured_response(first).radius()) < 0.9
    turned = record_of(2).isel(source=[1, 0])
    pair = [measured_response([first, log]) for log in (record_of(2), turned)]
    assert same(*pair)


def test_the_columns_of_a_table_are_known_disturbances(tmp_path):
    """From a table, and through a log as it is saved."""
    log = record_of(2)
    columns = {"w1": log.reference[0, :, 0], "T1": log.y[0, :, 0], "Q": log.disturbance[0, :, 0]}
    table = pd.DataFrame({name: signal.values for name, signal in columns.items()})
    asked = {"outputs": {"T1": "T1"}, "reference": {"T1": "w1"}, "Ts": 1.0}
    with_heater = read_table(table, **asked, disturbances={"a heater": "Q"})
    save_log(with_heater, tmp_path / "log.csv")
    estimate = measured_response(load_log(tmp_path / "log.csv"))
    assert "the known disturbances a heater, other" in str(estimate)
    assert np.median(estimate.radius() / measured_response(read_table(table, **asked)).radius()) < 1


def moved_and_disturbed():
    """A log of one input and one disturbance."""
    rng = np.random.default_rng(0)
    u, d = rng.standard_normal((2, 1, 100))
    return log_of(u, lfilter([0, 0.3], [1, -0.7], u), d=d)


@pytest.mark.parametrize("size", [1.7e308, 1e31, 1e-31])
@pytest.mark.parametrize("signal", ["u", "y", "disturbance"])
def test_numbers_of_no_unit_are_named(signal, size):
    log = moved_and_disturbed()
    values = log[signal] / np.abs(log[signal]).max() * size
    with pytest.raises(LogError, match=r"moves by .*: choose a unit in which it moves by 1e-30 to"):
        measured_response(log.assign({signal: values}))


@pytest.mark.parametrize("signal", ["u", "y", "disturbance"])
def test_the_unit_of_a_signal_is_that_of_P_and_offsets_do_not_count(signal):
    """Of u and y that is so; what known disturbances are measured in does not count either."""
    log = moved_and_disturbed()
    usual = measured_response(log)
    small = measured_response(log.assign({signal: log[signal] * 1e-25 + 1e-22}))
    share = {"u": 1e25, "y": 1e-25, "disturbance": 1.0}[signal]  # P in other units
    np.testing.assert_allclose(small.response, usual.response * share, rtol=1e-6)
