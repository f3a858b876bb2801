"""L = B K: B against its formula, the design against CVXPY and dense grids; trials: test_pooled."""

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import STAGE_WITH_MODES as STAGE
from plants import as_matrix, furnace, sigma_of_M
from problems import statement

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    frequency_response,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.base import RegularisedInverse
from ilctools.evidence.peak import peak_of_L, peak_of_M
from ilctools.problem.problem import K_MAX

LOOP, Q = ClosedLoop(STAGE), zero_phase_butterworth(2, 150.0, 1e-3)
COUPLED = control.ss(
    [[0.9, 0.1, 0], [-0.1, 0.8, 0.1], [0, 0, 0.5]], [[0.1, 0], [0, 0.2], [0.3, 0.1]],
    [[1, 0, 0.2], [0, 1, 0]], 0, 1.0,
)  # fmt: skip


def errors_of(L, reference, trials, **how):
    """RMS in trials on the stage."""
    return rms(run_trials(LOOP, Law(Q, L), reference, trials=trials, **how).e).values


@pytest.fixture(scope="module")
def with_base():
    """L = B K on trials of any length."""
    return synthesise(STAGE, Q, base=0.03)


@pytest.fixture(scope="module")
def finite():
    """The same as a filter that reaches so far, for trials without reset."""
    return synthesise(STAGE, Q, base=0.03, reach=200)


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
@pytest.mark.parametrize(("first", "order"), [(1, 4), (-3, 7), (-5, 2), (3, 2), (-80, 161)])
def test_a_filter_is_a_sum_over_samples_and_its_transpose_the_transpose(first, order, ends):
    N, taps = 9, np.random.default_rng(1).standard_normal((2, 2, order))
    at = np.arange(N)[:, None] + first + np.arange(order)
    taken = np.eye(N)[np.clip(at, 0, N - 1)]
    taken[at < 0] *= ends == "hold"
    taken[at >= N] *= ends != "zero"
    dense = np.einsum("pkq,ijk->piqj", taken, taps).reshape(2 * N, 2 * N)
    L = LearningFilter(taps, 1.0, ends, first)
    for apply, matrix in ((L.apply, dense), (L.apply_transposed, dense.T)):
        assert_allclose(as_matrix(apply, N, 2), matrix, rtol=0, atol=1e-12)


def test_the_optimum_is_that_of_the_statement_with_P_B_in_the_place_of_P():
    omega = np.geomspace(1e-2, np.pi, 60)
    low = zero_phase_butterworth(2, 0.5, 1.0)
    design = synthesise(COUPLED, low, omega, order=7, base=0.2, L_max=None)
    assert "order = 7 of K in L = B K" in repr(design)
    problem = design.problem
    through = problem.P @ problem.of_K
    _, value = statement(
        through, problem.Q, omega, 1.0, order=7, band=problem.objective.band, L_max=K_MAX
    )
    assert design.value == pytest.approx(value, rel=1e-5)


@given(st.integers(0, 10**6), st.sampled_from([0.3, 0.03]), st.booleans())
def test_proven_peaks_are_those_of_a_dense_grid(seed, b, finite):
    random = np.random.default_rng(seed)
    poles = random.uniform(0.2, 0.98, 2)
    A = np.diag(poles) + 0.1 * np.triu(random.standard_normal((2, 2)), 1)
    P = control.ss(A, random.standard_normal((2, 1)), random.standard_normal((1, 2)), 0, 1.0)
    base = RegularisedInverse(P, b * abs(P(1)) + 1e-3, [1.0])
    if finite:
        base = LearningFilter(random.standard_normal((1, 1, 41)) / 9, 1.0, first=-20)
    L = base @ LearningFilter(random.standard_normal((1, 1, 5)) / 2, 1.0, first=-2)
    low = zero_phase_butterworth(2, 0.5, 1.0)
    omega = np.linspace(0, np.pi, 4001)
    M, gain = sigma_of_M(omega, P, low, L), np.abs(L.frequency_response(omega))
    for (peak, _), seen in ((peak_of_M(P, L, low), M), (peak_of_L(L), gain)):
        assert seen.max() * (1 - 1e-12) <= peak <= seen.max() * (1 + 1e-4)


