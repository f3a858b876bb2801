"""Excited records by the regression and their lines, against plants that are known."""

import re

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from ilctools import ClosedLoop, measured_response, multisine
from ilctools.errors import LogError
from ilctools.measurement.distortion import distortion, lines_of, with_distortion
from ilctools.measurement.estimation import EstimatedResponse, estimated_response
from ilctools.measurement.excitation import with_excitation
from ilctools.measurement.excited import ExcitedResponse
from ilctools.signals import dataset

LOOP = ClosedLoop(Ts=1.0, outputs=["y"])
LAG = np.array([0, 0.1]), np.array([1, -0.9])
POLE = np.exp(0.3 * (-0.005 + 1j))
RING = np.poly([POLE, POLE.conj()]).real
PLANTS = {
    "lag": LAG,
    "delay": (np.append(np.zeros(60), LAG[0]), LAG[1]),
    "resonance": (np.array([0, RING.sum() / 2, RING.sum() / 2]), RING),
}


def record(plant, seed, bent=0.0, lines=60, noise=0.003):
    """A shaken plant behind w + c w^3, experiment after experiment from rest, and its plan."""
    rng = np.random.default_rng(seed)
    plan = multisine(LOOP, 0.012, 2.5, 1.0, hours=0.9, lines=lines, seed=seed)
    w = plan.signals
    y = lfilter(*plant, w + bent * w**3, axis=1) + noise * rng.standard_normal(w.shape)
    log = dataset(1.0, ["y"], [], [], {"y": ""}, y=y, reference=0 * w, v=w)
    return with_excitation(log, plan, LOOP, {}), plan


@pytest.mark.parametrize("name", PLANTS)
def test_a_linear_plant_is_known_between_the_lines_and_by_a_small_radius(name):
    """Where lines alone are wrong between them (delay), or at them (resonance)."""
    log, plan = record(PLANTS[name], 0)
    P = measured_response(log)
    assert isinstance(P, EstimatedResponse) and not P.findings
    omega = np.geomspace(0.012, 2.5, 400)
    response, radius = P.on(omega, 0.99)
    assert np.all(np.abs(response[:, 0, 0] - freqz(*PLANTS[name], omega)[1]) <= radius)
    _, of_lines = P.lines.on(plan.omega, 0.99)
    _, own = P.on(plan.omega, 0.99)
    assert np.median(own) < 0.5 * np.median(of_lines)
    alone = estimated_response([log], "w")
    np.testing.assert_allclose(P.radius(), alone.radius())  # nothing is not linear
    assert "the standard deviation is up to" in str(P) and "by nonlinearity" in str(P)
    assert "for smaller ones" not in str(P)
    below = "below 0.01[12]\\d* rad/s, the lowest excited frequency"
    assert re.search(below, str(P)) and not re.search(below, str(P.basis(np.array([0.02]))))
    P.plot().canvas.draw()


@pytest.mark.parametrize("seed", range(3))
def test_what_is_not_linear_widens_the_radius(seed):
    """The best linear approximation of w + c w^3, by its gain over many phases."""
    log, plan = record(LAG, seed, bent=0.05)
    alone, P = estimated_response([log], "w"), measured_response(log)
    assert P.radius().max() > 1.3 * alone.radius().max()
    assert "the gain may differ for smaller ones" in str(P)
    assert alone.apart > 0 == P.apart  # which is in what the lines show
    strong, its_plan = record(LAG, seed, bent=0.3)
    curved = with_distortion(estimated_response([strong], "w"), its_plan)
    assert "a smaller amplitude may help" in str(curved)
    # a tenth of the amplitude, in units of it: the gain is 3 % smaller
    assert P.check(record(LAG, seed + 10, bent=0.05 / 100)[0]).contradicts
    period = [
        multisine(LOOP, 0.012, 2.5, 1.0, hours=0.9, lines=60, seed=100 + k).signals
        for k in range(9)
    ]
    w = np.concatenate([one[:, : plan.period] for one in period])
    gain = 1 + 0.05 * np.mean(w**4) / np.mean(w**2)
    response, radius = P.on(plan.omega, 0.99)
    assert np.all(np.abs(response[:, 0, 0] - gain * freqz(*LAG, plan.omega)[1]) <= radius)


def test_the_lines_of_a_model_are_those_of_the_plant_without_transients():
    log, plan = record(PLANTS["resonance"], 1, noise=1e-4)
    estimate = estimated_response([log], "w")
    lines = lines_of(estimate, plan)
    truth = freqz(*PLANTS["resonance"], plan.omega)[1]
    assert lines.periods.shape[1] == plan.periods + 1  # the first period, too
    first = np.abs(lines.periods[:, 0, :, 0, 0] - truth)
    assert np.median(first) < 5e-3  # whose transient is as large as the plant's answer
    assert not distortion(lines).any()
    same = with_distortion(estimate, plan)
    np.testing.assert_array_equal(same.fits[0].C, estimate.fits[0].C)


def test_where_no_linear_model_describes_a_record_P_is_taken_at_the_lines():
    """Such as one that does not settle, whose response no trial shows."""
    log, _ = record(([0, 0.1], [1, -1.002]), 0)
    with pytest.warns(UserWarning, match="P is taken from the excited frequencies .* alone"):
        P = measured_response(log)
    assert isinstance(P, ExcitedResponse) and P.lines is P
    with pytest.raises(LogError, match="does not settle"):
        estimated_response([log], "w")
