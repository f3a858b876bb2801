"""Several plants as one model: against the formula of the law, dense matrices and each norm."""

import time

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import as_matrix, lags, lifted

from ilctools import frequency_response, load_law, save_law, synthesise, zero_phase_butterworth
from ilctools.base import base_of_models
from ilctools.evidence.finite import settled_norm, trial_norm
from ilctools.evidence.worst_trial import largest_trial_norm, matrix_on_trial
from ilctools.filters import LearningFilter
from ilctools.pooled import CHANGES, pooled

TS = 0.01
Q = zero_phase_butterworth(2, 40.0, TS)
AXIS = control.ss(control.sample_system(control.tf([400], [1, 20, 400]), TS))


def copies(count):
    """One plant with as many gains."""
    return [AXIS * (1 + k / 400) for k in range(count)]


def others(count, seed=0):
    """Plants with poles of their own."""
    random, plants = np.random.default_rng(seed), []
    for _ in range(count):
        corner, damping = 20 * random.uniform(0.8, 1.25), random.uniform(0.35, 0.65)
        plant = control.tf([corner**2], [1, 2 * damping * corner, corner**2])
        plants.append(control.ss(control.sample_system(plant, TS)))
    return plants


def coupled(count):
    """Two channels, each plant with poles and gains of its own."""
    random = np.random.default_rng(1)
    return [lags(random.uniform(0.9, 1.1), random.uniform(0.85, 0.93)) for _ in range(count)]


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
    masked = np.tile(kept, (N, N))
    P_N = [masked * lifted(plant, N) for plant in plants]
    normal = np.mean([P.T @ P for P in P_N], axis=0) + b**2 * np.eye(N * m)
    dense = np.linalg.solve(normal, np.mean(P_N, axis=0).T)
    assert_allclose(P_N[0] @ as_matrix(base.apply, N, m), P_N[0] @ dense, rtol=0, atol=1e-8)
    assert_allclose(base.matrix(N), as_matrix(base.apply, N, m), rtol=0, atol=1e-10)


def test_copies_of_a_plant_have_its_states_and_no_more_outputs_than_states_and_inputs():
    P, E = pooled(copies(60), 0.05, CHANGES[0])
    assert P.nstates == AXIS.nstates and P.noutputs == AXIS.nstates + 1 == len(E)
    gains = 1 + np.arange(60) / 400
    assert np.linalg.norm(P(1)) == pytest.approx(np.sqrt(np.mean(gains**2)), rel=1e-9)
    assert (E.T @ P(1)).item() == pytest.approx(gains.mean(), rel=1e-9)


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
@pytest.mark.parametrize(("first", "order"), [(1, 4), (-3, 7), (-5, 2), (30, 3), (-80, 161)])
def test_the_matrix_of_a_filter_is_what_it_does_to_unit_signals(first, order, ends):
    taps = np.random.default_rng(1).standard_normal((2, 2, order))
    L = LearningFilter(taps, 1.0, ends, first)
    # of a filter of 161 samples, a fast transform: its rounding
    assert_allclose(matrix_on_trial(L, 9), as_matrix(L.apply, 9, 2), rtol=0, atol=1e-11)


@pytest.mark.parametrize("plants", [copies(5), others(10), coupled(4), others(40, seed=3)])
@pytest.mark.parametrize("how", [{}, {"order": 10, "base": None}, {"reach": 60}])
def test_the_norm_of_a_trial_is_the_largest_of_all_plants(plants, how):
    """Also where most are left out: each of them by itself, by sparse factors and ARPACK."""
    low = zero_phase_butterworth(2, 0.4 / plants[0].dt, plants[0].dt)
    design = synthesise(plants, low, **how)
    L, samples = design.filter, 120
    norms = [trial_norm(P, low, L, samples)[0] for P in plants]
    assert largest_trial_norm(plants, low, L, samples) == pytest.approx(max(norms), rel=1e-7)
    worst_last = [P for _, P in sorted(zip(norms, plants, strict=True), key=lambda pair: pair[0])]
    assert largest_trial_norm(worst_last, low, L, samples) == pytest.approx(max(norms), rel=1e-7)
    assert design.certificate.trial == settled_norm(plants, low, design.certificate.scaled_filter)


def test_what_is_seen_of_a_list_stays_what_it_was_with_all_states():
    """Rates and norms as they were when B had the states of all plants, to a millionth."""
    for plants, rate, norm in [
        (copies(5), 0.007681512178890018, 0.3122084903517244),
        (copies(10), 0.011778654222479567, 0.31241008972783363),
    ]:
        certificate = synthesise(plants, Q).certificate
        assert certificate.rate == pytest.approx(rate, rel=1e-6)
        assert certificate.trial[1] == pytest.approx(norm, rel=1e-6)


@pytest.mark.parametrize("plants", [copies(40), others(40)])
def test_forty_plants_are_designed_and_printed_in_seconds(plants):
    """0.9 and 1.2 s of CPU; with the states of all plants 76 s and more."""
    begin = time.process_time()
    design = synthesise(plants, Q)
    assert "norm of a trial" in repr(design) and design.certificate.failures == []
    assert time.process_time() - begin < 15


def test_a_file_keeps_the_base_of_several_plants(tmp_path):
    law = synthesise(others(12), Q).law()
    save_law(tmp_path / "law.json", law)
    read, e = load_law(tmp_path / "law.json"), np.random.default_rng(0).standard_normal((50, 1))
    assert_allclose(read.next(0 * e, e), law.next(0 * e, e), rtol=1e-12)
