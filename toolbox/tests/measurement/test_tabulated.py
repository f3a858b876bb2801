"""A table of a frequency response: between its lines, with and without what is known of it."""

import control
import numpy as np
import pandas as pd
import pytest
from plants import STAGE_WITH_MODES, random_stable
from plants import lag as lag_model

from ilctools import NormOptimal, measured_response
from ilctools.errors import LogError
from ilctools.models import frequency_response, from_rest

LINES = np.geomspace(5.0, 600.0, 14)


def lag(omega):
    return 1 / (1 + 1j * omega / 60) ** 2


def table():
    return control.frd(lag(LINES), LINES)


def test_the_truth_is_within_the_radius_between_the_lines():
    found, dense = measured_response(table()), np.geomspace(5.0, 600.0, 300)
    response, radius = found.on(dense)
    assert np.all(np.abs(response[:, 0, 0] - lag(dense)) <= radius + 1e-12)
    assert radius.max() < 0.05 and found.on(LINES)[1].max() < 1e-12
    assert "taken as exact there" in repr(found)
    wide = measured_response(table(), uncertainty=np.full(14, 0.01))
    wider = wide.on(dense)[1]  # what it covers counts once
    assert np.all((wider >= np.maximum(radius, 0.01) - 1e-12) & (wider <= radius + 0.01 + 1e-12))
    np.testing.assert_array_equal(wide.radius(0.5, jointly=True), np.full(14, 0.01))
    assert "at 50% of omega" in wide.basis([7.0, 800.0])[-1]


def test_units_and_what_is_no_table():
    two = np.array([[1, 0.1], [0.2, 1]])[:, :, None] * lag(LINES)
    found = measured_response(control.frd(two, LINES), uncertainty=np.full(14, 0.1))
    response, radius = found.on(LINES, 0.9, [1.0, 10.0])
    np.testing.assert_allclose(response[:, 0, 1], 10 * two[0, 1])
    assert radius[0] == pytest.approx(1.0)
    for name, value in (("uncertainty", np.full(14, -1.0)), ("uncertainty", [0.1]), ("of", "u")):
        with pytest.raises(ValueError, match=name):
            measured_response(table(), **{name: value})
    with pytest.raises(ValueError, match="four or more positive frequencies"):
        measured_response(control.frd([1, 0.5], [1, 2]))


def edges(band):
    """Its lower and upper edge, frequency by frequency."""
    return pd.DataFrame(band.get_paths()[0].vertices).groupby(0)[1].agg(["min", "max"])


def test_any_measured_response_draws_itself_and_goes_to_python_control():
    """The band is as wide as was given; some entries are zero."""
    plant, omega = control.append(lag_model(), 2 * lag_model()), np.geomspace(1e-2, 1.5, 30)
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


@pytest.mark.parametrize(
    ("plant", "lines"),
    [
        (control.ss(control.tf([0.2], [1, -0.8, *[0] * 12], 1.0)), np.linspace(0.02, np.pi, 200)),
        (STAGE_WITH_MODES, np.geomspace(1, 1000 * np.pi, 400)),
        (random_stable(3, m=3, Ts=1.0)[:2, :], np.geomspace(0.01, 3.0, 80)),
    ],
)
def test_a_model_of_a_table_is_near_it_between_the_lines_too(plant, lines):
    P = np.moveaxis(frequency_response(plant, lines), 0, -1)
    names = {"inputs": plant.input_labels, "outputs": plant.output_labels}
    model = measured_response(control.frd(P, lines, plant.dt, **names)).model()
    omega = np.geomspace(lines[0], lines[-1], 333)
    truth = frequency_response(plant, omega)
    off = np.linalg.norm(frequency_response(model, omega) - truth, 2, axis=(1, 2))
    assert off.max() < 0.012 * np.linalg.norm(truth, 2, axis=(1, 2)).max()
    assert np.abs(model.poles()).max() < 1 and model.output_labels == plant.output_labels
    w = np.random.default_rng(0).normal(size=(50, plant.ninputs))
    NormOptimal(model, 0.1, 50).apply(from_rest(plant, w))


def test_a_table_without_a_model_is_refused():
    with pytest.raises(ValueError, match="the table states no sampling period"):
        measured_response(table()).model()
    rng, omega = np.random.default_rng(0), np.linspace(0.1, 3, 60)
    noise = rng.normal(size=60) + 1j * rng.normal(size=60)
    with pytest.raises(LogError, match="no model of up to 60 states is within a tenth"):
        measured_response(control.frd(noise, omega, 1.0)).model()
