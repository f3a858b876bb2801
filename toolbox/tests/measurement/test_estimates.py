"""What an estimate says: its region, its model, its picture, and whether a log contradicts it."""

import control
import numpy as np
import pandas as pd
import pytest
from plants import stage, tanks
from scipy.signal import lfilter
from test_record import LAG, error, log_of, moved

from ilctools import measured_response
from ilctools.measurement.estimation import quantile
from ilctools.models import frequency_response

SETTLES = pytest.mark.filterwarnings("ignore:.* may not settle")
PLANTS = {  # a model, samples and for how many of them the input is held
    "a stage, in mm": (lambda: stage()[:, :1], 2000, 10),
    "three tanks": (lambda: tanks()[:, 1:], 200, 6),
}


@SETTLES  # the stage integrates
@pytest.mark.parametrize("name", PLANTS)
def test_the_region_holds_and_a_model_is_in_it(name):
    make, N, held = PLANTS[name]
    estimate = measured_response(moved(make(), N, held=held))
    radius, known = estimate.radius(0.99, jointly=True), estimate.known
    assert np.all(error(estimate, make()) <= radius) and known.mean() > 0.5
    model = estimate.model()
    assert np.all(error(estimate, model) <= radius)
    assert (model.dt, model.input_labels) == (make().dt, estimate.record.inputs)
    assert make().nstates <= model.nstates <= make().nstates + 1


@pytest.mark.parametrize("noise", [0.0, 3e-6, 1e-4, 1e-2])
def test_the_radius_follows_the_noise_down_to_none(noise):
    estimate = measured_response(moved(LAG, 300, noise=noise))
    assert np.all(error(estimate, LAG) <= estimate.radius(0.99, jointly=True) + 1e-9)
    if noise:  # else, and up to 1e-6, the radius is that of rounding, another one elsewhere
        assert np.median(estimate.radius()) < 5 * noise
        assert estimate.model().nstates in (1, 2)
    assert not measured_response(moved(LAG, 300, noise=noise), delay=1).model().D.any()


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_the_quantile_of_a_ratio_is_exceeded_as_often_as_it_states(share):
    """(2), for one circular error and an A that is independent of it: by a million draws."""
    most = quantile(np.ones(1), np.full(1, 0.5**0.5), np.full((1, 2, 1), share / 2), 0.01)
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


def test_a_loop_whose_reference_is_not_known_is_refused():
    """The commands follow what the noise has done; of one log it is known, of another it is not."""
    rng = np.random.default_rng(0)
    noise = lfilter([1], [1, -0.5], rng.standard_normal(600))
    reference = np.repeat(3 * rng.standard_normal(30), 20)
    u = lfilter([2, -1.8], [1, -0.7], reference - noise)  # 2 (reference - y), around LAG
    log = log_of(u[None], (lfilter([0, 0.1], [1, -0.9], u) + noise)[None])
    with pytest.raises(ValueError, match="u follows y"):
        measured_response([log, log.assign(reference=log.y)])


def edges(band):
    """Its lower and upper edge, frequency by frequency."""
    return pd.DataFrame(band.get_paths()[0].vertices).groupby(0)[1].agg(["min", "max"])


def test_any_measured_response_draws_itself_and_goes_to_python_control():
    """The band is as wide as was given; some entries are zero."""
    plant, omega = control.append(LAG, 2 * LAG), np.geomspace(1e-2, 1.5, 30)
    table = control.frd(plant, omega, smooth=False)
    measured = measured_response(table, uncertainty=np.full(30, 0.05))
    truth = frequency_response(plant, omega)
    np.testing.assert_allclose(np.moveaxis(measured.frd().frdata, -1, 0), truth, rtol=1e-12)
    assert measured.frd().dt == plant.dt
    figure = measured.plot()
    gains, phases = np.array(figure.axes).reshape(2, 4)  # a column each: 00, 01, 10, 11
    for k, (i, j) in enumerate(np.ndindex(2, 2)):
        band, size = edges(gains[k].collections[0]), np.abs(truth[:, i, j])
        np.testing.assert_allclose(band["max"], size + 0.05)
        np.testing.assert_allclose(band["min"], np.maximum(size - 0.05, size / 10))
        _, turned = phases[k].lines[0].get_data()
        np.testing.assert_allclose(np.exp(1j * np.radians(turned)) * size, truth[:, i, j])
    figure.canvas.draw()
