import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import lags

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.law.plant_region import PlantRegion

Q = zero_phase_butterworth(2, 0.3, 1.0)


def test_the_distance_of_a_model_from_samples_is_in_the_radius():
    P, off = lags(), lags(gain=1.05)
    omega = np.linspace(0.002, np.pi, 400)
    design = synthesise(frequency_response(P, omega), Q, omega, uncertainty=np.full(400, 0.01))
    region = PlantRegion.of(design.problem.response, off)
    at = np.linspace(0.002, np.pi, 37)
    distance = np.linalg.norm(frequency_response(P, at) - frequency_response(off, at), 2, (1, 2))
    found = np.interp(at, region.angles, region.radii[0])
    assert np.all(found >= 0.01 + 0.99 * distance) and np.all(found < 0.012 + 1.01 * distance)
    with pytest.raises(ValueError, match=r"model = None, but P is known by samples"):
        PlantRegion.of(design.problem.response, None)


def test_it_is_in_units_of_scale_and_of_all_channels():
    """Two sensors at one place: the direction that is left out is there again."""
    one = lags()
    P = control.ss(one.A, one.B, [[1, 0], [1, 0]], 0, 1.0)
    P.update_names(inputs=["a", "b"], outputs=["x", "z"])
    with pytest.warns(UserWarning, match="direction"):
        response = synthesise(P, Q, scale={"x": 2.0, "z": 2.0}).problem.response
    region = PlantRegion.of(response, None)
    assert region.exact and region.outputs == ["x", "z"] and region.inputs == ["a", "b"]
    omega = np.array([0.01, 0.4])
    scaled = frequency_response(P, omega) * region.scale.of_P
    assert_allclose(frequency_response(region.models[0], omega), scaled, atol=1e-12)
