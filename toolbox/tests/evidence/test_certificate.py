"""What a certificate says, of one plant, of several, of a radius and of another plant."""

from dataclasses import replace

import control
import numpy as np
import pytest
from paper import paper_choices
from plants import lag, lags
from problems import posed

from ilctools import LearningFilter, convergence, synthesise, zero_phase_butterworth
from ilctools.evidence.certificate import check
from ilctools.evidence.peak import peak_of_M
from ilctools.models import frequency_response

OMEGA = np.geomspace(1e-3, np.pi, 64)  # one round is enough for four samples, see problem.grid
BUTTERWORTH = zero_phase_butterworth(2, 0.3, 1.0)
ASKED = {"order": 4, "M_max": 0.6, "L_max": 5.0, "band": (1e-3, 0.1), "structure": "diagonal"}
FINE = np.geomspace(1e-4, np.pi, 250)  # from so far down that next to nothing moves below


MODELS = [lags(), lags(1.3), lags(0.8, 0.93)]


def of_lags(plants, omega=OMEGA, Q=BUTTERWORTH, **changes):
    return synthesise(plants, Q, omega, 1.0, **ASKED | changes)


@pytest.fixture(scope="module")
def good(loop, Q, omega):
    return synthesise(loop, Q, omega[::5], 1.0, **paper_choices(band=(1e-4, 0.01))).certificate


@pytest.mark.parametrize(
    ("gap", "M", "L", "anywhere", "codes"),
    [
        (0.99e-6, 1 + 0.99e-9, 1 + 0.99e-9, 0.924, ""),
        (1.01e-6, 1 + 1.01e-9, 1 + 1.01e-9, 0.924, "gap, on the grid, on the grid"),
        (0, 1, 1, 0.926, "between"),
        (0, 1, 1, 1 - 1e-15, "between"),
        (0, 1, 1, 1.0, "one or more"),
    ],
)
def test_a_certificate_fails_and_warns_from_its_limits_on(good, gap, M, L, anywhere, codes):
    """Relative passes of 1e-6 and 1e-9; one anywhere; a quarter of the room between M and one."""
    peak = replace(good.peak, sigma=anywhere, omega=0.25)
    on_grid = replace(good.peaks["on the grid"], sigma=0.9 * M)
    asked = {
        "sigma_L": good.sigma_L * 50 * L / good.sigma_L.max(),
        "lower_bound": good.value * (1 - gap),
    }
    changed = replace(good, peaks={"on the grid": on_grid, "proven": peak}, **asked)
    found = changed.failures + changed.warnings
    assert ", ".join(one.code for one in found) == codes
    if anywhere > 0.925:
        assert (found[0].value, found[0].place) == (anywhere, "at 0.25 rad/s")
    estimate = replace(good, peaks={"on the grid": on_grid, "estimated": peak}).warnings
    assert [one.code for one in estimate] == ["samples"] * (anywhere > 0.925)


def test_learning_that_does_nothing_is_named():
    problem = posed(lags(), BUTTERWORTH, OMEGA, 1.0, order=10)
    [found] = check(problem, LearningFilter(np.zeros((2, 2, 10)), 1.0)).warnings
    assert (found.code, found.value) == ("idle", 1)


def test_models_have_a_proof_each_and_the_worst_is_named():
    design = of_lags(MODELS)
    certificate = design.certificate
    peaks = [peak_of_M(P, design.filter, BUTTERWORTH) for P in MODELS]
    worst = int(np.argmax(peaks, axis=0)[0])
    peak = certificate.peaks["proven"]
    assert (certificate.all_M, peak.omega) == peaks[worst] and peak.plant == worst > 0
    assert certificate.proven and certificate.failures == certificate.warnings == []
    assert certificate.grid_M == pytest.approx(0.6, rel=1e-9)


@pytest.mark.parametrize("model", [False, True])
def test_between_the_samples_the_radius_is_interpolated(model):
    """Judged on a dense grid by the exact bound; a model alone keeps its proof."""
    P = frequency_response(MODELS[0], OMEGA)
    radius = 0.1 * np.linalg.matrix_norm(P, ord=2)
    design = of_lags(MODELS[0] if model else P, uncertainty=radius)
    certificate = design.certificate
    assert certificate.failures == [] and not certificate.proven
    near = certificate.peaks["estimated"].omega * np.linspace(0.99, 1.01, 201)
    dense = np.union1d(np.geomspace(1e-3, np.pi, 2001)[1:-1], near.clip(2e-3, 3.14))
    wide = np.interp(np.log(dense), np.log(OMEGA), radius)
    worst = design.check(MODELS[0], dense, uncertainty=wide).sigma.max()
    assert certificate.all_M == pytest.approx(max(worst, certificate.grid_M), rel=1e-6)
    assert certificate.all_M > design.sigma_M.max()
    assert ("proven" in certificate.peaks) == model


def test_a_plant_that_diverges_between_the_samples_is_not_said_to_converge():
    """A resonance at 60 rad/s that no design frequency sees."""
    lag, Q = control.tf([10], [1, 10]), zero_phase_butterworth(2, 100.0, 0.01)
    omega = np.geomspace(0.1, np.pi / 0.01, 60)
    plant, resonant = (
        control.sample_system(lag + mode, 0.01) for mode in (0, control.tf([7.2], [1, 0.06, 3600]))
    )
    design = synthesise(plant, Q, omega, M_max=0.97, order=10, band=(0.1, 20.0), everywhere=True)
    assert not design.check(resonant).converges
    samples = control.frd(resonant(np.exp(0.01j * omega)), omega, 0.01)
    assert not design.check(samples).converges  # between them splines may miss as much


@pytest.fixture(scope="module")
def design():
    return of_lags(lag(), FINE)


@pytest.mark.parametrize(("gain", "monotone"), [(1.3, True), (3.0, False)])
def test_on_a_model_it_is_proven(design, gain, monotone):
    P = lag(0.93, gain)
    result, as_array = design.check(P), design.check(frequency_response(P, FINE))
    gamma, omega = peak_of_M(P, design.filter, BUTTERWORTH)
    assert result.rate == pytest.approx(gamma, rel=1e-8) and result.proven
    assert result.at == pytest.approx(omega, rel=1e-3)
    assert result.monotone == monotone == result.converges
    assert repr(result).startswith("converges monotonically" if monotone else "diverges")
    assert result.assumptions == ()
    assert as_array.rate == pytest.approx(gamma, rel=1e-3) and not as_array.proven
    assert result.spectral_radius == pytest.approx(gamma, rel=2e-6)  # of one channel
    assert as_array.spectral_radius == pytest.approx(as_array.rate, rel=1e-3)


def test_with_two_channels_trials_may_converge_and_not_monotonically():
    """M = Q (I - P L) is nearly nilpotent where the coupling goes one way only."""
    apart = control.ss(0.5 * np.eye(2), 0.5 * np.eye(2), np.eye(2), 0, 1.0)
    coupled = control.ss(0.5 * np.eye(2), [[0.5, 4.0], [0, 0.5]], np.eye(2), 0, 1.0)
    design = of_lags(apart, FINE)
    result = design.check(coupled)
    on_grid, dense = (
        convergence(coupled, BUTTERWORTH, design.filter, omega)
        for omega in (FINE, np.linspace(0.01, 3, 20_000))
    )
    assert result.rate >= on_grid.rate > 1
    assert on_grid.spectral_radius < result.spectral_radius <= dense.spectral_radius
    assert not result.monotone and result.converges
    unsure = design.check(coupled, uncertainty=np.full(250, 1e-3))
    assert not unsure.converges and str(unsure).startswith("need not converge")