def test_without_reset_it_is_refused_for_the_operator_and_learns_as_a_finite_filter(
    with_base, finite
):
    reference = np.sin(2 * np.pi * np.arange(600) / 600) ** 3
    with pytest.raises(ValueError, match="reach"):
        errors_of(with_base.filter, reference, 12, reset=False)
    errors = errors_of(finite.filter, reference, 12, reset=False)
    omega = np.fft.rfftfreq(600, 1e-3 / (2 * np.pi))
    P, L = (f(omega)[:, 0, 0] for f in (LOOP.frequency_response, finite.filter.frequency_response))
    low = Q.frequency_response(omega)
    left = (1 - low) * (1 - P) / (1 - low * (1 - P * L))  # of the periodic motion
    limit = np.fft.irfft(left * np.fft.rfft(reference), 600)
    assert errors[-1] == pytest.approx(np.sqrt(np.mean(limit**2)), rel=1e-2)


@pytest.mark.parametrize("share", [1.0, 0.0, "none", True])
def test_a_base_that_is_no_share_is_refused(share):
    with pytest.raises(ValueError, match="base = "):
        synthesise(STAGE, Q, base=share)


def test_K_does_not_leave_the_error_to_the_end_of_a_trial(with_base, finite):
    """Beyond it there is none: K of a base that knows the end takes the last to stand still."""
    reference = np.sin(np.pi * np.arange(300) / 400) ** 4  # it is cut off while it moves
    L = with_base.filter
    assert (L.K.ends, finite.filter.ends) == ("hold-last", "zero")
    zero = replace(L, K=replace(L.K, ends="zero"))
    assert errors_of(L, reference, 4)[-1] < 0.9 * errors_of(zero, reference, 4)[-1]


def test_of_a_list_L_is_the_quadratic_law_of_all_plants_and_keeps_its_bound():
    plants, scale = [COUPLED, 1.2 * COUPLED], [1.0, 4.0]
    omega, low = np.linspace(1e-2, np.pi, 400), zero_phase_butterworth(2, 0.3, 1.0)
    P = np.array([frequency_response(one, omega) for one in plants])
    design = synthesise(plants, low, omega, 1.0, scale=scale)
    assert design.problem.order == 1 and design.sigma_L.max() <= design.problem.L_max * (1 + 1e-9)
    units = np.divide.outer(1 / np.array(scale), 1 / np.array(scale))
    P, b = P * units, 1 / (2 * design.problem.L_max)
    adjoint = P.conj().swapaxes(2, 3)
    L = np.linalg.solve((adjoint @ P).mean(axis=0) + b**2 * np.eye(2), adjoint.mean(axis=0))
    found = design.filter.frequency_response(omega)
    atol = 1e-9 * np.abs(L / units).max()
    assert_allclose(found[omega < 0.3], (L / units)[omega < 0.3], rtol=0, atol=atol)


def test_the_unit_of_y_decides_nothing():
    """Behind a delay of thirty samples, whose B has poles that rounding may hide."""
    ours, *others = (synthesise(gain * furnace(30)).certificate for gain in (1.0, 1e-8, 1e6))
    for theirs in others:
        assert theirs.rate == pytest.approx(ours.rate, rel=1e-6)
        assert theirs.settled_trial.norm == pytest.approx(ours.settled_trial.norm, rel=1e-6)


def test_where_P_passes_nothing_the_rest_is_learned_and_print_says_where():
    """Behind an AC amplifier: M is one at rest for any L, and below one elsewhere."""
    P = control.ss(STAGE * control.ss(control.tf([1, -1], [1, -0.995], 1e-3)))
    low = zero_phase_butterworth(2, 60.0, 1e-3)
    omega = np.linspace(0, np.pi / 1e-3, 800)
    design = synthesise(P, low)
    assert "P passes nothing at 0 rad/s" in repr(design) and design.certificate.failures == []
    above = np.linspace(design.omega[0], np.pi / 1e-3, 20_000)
    assert convergence(P, low, design.filter, above).rate < 0.5
    with pytest.raises(ValueError, match=r"P is singular at omega = 0 .* leave such"):
        synthesise(frequency_response(P, omega), low, omega)


def test_a_gain_without_states_is_learned():
    P = np.array([[2.0, 0.5], [0.0, 1.0]])
    design = synthesise(control.ss([], [], [], P, 0.1))
    b = 1 / (2 * design.problem.L_max)
    B = np.linalg.solve(P.T @ P + b**2 * np.eye(2), P.T)  # of norm-optimal learning
    assert np.allclose(design.filter.frequency_response([0.1, 5.0]), B, rtol=1e-9, atol=0)
