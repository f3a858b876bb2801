"""What a certificate says where P is not known: below the first sample of a table, and of a rig."""

import warnings

import control
import numpy as np
import pandas as pd
import pytest
from plants import RestartingModel, lags, sigma_of_M

from ilctools import (
    ClosedLoop,
    measured_response,
    multisine,
    read_table,
    run_trials,
    shake,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.evidence.peak import BELOW, CLOSE, peak_of_M
from ilctools.models import frequency_response
from ilctools.response.door import in_own_units

AXIS = control.ss(control.sample_system(control.tf([400], [1, 20, 400]), 0.01))
Q = zero_phase_butterworth(2, 40.0, 0.01)
MOVE = 20 * np.sin(np.pi * np.clip(np.arange(-50, 350) / 250, 0, 1)) ** 4


def table(first, last=314.0):
    return control.frequency_response(AXIS, np.geomspace(first, last, 200))


@pytest.mark.filterwarnings("ignore:the error grows", "ignore:the phase of P leads")
def test_a_table_that_begins_too_late_promises_nothing():
    """At 20 rad/s the phase is -90 degrees: the law diverges on the plant, and that is said."""
    with pytest.warns(match=r"sigma_max\(M\) may reach .* below 20 rad/s, where P is not known"):
        design = synthesise(table(20.0), Q)
    true, at = peak_of_M(AXIS, design.filter, Q)
    assert true > 5 and at == 0 and design.rate >= true
    assert design.certificate.failures == []
    assert "assumed: below 20 rad/s, where P is not known" in f"{design}"
    assert not design.check(table(20.0)).converges
    loop = ClosedLoop(AXIS, outputs=["x"], units={"x": "mm"})
    e = run_trials(loop, design.law(), MOVE, trials=4).e
    assert float((e[3] ** 2).mean()) > 1e4 * float((e[0] ** 2).mean())


@pytest.mark.parametrize(("first", "more"), [(0.4, 1e-3), (0.8, 3e-3), (2.0, 0.02), (4.0, 0.1)])
def test_a_table_with_a_small_phase_hardly_suffers(first, more):
    """Nothing warns, the filter is that for the known range, and the rate holds for the plant.

    What is added is d of response/samples, which 2 zeta x = x = omega_1 / 20 decides:
    Re P is 1 + O(x^4) for this damping, so that it is about x^2.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        design = synthesise(table(first), Q)
    true, _ = peak_of_M(AXIS, design.filter, Q)
    known = design.certificate.peaks["estimated"].sigma
    assert true <= design.rate * (1 + 1e-3)
    assert design.rate <= known + more
    assert f"from there on the rate is {known:.4f}" in f"{design}"


def test_a_rate_within_a_radius_holds_for_plants_within_it_down_to_rest():
    """README's example: any gain within 5 % of P's, at rest too."""
    design = synthesise(table(0.5), Q, uncertainty=0.05)
    for gain in (0.951, 1.049):
        assert peak_of_M(gain * AXIS, design.filter, Q)[0] <= design.rate
    assert design.rate < 0.055


def test_the_worst_of_the_region_is_reached_by_one_of_its_plants():
    design = synthesise(table(4.0), Q)
    peak, response = design.certificate.peaks[BELOW], design.problem.response
    region = response.samples[0].below(np.array([peak.omega]))
    L = design.filter.frequency_response([peak.omega])[0, 0, 0]
    deltas = region.moves * region.W[0, 0] * np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    M = Q.frequency_response([peak.omega]) * np.abs(1 - (region.P[0, 0, 0] + deltas) * L)
    assert M.max() == pytest.approx(peak.sigma, rel=1e-5)  # of the steps of the angle, squared


def test_a_model_is_known_at_rest():
    omega = np.geomspace(20, 314, 200)
    assert BELOW not in synthesise(AXIS, Q, omega).certificate.peaks
    design = synthesise(AXIS, Q, omega, uncertainty=0.01)
    assert BELOW not in design.certificate.peaks and "assumed: below" not in f"{design}"


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_below_the_lowest_line_of_a_shaken_rig_the_rate_holds_too(gain):
    """Three lags, from a tenth of the cut-off on; at rest nothing was measured."""
    s = control.tf("s")
    plant = control.ss(control.sample_system(control.ss(gain / (s / 3 + 1) ** 3), 0.01))
    plant = control.ss(plant, inputs=["w1"], outputs=["y1"])
    loop = ClosedLoop(Ts=0.01, outputs=["y1"])
    excitation = multisine(loop, 0.3, 9.0, 1.0, 0.1, 20)
    measured = measured_response(shake(RestartingModel(plant, noise=0.002), loop, excitation))
    lowpass = zero_phase_butterworth(2, 3.0, 0.01)
    design = synthesise(measured, lowpass)
    assert peak_of_M(plant, design.filter, lowpass)[0] <= design.rate < 0.9
    below = np.linspace(0, measured.omega[0], 200)
    true = sigma_of_M(below, plant, lowpass, design.filter).max()
    assert true <= design.certificate.peaks[BELOW].sigma * (1 + CLOSE)
    assert "P is what the measured response says at rest" in f"{design}"


def test_a_record_says_itself_what_P_is_below_its_lowest_frequency():
    """By the region of its estimate, in whatever units; judged by the plant at rest."""
    plant, rng, time = lags(), np.random.default_rng(0), np.arange(1500)
    w = np.cumsum(rng.standard_normal((1500, 2)), axis=0) / 10
    w -= np.outer(time / time[-1], w[-1])
    y = control.forced_response(plant, inputs=w.T).outputs.T
    columns = np.column_stack([time, w, y + 0.002 * rng.standard_normal(y.shape)])
    table = pd.DataFrame(columns, columns=["t", "a", "b", "p", "q"])
    log = read_table(table, time="t", inputs={"a": "a", "b": "b"}, outputs={"p": "p", "q": "q"})
    measured, lowpass = measured_response(log, delay=1), zero_phase_butterworth(2, 0.05, 1.0)
    [at_rest] = frequency_response(plant, [0.0]).real
    for scale in ([1.0, 1.0], [1.0, 1.5]):
        design = synthesise(measured, lowpass, scale=scale)
        assert design.certificate.peaks["estimated"].sigma < design.rate < 1
        assert peak_of_M(plant, design.filter, lowpass)[0] <= design.rate
        S = np.array(scale)
        response = design.problem.response
        for known, truth in (
            (response, at_rest * S / S[:, None]),
            (in_own_units(response), at_rest),
        ):
            [P], [radius] = known.anywhere(0, np.zeros(1))
            assert np.linalg.norm(P - truth, 2) <= radius < 0.5
            assert not P.imag.any()
