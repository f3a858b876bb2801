"""Known disturbances of a record are inputs of its estimate; P is to the commanded inputs alone."""

import control
import numpy as np
import pandas as pd
import pytest
from plants import lags
from scipy.signal import lfilter
from test_record import error, log_of

from ilctools import load_log, measured_response, read_table, save_log
from ilctools.errors import LogError
from ilctools.measurement.arx.regression import regression
from ilctools.measurement.arx.trials import Trials
from ilctools.measurement.consistency import FOLLOWS, contradictions
from ilctools.models import frequency_response
from ilctools.signals import dataset
from ilctools.singular_values import largest_singular_values

TS = 20.0  # s, of the block
pytestmark = pytest.mark.filterwarnings("ignore:.* may not settle")  # the records are short


def block(zones):
    """Zones of a heated block, each in a PI loop; from w1 (and w2), a third heater and the air.

    K and %, and time constants of 400 to 600 s.
    """
    A = [[-1 / 400, 1 / 2500, 1 / 900], [1 / 2500, -1 / 500, 1 / 1200], [1 / 900, 1 / 1200, -0.002]]
    B = [[0.012, 0, 0, 1 / 800], [0, 0.01, 0, 1 / 1500], [0, 0, 0.011, 1 / 1000]]
    kept, own = [*range(zones), 2], np.eye(zones)
    A, B = np.array(A)[np.ix_(kept, kept)], np.array(B)[np.ix_(kept, [*range(zones), 2, 3])]
    plant = control.sample_system(control.ss(A, B, np.eye(zones, zones + 1), 0), TS)
    kp, ki = np.diag([2.0, 2.5][:zones]), 0.06 * own
    B, C = plant.B[:, :zones], plant.C
    states = np.block([[plant.A - B @ kp @ C, B @ ki], [-C, own]])
    inputs = np.block([[B @ kp, plant.B[:, zones:]], [own, np.zeros((zones, 2))]])
    return control.ss(states, inputs, np.hstack([C, 0 * own]), 0, TS)


def record_of(seed, zones=1, size=1.0):
    """A log under steps of the reference, while others switch the third heater; the air drifts.

    It is short: the time of an estimate grows as the cube of its lags and inputs.
    """
    rng, N = np.random.default_rng(seed), 100
    w = [2 * np.repeat(rng.standard_normal(20), n)[:N] for n in (15, 21)]
    w = np.stack(w[:zones])
    heater = 60.0 * np.repeat(rng.integers(0, 2, 20), 18)[:N]
    air = 20 + np.sin(2 * np.pi * (np.arange(N) / 100 + rng.uniform()))
    air = air + 0.02 * np.cumsum(rng.standard_normal(N))
    known = np.stack([heater, air])
    before = np.repeat(np.vstack([w[:, :1], known[:, :1]]), 600, axis=1)  # it rests
    inputs = np.hstack([before, np.vstack([w, known])])
    inputs[zones:] *= size
    times = TS * np.arange(N + 600)
    y = control.forced_response(block(zones), times, inputs).outputs.reshape(zones, -1)[:, 600:]
    y = y + 0.02 * rng.standard_normal(y.shape)
    signals = (signal.T[None] for signal in (w, y, known))
    reference, y, known = signals
    names = ["T1", "T2"][:zones], [], ["heater", "air"]
    return dataset(TS, *names, {}, reference=reference, v=0 * y, y=y, disturbance=known)


def test_a_third_heater_and_the_air_are_no_noise():
    """The truth is within the joint radius of 99 %: `make measure WHAT=regions` counts 200 draws.

    The radius is less than half of that which the same log has without them, as the heater moves y
    by some ten times the noise.
    """
    plant, ratios = block(2)[:, :2], []
    for seed in range(2):
        log = record_of(seed, zones=2)
        estimate = measured_response(log)
        assert estimate.response.shape[1:] == (2, 2)
        assert np.all(error(estimate, plant) <= estimate.radius(0.99, jointly=True))
        bare = measured_response(log.drop_vars("disturbance"))
        ratios.append(np.median(estimate.radius() / bare.radius()))
        assert "the known heater, air, what" in str(estimate) and "known" not in str(bare)
    assert np.median(ratios) < 1 / 2


