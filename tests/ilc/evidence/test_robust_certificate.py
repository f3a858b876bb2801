"""What the certificate of a design for several plants, or for a radius, says."""

from dataclasses import replace

import control
import numpy as np
import pytest

from rodlib import LearningFilter, synthesise, zero_phase_butterworth
from rodlib.ilc import worst_case
from rodlib.ilc.evidence.peak import LOOKED_AT, error_model, peak_gain
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.problem import convergence_matrix

OMEGA = np.geomspace(1e-3, np.pi, 50)
Q = zero_phase_butterworth(2, 0.3)
ASKED = {"order": 4, "M_max": 0.6, "L_max": 5.0, "band": (1e-3, 0.1)}


def lag(gain=1.0, pole=0.9):
    """Two lags with coupling."""
    return control.ss(
        [[pole, 0.05], [0.02, pole - 0.1]],
        gain * np.diag([0.1, 0.2]),
        np.eye(2),
        0,
        1.0,
    )


MODELS = [lag(), lag(1.3), lag(0.8, 0.93)]


def test_models_have_a_proof_each_and_the_worst_is_named():
    design = synthesise(MODELS, Q, OMEGA, 1.0, **ASKED)
    certificate = design.certificate
    peaks = [peak_gain(error_model(P, design.filter), Q) for P in MODELS]
    worst = int(np.argmax(peaks, axis=0)[0])
    assert (certificate.all_M, certificate.peak.omega) == peaks[worst]
    assert certificate.peak.plant == worst > 0
    assert {plant for plant, _ in certificate.worst.tied} == {worst}
    assert certificate.proven and certificate.failures == certificate.warnings == []
    assert certificate.grid_M == pytest.approx(0.6, rel=1e-9)
    text = str(certificate)
    assert f"worst of 3 plants on the design grid: plant {worst} at " in text
    assert f"  of the nominal plant    {design.sigma_M.max():.8f}\n" in text
    problem, peak = (
        replace(certificate.problem, M_max=0.1),
        replace(certificate.peak, sigma=1.1),
    )
    broken = replace(certificate, problem=problem, peak=peak, exact=peak)
    assert f"FAILS: sigma_max(M) at its worst (plant {worst} at " in str(broken)
    assert f"FAILS: sigma_max(M) of plant {worst} reaches 1.1 at " in str(broken)


@pytest.mark.parametrize("as_models", [False, True])
def test_with_a_radius_nothing_is_said_of_it_between_the_samples(as_models):
    P = frequency_response(MODELS[0], OMEGA)
    radius = 0.1 * np.linalg.norm(P, 2, axis=(1, 2))
    plant = MODELS[0] if as_models else P
    design = synthesise(plant, Q, OMEGA, 1.0, uncertainty=radius, **ASKED)
    certificate, text = design.certificate, str(design.certificate)
    L = LearningFilter(design.solution.coefficients, 1.0)
    worst = worst_case(design.problem, L)
    assert certificate.grid_M == worst.sigma.max() > design.sigma_M.max()
    assert f"within the radius reaches {certificate.grid_M:.8f} there" in text
    assert certificate.failures == [] and certificate.proven == as_models
    assert certificate.all_M < 0.6 and "over all frequencies       not known" in text
    assert "between the samples the radius is not known" in text
    assert ("over all frequencies without the radius: 0." in text) == as_models
    assert ("without the radius from 0.001 to 3.142 rad/s, between" in text) == (
        not as_models
    )
    assert "worst within the radius on the design grid: at " in text
    broken = str(replace(certificate, problem=replace(certificate.problem, M_max=0.1)))
    assert "FAILS: sigma_max(M) at its worst (at " in broken


def test_of_many_sampled_plants_those_worst_on_the_grid_are_looked_at_in_between():
    gains = np.linspace(0.9, 1.1, 30)
    plants = [frequency_response(lag(gain), OMEGA) for gain in (1.0, *gains)]
    design = synthesise(plants, Q, OMEGA, 1.0, **ASKED)
    certificate = design.certificate
    dense = np.geomspace(1e-3, np.pi, 5000)
    worst = frequency_response(lag(gains[certificate.peak.plant - 1]), dense)
    M = convergence_matrix(
        worst, Q.frequency_response(dense), design.filter.frequency_response(dense)
    )
    peak = np.linalg.norm(M, 2, axis=(1, 2)).max()
    assert (
        certificate.all_M == pytest.approx(peak, rel=1e-5)
        and certificate.peak.plant > 0
    )
    assert certificate.estimated == LOOKED_AT and not certificate.proven
    assert f"estimated for the {LOOKED_AT} sampled plants that are worst" in str(
        certificate
    )
    two = synthesise([plants[0], MODELS[1]], Q, OMEGA, 1.0, **ASKED).certificate
    assert not two.proven and two.estimated == 1 and two.exact.plant == 1
    assert "estimated for the 1 sampled plants that are worst" in str(two)


def test_a_model_among_samples_keeps_its_proof():
    plants = [MODELS[0], frequency_response(MODELS[2], OMEGA), MODELS[1]]
    design = synthesise(plants, Q, OMEGA, 1.0, **ASKED)
    certificate = design.certificate
    assert not certificate.proven and certificate.estimated == 1
    proven = [peak_gain(error_model(MODELS[k], design.filter), Q)[0] for k in (0, 1)]
    assert certificate.exact.sigma == max(proven) <= certificate.all_M
    assert "estimated for the 1 sampled plants that are worst" in str(certificate)


def test_a_design_for_one_plant_says_nothing_of_others():
    certificate = synthesise(MODELS[0], Q, OMEGA, 1.0, **ASKED).certificate
    assert "plant" not in str(certificate) and "radius" not in str(certificate)


@pytest.mark.parametrize("radius", [None, np.full(50, 0.05)], ids=["plants", "radius"])
@pytest.mark.parametrize("unit", [-1e-13, 1e-13])
def test_those_that_are_tied_are_all_named_whatever_the_rounding(unit, radius):
    """The third plant is the second but for rounding."""
    plants = [frequency_response(P, OMEGA) for P in (MODELS[0], MODELS[1], MODELS[1])]
    plants[2] *= 1 + unit
    asked = ASKED | {
        "objective": "peak",
        "M_max": 0.99,
        "L_max": None,
        "uncertainty": radius,
    }
    design = synthesise(plants, Q, OMEGA, 1.0, **asked)
    L = design.filter.frequency_response(OMEGA)
    q = Q.frequency_response(OMEGA)
    gains = [np.linalg.norm(convergence_matrix(P, q, L), 2, (1, 2)) for P in plants]
    gains = np.array(gains)
    worst = tuple((k, OMEGA[at]) for k, at in design.certificate.worst.tied)
    if radius is None:
        frequency, plant = np.nonzero(gains.T / gains.max() > 1 - 1e-7)
        assert worst == tuple(
            zip(plant.tolist(), OMEGA[frequency].tolist(), strict=True)
        )
    for _, omega in worst:
        assert ((1, omega) in worst) == ((2, omega) in worst)
    assert (1 in dict(worst)) and worst == tuple(
        sorted(worst, key=lambda pair: pair[::-1])
    )
    where = ", ".join(f"plant {k} at {omega:.4g}" for k, omega in worst[:4]) + " rad/s"
    where += f" and {len(worst) - 4} more" if len(worst) > 4 else ""
    assert f" on the design grid: {where}\n" in str(design.certificate)
