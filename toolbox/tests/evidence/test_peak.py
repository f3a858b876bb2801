"""What a certificate says where P is not known: below the first sample of a table, and of a rig."""

import warnings

import control
import numpy as np
import pytest
from plants import RestartingModel, copies, lag, sigma_of_M

from ilctools import (
    ClosedLoop,
    measured_response,
    multisine,
    shake,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.evidence.peak import BELOW, peak_of_M

[AXIS] = copies(1)
Q = zero_phase_butterworth(2, 40.0, 0.01)


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


@pytest.mark.parametrize(("first", "more"), [(0.4, 1e-3), (4.0, 0.1)])
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


def test_a_model_is_known_at_rest():
    omega = np.geomspace(20, 314, 200)
    assert BELOW not in synthesise(AXIS, Q, omega).certificate.peaks
    design = synthesise(AXIS, Q, omega, uncertainty=0.01)
    assert BELOW not in design.certificate.peaks and "assumed: below" not in f"{design}"


def test_below_the_lowest_line_of_a_shaken_rig_the_rate_holds_too():
    """Two lags, from a tenth of the cut-off on; at rest nothing was measured."""
    plant = control.ss(lag(0.97, 2.5, 0.01) * lag(0.97, Ts=0.01), inputs=["w1"], outputs=["y1"])
    loop, lowpass = ClosedLoop(Ts=0.01, outputs=["y1"]), zero_phase_butterworth(2, 3.0, 0.01)
    excitation = multisine(loop, 0.3, 9.0, 1.0, 0.1, 20)
    measured = measured_response(shake(RestartingModel(plant, noise=0.002), loop, excitation))
    design = synthesise(measured, lowpass)
    true = sigma_of_M(np.linspace(0, measured.omega[0], 100), plant, lowpass, design.filter)
    assert true.max() <= design.certificate.peaks[BELOW].sigma <= design.rate < 0.9
    assert "P is what the measured response says at rest" in f"{design}"