def test_it_is_the_estimate_of_a_plant_with_more_inputs():
    """Without a reference commands and disturbances are treated alike: P is a block of it."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal((4, 40)), 3, axis=1)
    y = control.forced_response(block(2), TS * np.arange(120), u).outputs
    log = log_of(u, y + 0.01 * rng.standard_normal(y.shape), TS)
    known = log.isel(input=slice(2)).assign(
        disturbance=(("trial", "time", "source"), u[2:].T[None])
    )
    labels = {"source": ("source", ["d2", "d3"]), "source_unit": ("source", ["", ""])}
    known = known.assign_coords(labels)
    whole, part = measured_response(log), measured_response(known)
    np.testing.assert_allclose(part.response, whole.response[..., :2], rtol=1e-7)
    assert np.all(part.radius() < whole.radius())
    for i in range(2):  # of all entries to the inputs, the real parts stand first
        S, of_A = whole.fits[i].covariance(np.array([0.01, 0.3]))
        own, of_own_A = part.fits[i].covariance(np.array([0.01, 0.3]))
        kept = np.ix_([0, 1], [0, 1, 4, 5], [0, 1, 4, 5])
        atol = 1e-6 * np.abs(own).max()  # the units of the inputs are those of all moves in both
        np.testing.assert_allclose(own, S[kept], rtol=1e-5, atol=atol)
        np.testing.assert_allclose(of_own_A, of_A, rtol=1e-5)
    model = part.model()
    assert model.ninputs == 2
    assert np.all(error(part, model) <= part.radius(0.99, jointly=True))


def test_scale_and_offset_of_a_disturbance_do_not_count():
    log = record_of(0)
    other = log.assign(disturbance=log.disturbance * [1e6, -1e-6] + [1e7, 0])
    one, two = measured_response(log), measured_response(other)
    # Of 1e7 + 2e7 a double has 9 digits left; noise of 1e-9 of a signal is nothing here.
    np.testing.assert_allclose(two.response, one.response, atol=1e-6)
    np.testing.assert_allclose(two.radius(), one.radius(), rtol=1e-5)


@pytest.mark.parametrize("value", [0.0, 21.3])
def test_a_disturbance_that_rests_in_each_trial_adds_nothing(value):
    """Also but for rounding, and if it rests elsewhere in the next trial."""
    log = record_of(0, size=0.0)  # nothing but w moves y
    bare = log.drop_vars("disturbance")
    rest = value + 0 * log.disturbance + 4e-15 * np.sin(np.arange(100))[None, :, None] * value
    estimate, plain = measured_response(log.assign(disturbance=rest)), measured_response(bare)
    assert np.array_equal(estimate.response, plain.response)
    assert np.array_equal(estimate.radius(), plain.radius()) and str(estimate) == str(plain)
    twice = [log.assign(disturbance=rest), log.assign(disturbance=rest + 3)]
    plain = measured_response([bare, bare])
    assert np.array_equal(measured_response(twice).radius(), plain.radius())
    one = log.disturbance.values.copy()
    one[..., 1] = value  # the other one moves
    some = measured_response(log.assign(disturbance=(log.disturbance.dims, one)))
    assert "the known heater, what" in str(some)


@pytest.mark.parametrize("zones", [1, 2])
def test_a_disturbance_that_is_an_input_is_refused(zones):
    """Nothing shows which of both moved y: so the radius is as large as P."""
    log = record_of(0, zones)
    w = log.reference.values
    copy = log.disturbance.values.copy()
    copy[..., 0] = np.round(7 - 3 * w[..., 0] - 0.1 * w[..., -1], 5)  # as a log of few digits
    with pytest.raises(LogError, match="moved alike, or as heater, air did"):
        measured_response(log.assign(disturbance=(log.disturbance.dims, copy)))


def test_a_disturbance_that_is_nearly_an_input_or_another_one_is_none_too_many():
    log = record_of(0)
    w = log.reference.values
    near = log.disturbance.values.copy()
    near[..., 0] = w[..., 0] + 0.5 * np.random.default_rng(0).standard_normal(w.shape[:2])
    estimate = measured_response(log.assign(disturbance=(log.disturbance.dims, near)))
    # what nearly the same input may do as well is in the radius
    assert np.median(estimate.radius()) > 2 * np.median(measured_response(log).radius())
    twice = log.disturbance.values.copy()
    twice[..., 1] = twice[..., 0]  # two sensors of one disturbance do no harm
    both = log.assign(disturbance=(log.disturbance.dims, twice))
    estimate, one = measured_response(both), measured_response(both.isel(source=[0]))
    # The prior of two copies together has twice the variance of one.
    assert np.median(estimate.radius()) < 2**0.5 * np.median(one.radius())


def test_a_disturbance_may_come_later_than_all_lags_reach():
    """90 samples later, where A and B have 75 lags; the commanded input is 20 samples late."""
    rng, N = np.random.default_rng(0), 300
    for late, own in ((90, 0), (90, 20), (0, 20)):
        u, d = (np.repeat(rng.standard_normal(N // 4), 4) for _ in range(2))
        delayed = [np.append(np.zeros(n), x)[:N] for n, x in ((own, u), (late, d))]
        y = lfilter([0, 0.1], [1, -0.9], delayed[0]) + lfilter([0, 0.1], [1, -0.8], delayed[1])
        y = y + 0.01 * rng.standard_normal(N)
        bare = log_of(u[None], y[None])
        labels = {"source": ("source", ["d"]), "source_unit": ("source", [""])}
        log = bare.assign(disturbance=(("trial", "time", "source"), d[None, :, None]))
        log = log.assign_coords(labels)
        plant = control.ss(control.tf([0.1], [1, -0.9, *np.zeros(own)], 1.0))
        estimate = measured_response(log)
        assert np.all(error(estimate, plant) <= estimate.radius(0.99, jointly=True))
        if late and own:
            noise = measured_response(bare).radius()
            assert np.median(estimate.radius() / noise) < 1 / 2  # d moves y half as much as u does
            known = measured_response(log, delay=own)  # of the commanded input alone
            assert np.all(error(known, plant) <= known.radius(0.99, jointly=True))


def test_a_log_that_lacks_a_disturbance_is_one_in_which_it_rests():
    first, second = record_of(0), record_of(1, size=0.0)
    bare = second.drop_vars("disturbance")
    rests = second.assign(disturbance=0 * second.disturbance)
    lacking, resting = measured_response([first, bare]), measured_response([first, rests])
    assert np.array_equal(lacking.response, resting.response)
    assert np.array_equal(lacking.radius(), resting.radius())
    single = measured_response(first)
    assert np.median(lacking.radius()) < 0.9 * np.median(single.radius())
    # by name, in any order
    turned = record_of(2).isel(source=[1, 0])
    pair = [measured_response([first, log]).response for log in (record_of(2), turned)]
    assert np.array_equal(*pair)


def test_the_columns_of_a_table_are_known_disturbances(tmp_path):
    """From a table, and through a log as it is saved."""
    log = record_of(3)
    columns = {"w1": log.reference[0, :, 0], "T1": log.y[0, :, 0], "Q": log.disturbance[0, :, 0]}
    table = pd.DataFrame({name: signal.values for name, signal in columns.items()})
    asked = {"outputs": {"T1": "T1"}, "reference": {"T1": "w1"}, "Ts": TS}
    with_heater = read_table(table, **asked, disturbances={"third heater": "Q"})
    save_log(with_heater, tmp_path / "log.csv")
    estimate = measured_response(load_log(tmp_path / "log.csv"))
    assert "the known third heater, what" in str(estimate)
    assert np.median(estimate.radius() / measured_response(read_table(table, **asked)).radius()) < 1


def test_another_log_with_known_disturbances_is_checked_against_them():
    estimate, other = measured_response(record_of(0)), record_of(1)
    assert not estimate.check(other).contradicts
    faster = other.assign(y=other.y + 0.5 * other.reference.values)
    assert estimate.check(faster).contradicts


def trials_of(gains, N=200, direct=0.0):
    """Of one input and one disturbance of ten times its effect; another gain of P in each trial."""
    rng, K = np.random.default_rng(0), len(gains)
    u = np.repeat(rng.standard_normal((K, N // 2)), 2, axis=1)
    d = np.repeat(rng.standard_normal((K, N // 2)), 2, axis=1)
    y = np.array(gains)[:, None] * lfilter([0, 0.1], [1, -0.9], u)
    y = y + lfilter([direct, 1.0], [1, -0.9], d) + 0.003 * rng.standard_normal((K, N))
    y = y - y[:, :1]
    names = tuple(f"trial {k}" for k in range(K))
    return [Trials(u=np.stack([u, d], axis=2), y=y[..., None], names=names, known=1)]


def test_a_contradiction_is_by_how_much_of_P_whatever_the_disturbance_does():
    groups = trials_of([1.0, 1.0, 1.5, 1.0])
    said = dict(contradictions(regression(groups, False), groups))
    assert max(said, key=said.get) == "trial 2"
    # 1.5 and 1 differ by 0.4 to 0.5 of what is estimated from all
    assert said["trial 2"] == pytest.approx(0.45, abs=0.1)
    assert not dict(contradictions(regression(trials_of([1.0] * 4), False), trials_of([1.0] * 4)))


def test_a_disturbance_that_acts_at_once_is_no_sign_of_a_loop():
    """Nor is it left out where commands are known to act a sample later."""
    groups = trials_of([1.0, 1.0], direct=3.0)
    fit = regression(groups, False)
    assert FOLLOWS not in dict(contradictions(fit, groups, False))
    np.testing.assert_allclose(fit.impulse(1).ravel(), [0, 3.0], atol=0.02)
    truth = frequency_response(lags_of_one(), np.array([0.01, 1.0]))
    np.testing.assert_allclose(fit.response(np.array([0.01, 1.0])), truth[:, 0], atol=0.1)


def lags_of_one():
    return control.ss(control.tf([0.1], [1, -0.9], 1.0))


def test_without_disturbances_the_regression_has_the_commanded_inputs_alone():
    plant = lags()
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal((2, 100)), 2, axis=1)
    y = control.forced_response(plant, np.arange(200), u).outputs
    estimate = measured_response(log_of(u, y + 0.01 * rng.standard_normal(y.shape)))
    assert estimate.fits[0].commanded == 2
    assert estimate.fits[0].impulse(5).shape == (2, 5)


def moved_and_disturbed():
    """A log of one input and one disturbance."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((1, 100))
    log = log_of(u, lfilter([0, 0.3], [1, -0.7], u))
    log = log.assign(disturbance=(("trial", "time", "source"), rng.standard_normal((1, 100, 1))))
    return log.assign_coords(source=("source", ["d"]), source_unit=("source", [""]))


