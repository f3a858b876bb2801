"""The sum weighted by a reference: every way through the synthesis ends at its optimum."""

import numpy as np
import pytest
from plants import bump, half, random_response, response_of, sigma_of_M
from problems import optimum

from ilctools import synthesise, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.synthesis.design import certified

CASES = half([1, 2], ["diagonal", "full"], ["plain", "radius", "plants"])


@pytest.mark.parametrize(("m", "structure", "kind"), CASES)
def test_the_weighted_sum_is_minimised(m, structure, kind):
    """CVXPY finds the same."""
    P, Q, omega = random_response(m, m, grid=np.geomspace if m == 1 else np.linspace)
    plants = [P, 1.05 * P] if kind == "plants" else P
    choices = {"order": 3, "M_max": 0.97, "L_max": 20.0, "structure": structure}
    choices["uncertainty"] = np.full(len(omega), 0.02) if kind == "radius" else None
    reference = bump(100, 1.0 + np.arange(m))
    problem = pose(plants, Q, omega, 1.0, reference=reference, **choices)
    design = certified(problem)
    sigma = sigma_of_M(omega, P, Q, response_of(design.filter.coefficients, omega))
    assert design.value == pytest.approx(problem.objective.weights @ sigma, rel=1e-9)
    assert design.certificate.gap < 1e-6
    theirs, *_ = optimum(design.certificate.grid)
    assert design.value == pytest.approx(theirs, abs=1e-6 * problem.idle)


def test_a_reference_goes_with_everywhere_and_without_Q(loop):
    """Added frequencies have no weight."""
    Q, reference = zero_phase_butterworth(2, 0.1, 1.0), bump(1000, [1.0, 2.0])
    # so fine that L needs no bound between its samples
    omega = np.geomspace(1e-3, np.pi, 200)
    choices = {"order": 10, "L_max": 50.0, "reference": reference}
    plain = synthesise(loop, Q, omega, **choices)
    design = synthesise(loop, Q, omega, everywhere=True, **choices)
    certificate = design.certificate
    assert certificate.all_M <= 0.9 * (1 + 1e-6)
    assert len(certificate.grid.omega) > 200
    weighted = certificate.grid.objective.weights > 0
    assert set(certificate.grid.omega[weighted]) <= set(omega)
    assert design.value >= plain.value * (1 - 1e-9)
    chosen = synthesise([loop, loop], None, omega, reference=reference)
    assert chosen.problem.lowpass.cutoff > 0.02 and chosen.certificate.predicted[2] > 0
    assert np.isfinite(chosen.certificate.lower_bound) and chosen.problem.order == 21  # K of B K
