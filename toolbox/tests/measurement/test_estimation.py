"""What an estimate says: its region, its model, and whether a log contradicts it."""

import warnings

import control
import numpy as np
import pytest
from plants import lag, lags, stage, tanks
from records import answer, covers, error, held, in_a_loop, log_of, moved
from scipy.signal import lfilter

from ilctools import current_trial_loop, measured_response
from ilctools.law.notes import loop_note
from ilctools.measurement.estimation import RISE, SEEN, Moments, quantile
from ilctools.signals import dataset
from ilctools.singular_values import largest_singular_values

LAG = lag()
SETTLES = pytest.mark.filterwarnings("ignore:.* may not settle")
PLANTS = {  # a model, samples and for how many of them the input is held
    "a stage, in mm": (lambda: stage()[:, :1], 2000, 10),
    "three tanks": (lambda: tanks()[:, 1:], 200, 6),
}


@SETTLES  # the stage integrates
@pytest.mark.parametrize("name", PLANTS)
def test_the_region_holds_and_a_model_is_in_it(name):
    make, N, samples = PLANTS[name]
    estimate = measured_response(moved(make(), N, samples=samples))
    assert covers(estimate, make()) and estimate.known.mean() > 0.5
    model = estimate.model()
    assert covers(estimate, model)
    assert (model.dt, model.input_labels) == (make().dt, estimate.record.inputs)
    assert make().nstates <= model.nstates <= make().nstates + 1


@pytest.mark.parametrize("noise", [0.0, 3e-6, 1e-2])
def test_the_radius_follows_the_noise_down_to_none(noise):
    estimate = measured_response(moved(LAG, 300, noise=noise))
    assert covers(estimate, LAG)
    if noise:  # else, and up to 1e-6, the radius is that of rounding, another one elsewhere
        assert np.median(estimate.radius()) < 5 * noise
        assert estimate.model().nstates in (1, 2)
    assert not measured_response(moved(LAG, 300, noise=noise), delay=1).model().D.any()


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_the_quantile_of_a_ratio_is_exceeded_as_often_as_it_states(share):
    """(2), for one circular error and an A that is independent of it: by a million draws."""
    moments = Moments(np.ones(1), np.full(1, 0.5**0.5), np.full((1, 2, 1), share / 2))
    most = quantile(moments, 0.01)
    z = np.random.default_rng(0).standard_normal((4, 1_000_000)) / 2**0.5
    beyond = np.hypot(*z[:2]) > most * np.abs(1 + share**0.5 * (z[2] + 1j * z[3]))
    assert np.mean(beyond) == pytest.approx(0.01, abs=5e-4)  # five standard deviations


def test_another_log_contradicts_or_does_not():
    estimate = measured_response(moved(LAG, 300))
    for start in (0.0, 2.0):
        log = moved(LAG, 300, seed=1)
        same = estimate.check(log.assign(y=log.y + start * 0.9 ** np.arange(300)[:, None]))
        assert not same.contradicts and same.by == 0
    twice = estimate.check(moved(2 * LAG, 100, seed=2))
    assert twice.contradicts and twice.by == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("poles", "where"),
    [
        ([1.03 * np.exp(0.5j), 1.03 * np.exp(-0.5j)], "at about 0.5 rad/s"),
        ([1.01], "more slowly than at 0.021 rad/s, the lowest frequency that the record resolves"),
    ],
)
def test_where_a_plant_that_does_not_settle_grows_is_said(poles, where):
    plant = control.ss(control.tf([0.1], np.poly(poles).real, 1.0))
    with pytest.raises(ValueError, match=f"y0 does not settle, but grows {where}: learning"):
        measured_response(moved(plant, 300, noise=0.01))


def test_an_integrator_is_said_to_rise_and_a_lag_is_not():
    """Over five draws; the lag has a sixth of the record as its time constant."""
    integrator, slow = control.ss(1, 0.05, 1, 0, 1.0), lag(np.exp(-1 / 100))
    for seed in range(5):
        for plant in (integrator, slow):
            try:
                with warnings.catch_warnings(record=True) as seen:
                    warnings.simplefilter("always")
                    measured_response(moved(plant, 600, seed, 0.05, samples=10))
                said = "like an integrator" in " ".join(str(one.message) for one in seen)
            except ValueError as refused:
                said = "does not settle" in str(refused)
            assert said == (plant is integrator)


def test_a_slow_lag_that_is_known_at_rest_is_not_said_to_rise():
    """P of a lag of two thirds of the record rises, but under little noise P(0) is sure."""
    estimate = measured_response(moved(lag(np.exp(-1 / 400)), 600, noise=1e-4, samples=10))
    one, two = np.abs(estimate.on([2 * np.pi / 600, 4 * np.pi / 600])[0][:, 0, 0])
    assert one > RISE * two and not estimate.findings


def test_a_contradiction_too_small_to_be_said_widens_the_radius():
    rng, N = np.random.default_rng(0), 400
    u = held(rng, N, samples=10)
    y = lfilter([0, 0.3], [1, -0.7], [u, u + 0.003 * u**3]) + 1e-4 * rng.standard_normal(N)
    linear, curved = (measured_response(log_of(u[None], z[None])) for z in y)
    assert linear.apart == 0 < curved.apart < SEEN and not curved.findings
    assert np.median(curved.radius()) > curved.apart * 0.1 > np.median(linear.radius())


def test_a_record_that_says_little_has_a_model_with_states_too():
    """Of a lag under as much noise, whose region has P = 0 in it."""
    plant = lag(0.95)
    estimate = measured_response(moved(plant, 120, noise=1.0, samples=5))
    size = largest_singular_values(estimate.response)
    assert np.any(estimate.radius(0.99, jointly=True) > size)
    model = estimate.model()
    fits = estimate.omega > 2 * np.pi / 120
    assert model.nstates and error(estimate, model)[fits].max() <= 0.1001 * size[fits].max()


def test_a_loop_whose_reference_is_not_known_is_refused():
    """The commands follow what the noise has done; of one log it is known, of another it is not."""
    rng = np.random.default_rng(0)
    noise = lfilter([1], [1, -0.5], rng.standard_normal(600))
    reference = 3 * held(rng, 600, samples=20)
    u, y = in_a_loop(([0, 0.1], [1, -0.9]), ([2], [1]), reference, noise)
    log = log_of(u[None], y[None])
    with pytest.raises(ValueError, match="u follows y"):
        measured_response([log, log.assign(reference=log.y)])


def test_a_loop_whose_observer_integrates_is_known_at_rest():
    """If the log names it."""
    loop, rng = current_trial_loop(lags()), np.random.default_rng(0)
    w = held(rng, 2, 100, samples=20)
    y = answer(loop.P, w - w[:, :1]) + 0.05 * rng.standard_normal(w.shape)
    r, y = (signal.T[None] for signal in (w, y))
    log = dataset(loop.Ts, loop.outputs, loop.controls, [], {}, reference=r, v=0 * r, y=y)
    named = log.assign_attrs(loop=loop_note(loop))
    (P, radius), (_, wide) = (measured_response(one).on([1e-4]) for one in (named, log))
    np.testing.assert_allclose(P[0].real, np.eye(2), atol=1e-4)
    assert radius < 0.01 < 0.5 < wide