@pytest.mark.parametrize("size", [1e300, 1e-310, 1.7e308, 1e31, 1e-31])
@pytest.mark.parametrize("signal", ["u", "y", "disturbance"])
def test_numbers_of_no_unit_are_named(signal, size):
    log = moved_and_disturbed()
    values = log[signal] / np.abs(log[signal]).max() * size
    with pytest.raises(LogError, match=r"moves by .*: choose a unit in which it moves by 1e-30 to"):
        measured_response(log.assign({signal: values}))


@pytest.mark.parametrize("signal", ["u", "y", "disturbance"])
def test_the_unit_of_a_signal_is_that_of_P(signal):
    log = moved_and_disturbed()
    usual = measured_response(log)
    small = log.assign({signal: log[signal] * 1e-25})
    share = {"u": 1e25, "y": 1e-25, "disturbance": 1.0}[signal]  # P in other units
    np.testing.assert_allclose(measured_response(small).response, usual.response * share, rtol=1e-6)


def test_a_record_without_noise_is_accepted():
    """Its radius is that of rounding; it contains the truth."""
    plant = lags()
    u = np.repeat(np.random.default_rng(0).standard_normal((2, 75)), 2, axis=1)
    y = control.forced_response(plant, np.arange(150), u).outputs
    estimate = measured_response(log_of(u, y))
    size = largest_singular_values(estimate.response).max()
    assert estimate.radius().max() < 0.01 * size
    assert np.all(error(estimate, plant) <= estimate.radius(0.99, jointly=True))
