"""Excited records by the regression and their lines, against plants that are known."""

import re
from dataclasses import replace

import numpy as np
import pytest
from records import SHAKEN, gain_of, resonant, shaken
from scipy.signal import freqz

from ilctools import measured_response, multisine
from ilctools.errors import LogError
from ilctools.measurement.arx.regressors import Regressors
from ilctools.measurement.arx.trials import series_of
from ilctools.measurement.distortion import added_covariance, distortion, lines_of, with_distortion
from ilctools.measurement.estimation import EstimatedResponse, estimated_response
from ilctools.measurement.excitation import excitation_of
from ilctools.measurement.excited import ExcitedResponse

LAG = np.array([0, 0.1]), np.array([1, -0.9])
PLANTS = {
    "lag": LAG,
    "delay": (np.append(np.zeros(60), LAG[0]), LAG[1]),
    "resonance": resonant(0.3, 0.005),
}


def plan(seed):
    return multisine(SHAKEN, 0.012, 2.5, 1.0, hours=0.9, lines=60, seed=seed)


def record(plant, seed, bent=0.0, noise=0.003):
    """A shaken plant behind w + c w^3."""
    rng = np.random.default_rng(seed)
    return shaken(plant, plan(seed), rng, lambda w: w + bent * w**3, noise)


def covers(P, truth):
    """Whether the joint region of 99 % has the truth, a function of the frequency, in it."""
    omega = np.geomspace(0.012, 2.5, 400)  # between the lines, too
    response, radius = P.on(omega, 0.99)
    return np.all(np.abs(response[:, 0, 0] - truth(omega)) <= radius)


@pytest.mark.parametrize("name", PLANTS)
def test_a_linear_plant_is_known_between_the_lines_and_by_a_small_radius(name):
    """Where lines alone are wrong between them (delay), or at them (resonance)."""
    log = record(PLANTS[name], 0)
    P = measured_response(log)
    assert isinstance(P, EstimatedResponse) and not P.findings
    assert covers(P, lambda omega: freqz(*PLANTS[name], omega)[1])
    lines = P.lines.omega
    own, of_lines = (np.median(one.on(lines, 0.99)[1]) for one in (P, P.lines))
    assert own < 0.5 * of_lines
    np.testing.assert_allclose(P.radius(), estimated_response([log], "w").radius())
    assert "the standard deviation is up to" in str(P) and "by nonlinearity" in str(P)
    assert "for smaller ones" not in str(P)
    below = "below 0.01[12]\\d* rad/s, the lowest excited frequency"
    assert re.search(below, str(P)) and not re.search(below, str(P.basis(np.array([0.02]))))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_not_linear_widens_the_radius(seed):
    """The best linear approximation of w + c w^3, by its gain over many phases."""
    log = record(LAG, seed, bent=0.05)
    alone, P = estimated_response([log], "w"), measured_response(log)
    assert P.radius().max() > 1.3 * alone.radius().max()
    assert "the gain may differ for smaller ones" in str(P)
    assert alone.apart > 0 == P.apart  # which is in what the lines show
    gain = gain_of(lambda w: w + 0.05 * w**3, [plan(100 + k) for k in range(9)])
    assert covers(P, lambda omega: gain * freqz(*LAG, omega)[1])


def test_a_smaller_amplitude_is_advised_and_contradicts():
    """A tenth of the amplitude, in units of it: the gain is 3 % smaller."""
    strong = record(LAG, 0, bent=0.3)
    curved = with_distortion(estimated_response([strong], "w"), excitation_of(strong))
    assert "a smaller amplitude may help" in str(curved)
    P = measured_response(record(LAG, 0, bent=0.05))
    assert P.check(record(LAG, 10, bent=0.05 / 100)).contradicts


def test_the_lines_of_a_model_are_those_of_the_plant_without_transients():
    log = record(PLANTS["resonance"], 1, noise=1e-4)
    excitation, estimate = excitation_of(log), estimated_response([log], "w")
    lines = lines_of(estimate, excitation)
    truth = freqz(*PLANTS["resonance"], excitation.omega)[1]
    assert lines.periods.shape[1] == excitation.periods + 1  # the first period, too
    first = np.abs(lines.periods[:, 0, :, 0, 0] - truth)
    assert np.median(first) < 5e-3  # whose transient is as large as the plant's answer
    assert not distortion(lines).any()
    same = with_distortion(estimate, excitation)
    np.testing.assert_array_equal(same.fits[0].C, estimate.fits[0].C)


def test_where_no_linear_model_describes_a_record_P_is_taken_at_the_lines():
    """Such as one that does not settle, whose response no trial shows."""
    log = record(([0, 0.1], [1, -1.002]), 0)
    with pytest.warns(UserWarning, match="P is taken from the excited frequencies .* alone"):
        P = measured_response(log)
    assert isinstance(P, ExcitedResponse) and P.lines is P
    with pytest.raises(LogError, match="does not settle"):
        estimated_response([log], "w")


def test_the_covariance_of_distortion_is_that_of_drawn_residuals():
    """Residuals of the variance (3) at the lines, alike in all periods, by 400 draws."""
    log, rng = record(LAG, 0), np.random.default_rng(1)
    excitation, estimate = excitation_of(log), estimated_response([log], "w")
    [group], [fit] = estimate.record.groups, estimate.fits
    delta2, (R, samples, _) = np.full(excitation.omega.shape, 0.01), group.y.shape
    added = added_covariance(fit, group, excitation, delta2)
    W = excitation.spectra(group.u)[:, 0, :, 0, 0]
    A = fit.denominator_at(excitation.omega)
    v = R * delta2 * np.mean(np.abs(W) ** 2, axis=0) * np.abs(A) ** 2  # (3) with m = 1
    E = np.zeros((400, R, excitation.period // 2 + 1), complex)
    parts = rng.standard_normal((2, 400, R, len(v))) * np.sqrt(v / 2)
    E[..., excitation.harmonics] = parts[0] + 1j * parts[1]
    e = np.tile(np.fft.irfft(E, excitation.period), samples // excitation.period)
    drawn = 0.0
    for k, series in enumerate(series_of([group])):
        own = [[*series_of([replace(group, y=one[..., None])])][k].y for one in e]
        weight = fit.posterior.weight if series.is_mean else 1.0
        drawn = drawn + weight * np.array(own) @ Regressors(series, fit.data.layout).rows().T
    drawn = drawn @ fit.posterior.spread
    size = np.mean(np.sum(drawn**2, axis=1))  # 400 squares scatter by sqrt(2 / 400) at most
    np.testing.assert_allclose(size, np.trace(added), rtol=3 * np.sqrt(2 / 400))
