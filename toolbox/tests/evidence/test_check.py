"""What a filter does on another plant: the rate, and whether it converges."""

from dataclasses import replace

import control
import numpy as np
import pytest
from paper import paper_choices
from plants import tanks

from ilctools import convergence, current_trial_loop, rate, synthesise, zero_phase_butterworth
from ilctools.evidence.check import check
from ilctools.evidence.peak import error_model, peak_gain
from ilctools.problem.pose import pose

Q = zero_phase_butterworth(2, 0.3, 1.0)
OMEGA = np.geomspace(1e-3, np.pi, 250)
ASKED = {"order": 5, "L_max": 5.0, "band": (1e-3, 0.1)}


def lag(gain=1.0, pole=0.9):
    return control.ss(pole, gain * (1 - pole), 1, 0, 1.0)


@pytest.fixture(scope="module")
def design():
    return synthesise(lag(), Q, OMEGA, 1.0, **ASKED)


def samples(P, omega=OMEGA):
    return P(np.exp(1j * omega))[:, None, None]


@pytest.mark.parametrize(("gain", "monotone"), [(1.3, True), (3.0, False)])
def test_on_a_model_it_is_proven(design, gain, monotone):
    P = lag(gain, 0.93)
    result, as_array = design.check(P), design.check(samples(P))
    gamma, omega = peak_gain(error_model(P, design.filter), Q)
    assert result.gamma == pytest.approx(gamma, rel=1e-8) and result.proven
    assert result.at == pytest.approx(omega, rel=1e-3)
    assert result.monotone == monotone == result.converges
    how = "converges monotonically" if monotone else "diverges"
    assert str(result).startswith(f"{how}: sigma_max(M) is {gamma:.4f} at most")
    assert "at all frequencies" in str(result) and result.assumptions == ()
    assert as_array.gamma == pytest.approx(gamma, rel=1e-3) and not as_array.proven
    assert as_array.spectral_radius == pytest.approx(result.spectral_radius, rel=1e-12)
    assert "not proven between samples" in str(as_array)


def test_with_two_channels_trials_may_converge_and_not_monotonically():
    """M = Q (I - P L) is nearly nilpotent where the coupling goes one way only."""
    apart = control.ss(0.5 * np.eye(2), 0.5 * np.eye(2), np.eye(2), 0, 1.0)
    coupled = control.ss(0.5 * np.eye(2), [[0.5, 4.0], [0, 0.5]], np.eye(2), 0, 1.0)
    design = synthesise(apart, Q, OMEGA, 1.0, **ASKED)
    result, P = design.check(coupled), np.moveaxis(coupled(np.exp(1j * OMEGA)), -1, 0)
    on_grid = convergence(P, Q, design.filter, OMEGA)
    assert result.gamma >= on_grid.gamma > 1
    assert result.spectral_radius == pytest.approx(on_grid.spectral_radius, rel=1e-6)
    assert not result.monotone and result.converges
    assert str(result).startswith("converges, not monotonically")
    unsure = design.check(coupled, uncertainty=np.full(250, 1e-3))
    assert not unsure.converges and str(unsure).startswith("need not converge")


def test_a_loop_brings_its_P_and_tables_their_own_grid(loop):
    Q, own = zero_phase_butterworth(2, 0.1, 1.0), np.geomspace(1e-4, 2.0, 70)
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 250), **paper_choices())
    all_M, P = design.certificate.all_M, loop.frequency_response(own)
    assert design.check(loop).gamma == pytest.approx(all_M, rel=1e-9)
    result = design.check(control.frd(np.moveaxis(P, 0, -1), own))
    assert result.gamma == pytest.approx(all_M, rel=1e-2)
    assert result.gamma >= rate(P, Q, design.filter, own).gamma
    assert "assumed: above 2 rad/s, where P is not known" in str(result)
    unsure = design.check(P, own, uncertainty=np.full(70, 1e-3))
    assert result.gamma < unsure.gamma and not unsure.proven


def test_in_other_units_the_rate_is_the_same():
    loop = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
    Q, omega = zero_phase_butterworth(2, 0.005, 2.0), np.geomspace(1e-4, np.pi, 250) / 2
    asked = {"scale": [1.0, 10.0, 0.1], "L_max": 20.0, "band": (1e-4, 0.002)}
    asked |= {"order": 10, "structure": "diagonal"}
    design = synthesise(loop, Q, omega, **asked)
    result = design.check([loop, loop.frequency_response(omega)])
    assert result.gamma == pytest.approx(design.certificate.all_M, rel=1e-4)
    with pytest.raises(ValueError, match="scale has shape"):
        design.check(control.ss(0.5, 0.5, 1, 0, 2.0))


def test_above_a_table_the_assumed_size_counts(design):
    own = np.geomspace(1e-3, 0.4, 60)
    low = design.check(samples(lag(), own), own)
    problem = pose(samples(lag(), own), Q, own, order=1, L_max=None, objective="peak")
    high = check(replace(problem, beyond=20.0), design.filter)
    assert low.gamma < 1 < high.gamma and high.at >= own[-1]
    assert low.converges and str(high).startswith("need not converge")
    assert "sigma_max(P) is 20 at most" in str(high)


def test_samples_of_Q_are_known_at_the_design_frequencies_only():
    design = synthesise(lag(), Q.frequency_response(OMEGA), OMEGA, 1.0, **ASKED)
    gamma = design.check(lag()).gamma
    assert gamma == pytest.approx(design.certificate.all_M, rel=1e-6)
    with pytest.raises(ValueError, match="omega must be the design frequencies"):
        design.check(lag(), OMEGA[::2])
