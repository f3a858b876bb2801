"""What a filter does on another plant: the rate, and whether it converges."""

from dataclasses import replace

import control
import numpy as np
import pytest
from plants import tanks

from rodlib import (
    convergence,
    current_trial_loop,
    rate,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.evidence.check import check
from rodlib.ilc.evidence.peak import error_model, peak_gain
from rodlib.ilc.measurement.measurement import MeasuredResponse
from rodlib.ilc.problem.pose import pose

Q = zero_phase_butterworth(2, 0.3)
OMEGA = np.geomspace(1e-3, np.pi, 250)


def lag(gain=1.0, pole=0.9):
    return control.ss(pole, gain * (1 - pole), 1, 0, 1.0)


@pytest.fixture(scope="module")
def design():
    return synthesise(lag(), Q, OMEGA, 1.0, order=5, L_max=5.0, band=(1e-3, 0.1))


def samples(P, omega=OMEGA):
    return P(np.exp(1j * omega))[:, None, None]


def test_on_its_own_plant_it_is_what_the_certificate_says(design):
    found = design.check(lag())
    assert found.gamma == pytest.approx(design.certificate.all_M, rel=1e-12)
    assert (
        found.proven and found.monotone and found.converges and found.assumptions == ()
    )
    assert str(found).startswith("converges monotonically: sigma_max(M) is 0.")
    assert "at all frequencies" in str(found)


@pytest.mark.parametrize(("gain", "monotone"), [(0.5, True), (1.3, True), (3.0, False)])
def test_on_a_model_it_is_proven(design, gain, monotone):
    P = lag(gain, 0.93)
    found, (gamma, omega) = design.check(P), peak_gain(error_model(P, design.filter), Q)
    assert found.gamma == pytest.approx(gamma, rel=1e-8) and found.proven
    assert found.at == pytest.approx(omega, rel=1e-3)
    assert found.monotone == monotone == found.converges
    assert str(found).startswith("converges monotonically" if monotone else "diverges")
    as_array = design.check(samples(P))
    assert as_array.gamma == pytest.approx(gamma, rel=1e-3) and not as_array.proven
    assert as_array.spectral_radius == pytest.approx(found.spectral_radius, rel=1e-12)
    assert "not proven between samples" in str(as_array)


def test_with_two_channels_trials_may_converge_and_not_monotonically():
    """M = Q (I - P L) is nearly nilpotent where the coupling goes one way only."""
    apart = control.ss(0.5 * np.eye(2), 0.5 * np.eye(2), np.eye(2), 0, 1.0)
    design = synthesise(apart, Q, OMEGA, 1.0, order=5, L_max=5.0, band=(1e-3, 0.1))
    coupled = control.ss(0.5 * np.eye(2), [[0.5, 4.0], [0, 0.5]], np.eye(2), 0, 1.0)
    found, response = design.check(coupled), coupled(np.exp(1j * OMEGA))
    P = np.moveaxis(response, -1, 0)
    L = design.filter
    assert found.gamma >= rate(P, Q, L, OMEGA).gamma > 1
    assert found.spectral_radius == pytest.approx(
        convergence(P, Q, L, OMEGA).spectral_radius, rel=1e-6
    )
    assert not found.monotone and found.converges
    assert str(found).startswith("converges, not monotonically")
    radius = np.full(250, 1e-3)
    unsure = design.check(coupled, uncertainty=radius)
    assert not unsure.converges and str(unsure).startswith("need not converge")


def test_a_loop_brings_its_P_and_tables_their_own_grid(loop):
    Q, omega = zero_phase_butterworth(), np.geomspace(1e-4, np.pi, 250)
    design = synthesise(loop, Q, omega)
    assert design.check(loop).gamma == pytest.approx(design.certificate.all_M, rel=1e-9)
    own = np.geomspace(1e-4, 2.0, 70)
    table = control.frd(np.moveaxis(loop.frequency_response(own), 0, -1), own)
    found = design.check(table)
    L = design.filter
    assert found.gamma == pytest.approx(design.certificate.all_M, rel=1e-2)
    assert found.gamma >= rate(loop.frequency_response(own), Q, L, own).gamma
    assert "assumed: above 2 rad/s, where P is not known" in str(found)
    response = loop.frequency_response(own)
    noise, spread = (
        1e-6 * np.tile(np.eye(2), (70, 1, 1)),
        np.tile(np.eye(2), (70, 1, 1)),
    )
    measured = MeasuredResponse(own, response, noise, spread, np.full(70, 9), loop)
    unsure = design.check(measured)
    assert unsure.gamma > found.gamma and not unsure.proven
    response, radius = measured.on(own, 0.5)
    sure = design.check(response, own, uncertainty=radius)
    assert found.gamma < sure.gamma < unsure.gamma


def test_in_other_units_the_rate_is_the_same():
    loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
    Q, omega = zero_phase_butterworth(2, 0.005, 2.0), np.geomspace(1e-4, np.pi, 250) / 2
    scale = np.array([1.0, 10.0, 0.1])
    design = synthesise(loop, Q, omega, scale=scale, L_max=20.0, band=(1e-4, 0.002))
    found = design.check([loop, loop.frequency_response(omega)])
    assert found.gamma == pytest.approx(design.certificate.all_M, rel=1e-4)
    with pytest.raises(ValueError, match="scale has shape"):
        design.check(control.ss(0.5, 0.5, 1, 0, 2.0))
    with pytest.raises(
        ValueError, match=r"P.dt = 1.0 differs from Ts = 2.0: sample the model"
    ):
        design.check(control.sample_system(control.ss(-1.0, 1, 1, 0), 1.0))


def test_above_a_table_the_assumed_size_counts(design):
    own = np.geomspace(1e-3, 0.4, 60)
    low = design.check(samples(lag(), own), own)
    problem = pose(samples(lag(), own), Q, own, order=1, L_max=None, objective="peak")
    high = check(replace(problem, beyond=20.0), design.filter)
    assert low.gamma < 1 < high.gamma and high.at >= own[-1]
    assert low.converges and not high.converges
    assert str(high).startswith(
        "need not converge"
    ) and "sigma_max(P) is 20 at most" in str(high)


def test_samples_of_Q_are_known_at_the_design_frequencies_only():
    q = Q.frequency_response(OMEGA)
    design = synthesise(lag(), q, OMEGA, 1.0, order=5, L_max=5.0, band=(1e-3, 0.1))
    assert design.check(lag()).gamma == pytest.approx(
        design.certificate.all_M, rel=1e-6
    )
    with pytest.raises(ValueError, match="omega must be the design frequencies"):
        design.check(lag(), OMEGA[::2])
