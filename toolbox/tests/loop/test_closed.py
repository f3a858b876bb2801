import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import random_plant, tanks
from written_out import another, mixed, simulated

from ilctools import current_trial_loop
from ilctools.models import frequency_response
from rodlib import Rod, midr


@given(st.integers(0, 2**32 - 1))
def test_the_controller_around_another_plant(seed):
    """Of another order, with feedthrough, and with its signals in another order."""
    rng, Ts = np.random.default_rng(seed), 0.5
    design = random_plant(rng)
    design.dt = Ts
    loop = current_trial_loop(design, ["u1", "u2"])
    design, grid = loop.plant, np.append(0.0, np.geomspace(1e-3, np.pi, 20)) / Ts
    by_control = np.moveaxis(loop.closed[:, :2](np.exp(1j * grid * Ts)), 2, 0)
    own = frequency_response(design[:, ["u1", "u2"]], grid)
    for plant in (None, design, own):  # around its own the observer drops out
        P = loop.frequency_response(grid, plant)
        np.testing.assert_allclose(P, by_control, rtol=0, atol=1e-9 * np.abs(P).max())
    other = another(design, rng)
    try:
        closed = loop.around(mixed(other, rng))
    except ValueError as error:
        assert "unstable" in str(error)
        w, d = np.tile(rng.standard_normal(2), (3000, 1)), np.zeros((3000, 1))
        y, _, _ = simulated(loop, other, w, d)
        assert np.abs(y[-100:] - w[-100:]).max() > 1e-6  # a stable one has settled
        return
    w, d = rng.standard_normal((40, 2)), rng.standard_normal((40, 1))
    expected, _, _ = simulated(loop, other, w, d)
    response = control.forced_response(closed, inputs=np.hstack([w, d]).T).outputs.T
    scale = np.abs(expected).max()
    np.testing.assert_allclose(response, expected, rtol=0, atol=1e-9 * scale)
    samples = frequency_response(other[:, ["u1", "u2"]], grid)
    expected = frequency_response(closed[:, :2], grid)
    scale = np.abs(expected).max()
    for plant in (other, samples):
        P = loop.frequency_response(grid, plant)
        np.testing.assert_allclose(P, expected, rtol=0, atol=1e-9 * scale)


SWAPPED = midr(Rod(sensors=(0.28, 0.12)))
REFUSALS = [  # a plant, and what the error names
    (midr(Rod()), "plant.dt = 0"),
    (control.sample_system(midr(Rod()), 2.0), "plant.Ts = 2.0"),
    (tanks(1.0), r"lacks \['Q1', 'Q3', 'y1', 'y2'\]"),
    (np.ones((3, 2, 1)), "plant has shape"),
    (control.sample_system(SWAPPED, 1.0), "plant makes the loop unstable"),
]


@pytest.mark.parametrize(("plant", "message"), REFUSALS)
def test_other_plants_that_do_not_fit_are_refused(loop, plant, message):
    with pytest.raises(ValueError, match=message):
        loop.frequency_response([0.1, 0.2, 0.3], plant=plant)
