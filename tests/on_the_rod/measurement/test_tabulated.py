"""A table of a frequency response: between its lines, with and without what is known of it."""

import control
import numpy as np
import pytest

from ilctools import measured_response, synthesise, zero_phase_butterworth

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
    assert "as exact as its lines" in repr(found)
    wide = measured_response(table(), uncertainty=np.full(14, 0.01))
    np.testing.assert_allclose(wide.on(dense)[1], radius + 0.01)
    np.testing.assert_array_equal(wide.radius(0.5, jointly=True), np.full(14, 0.01))
    assert "at 50% of omega" in wide.basis([7.0, 800.0])[-1]


def test_twelve_points_are_enough_for_a_dense_grid():
    """And without them the error says how."""
    omega, Q = np.geomspace(6.0, 1000.0, 150), zero_phase_butterworth(2, 100.0, 1e-3)
    asked = {"order": 10, "M_max": 0.95, "L_max": 10.0, "band": (7.0, 50.0)}
    with pytest.raises(ValueError, match=r"measured_response\(P\), splined"):
        synthesise(table(), Q, omega, **asked)
    design = synthesise(measured_response(table()), Q, omega, **asked)
    L = design.filter.frequency_response(omega)[:, 0, 0]
    M = Q.frequency_response(omega) * np.abs(1 - lag(omega) * L)
    assert M[omega < 600].max() <= 0.95


def test_units_and_what_is_no_table():
    two = np.array([[1, 0.1], [0.2, 1]])[:, :, None] * lag(LINES)
    found = measured_response(control.frd(two, LINES), uncertainty=np.full(14, 0.1))
    response, radius = found.on(LINES, 0.9, [1.0, 10.0])
    np.testing.assert_allclose(response[:, 0, 1], 10 * two[0, 1])
    assert radius[0] == pytest.approx(1.0)
    for name, value in (("uncertainty", np.full(14, -1.0)), ("uncertainty", [0.1]), ("of", "u")):
        with pytest.raises(ValueError, match=name):
            measured_response(table(), **{name: value})
    with pytest.raises(ValueError, match="four positive increasing"):
        measured_response(control.frd([1, 0.5], [1, 2]))
