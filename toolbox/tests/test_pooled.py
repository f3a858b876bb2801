"""Several plants as one model: against the formula of the law, and dense matrices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import altered, as_matrix, copies, coupled, lifted, others, random_stable

from ilctools import frequency_response, load_law, save_law, synthesise, zero_phase_butterworth
from ilctools.base import base_of_models
from ilctools.pooled import CHANGES, pooled


@pytest.mark.parametrize("structure", ["full", "diagonal"])
@pytest.mark.parametrize("plants", [copies(9), others(30), coupled(20)])
def test_B_is_the_quadratic_law_of_all_plants_on_the_circle_and_on_a_trial(plants, structure):
    """M changes by 1e-9, so that P B does; on a trial, the norms of P and B are those at most."""
    b, N, m = 0.05, 12, plants[0].ninputs
    kept = np.eye(m) if structure == "diagonal" else np.ones((m, m))
    base = base_of_models(plants, b, structure)
    assert base.P.nstates < sum(P.nstates for P in plants)
    omega = np.linspace(0, np.pi / plants[0].dt, 300)
    P = kept * np.array([frequency_response(plant, omega) for plant in plants])
    adjoint = P.conj().swapaxes(2, 3)
    B = np.linalg.solve((adjoint @ P).mean(axis=0) + b**2 * np.eye(m), adjoint.mean(axis=0))
    assert_allclose(P[0] @ base.frequency_response(omega), P[0] @ B, rtol=0, atol=2e-9)
    P_N = [np.tile(kept, (N, N)) * lifted(plant, N) for plant in plants]
    normal = np.mean([P.T @ P for P in P_N], axis=0) + b**2 * np.eye(N * m)
    dense = np.linalg.solve(normal, np.mean(P_N, axis=0).T)
    assert_allclose(P_N[0] @ as_matrix(base.apply, N, m), P_N[0] @ dense, rtol=0, atol=1e-8)


def test_copies_of_a_plant_have_its_states_and_no_more_outputs_than_states_and_inputs():
    plants = copies(60)
    P, E = pooled(plants, 0.05, CHANGES[0])
    assert P.nstates == plants[0].nstates and P.noutputs == P.nstates + 1 == len(E)


def test_where_rounding_is_more_than_the_error_all_states_are_kept():
    """Of poles within 3e-6 of the circle, where few states would change M by 1e-7."""
    like = random_stable(54, distance=3e-6)
    plants = [altered(like, A=1 - 1e-6 * k) for k in range(5)]
    at_peak = frequency_response(like, np.abs(np.angle(like.poles())) / like.dt)
    b = 0.03 * np.linalg.norm(at_peak, 2, axis=(1, 2)).max()
    assert pooled(plants, b, CHANGES[0]).P.nstates == sum(P.nstates for P in plants)


def test_forty_plants_are_designed_with_few_states(tmp_path):
    """They have eighty; the time grows with the cube of those of B. A file keeps the base."""
    design = synthesise(others(40), zero_phase_butterworth(2, 40.0, 0.01))
    assert "norm of a trial" in repr(design) and design.certificate.failures == []
    assert design.problem.base.P.nstates <= 40
    save_law(tmp_path / "law.json", design.law())
    read, e = load_law(tmp_path / "law.json"), np.random.default_rng(0).standard_normal((50, 1))
    assert_allclose(read.next(0 * e, e), design.law().next(0 * e, e), rtol=1e-12)
