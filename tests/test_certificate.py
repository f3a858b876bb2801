from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import LearningFilter, published, run_trials, synthesise, zero_phase_butterworth
from rodlib.certificate import (
    convergence_model,
    learning_model,
    lower_bound,
    peak_gain,
    trial_map,
    trial_norm,
    trial_operators,
)
from rodlib.feedback import frequency_response
from rodlib.synthesis import convergence_matrix, largest_singular_values
from rodlib.trials import assumed_reference


def random_system(rng, n, m, scale=1.0):
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(A)).max()
    return control.ss(
        A, rng.standard_normal((n, m)) * scale, rng.standard_normal((m, n)), np.eye(m) * scale, 1.0
    )


@given(st.integers(1, 8), st.integers(1, 3), st.sampled_from([1e-6, 1.0, 1e6]), st.integers(0, 999))
def test_peak_gain_is_above_and_close_to_brute_force(n, m, scale, seed):
    system = random_system(np.random.default_rng(seed), n, m, scale)
    gain, place = peak_gain(system)
    angles = np.linspace(0, np.pi, 4001)
    brute = largest_singular_values(frequency_response(system, angles)).max()
    there = largest_singular_values(frequency_response(system, [place]))[0]
    assert brute <= gain * (1 + 1e-12)
    assert gain <= there * (1 + 1.01e-8)


def test_peak_gain_of_known_systems():
    lag = control.ss(0.5, 1, 1, 0, 1.0)  # 1 / (z - 0.5): peak 2 at z = 1
    assert peak_gain(lag)[0] == pytest.approx(2, rel=1e-8)
    resonance = control.ss([[1.8, -0.81 * 1.2], [1, 0]], [[1], [0]], [[1, 0]], 0, 1.0)
    gain, place = peak_gain(resonance)
    w = np.linspace(place - 1e-3, place + 1e-3, 200001)
    brute = np.abs(np.exp(2j * w) / (np.exp(2j * w) - 1.8 * np.exp(1j * w) + 0.972)).max()
    assert gain == pytest.approx(brute, rel=1e-8)
    assert peak_gain(control.ss([], [], [], [[3.0, 0], [0, 4]], 1.0))[0] == 4


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (control.ss(1.0, 1, 1, 0, 1.0), "unstable: it has a pole of modulus 1"),
        (control.ss(-1.0, 1, 1, 0), "must be a sampling period"),
        (control.ss(0.5, np.inf, 1, 0, 1.0), "must be finite"),
    ],
)
def test_bad_systems_are_refused(system, message):
    with pytest.raises(ValueError, match=message):
        peak_gain(system)


@pytest.mark.parametrize("name", ["L_diagonal", "L_full"])
def test_models_have_the_singular_values_of_M_and_L(loop, Q, name):
    L = LearningFilter(published.matrix(name), 1.0)
    omega = np.geomspace(1e-4, np.pi, 300)
    M = convergence_matrix(
        loop.frequency_response(omega), Q.frequency_response(omega), L.frequency_response(omega)
    )
    model = convergence_model(loop.P, Q, L)
    assert np.abs(model.poles()).max() < 1
    np.testing.assert_allclose(
        largest_singular_values(frequency_response(model, omega)),
        largest_singular_values(M),
        atol=1e-10,
    )
    np.testing.assert_allclose(
        largest_singular_values(frequency_response(learning_model(L), omega)),
        largest_singular_values(L.frequency_response(omega)),
        rtol=1e-12,
    )


def test_peaks_of_the_printed_filter_over_all_frequencies(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    dense = np.linspace(1e-5, np.pi, 200001)
    brute_L = largest_singular_values(L.frequency_response(dense)).max()
    gain, _ = peak_gain(learning_model(L))
    assert brute_L <= gain * (1 + 1e-13) and gain == pytest.approx(brute_L, rel=1e-7)
    assert gain > 50.03  # the paper's grid does not see this


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("L_max", [4.0, None])
def test_lower_bound_holds_for_any_multipliers(structure, objective, L_max):
    """Weak duality: no multipliers, however wrong, give a bound above a feasible value."""
    rng = np.random.default_rng(1)
    omega = np.linspace(0.05, np.pi, 40)
    z = np.exp(1j * omega)
    P = 0.5 / (z - 0.5)[:, None, None] * np.eye(2) + 0.1 * rng.standard_normal((2, 2))
    Q = 1 / (1 + omega**4)
    arguments = {"order": 3, "L_max": L_max, "band": (0.05, 1), "objective": objective}
    arguments["structure"] = structure
    design = synthesise(P, Q, omega, 1.0, **arguments)
    assert 0 <= design.certificate.gap + 1e-12 < 1e-8
    statement = {"order": 3, "M_max": 0.9, "L_max": L_max, "band_mask": omega <= 1}
    statement |= {"structure": structure, "objective": objective}
    for _ in range(20):
        U, V = rng.standard_normal((2, 40, 2, 2)) + 1j * rng.standard_normal((2, 40, 2, 2))
        V = None if L_max is None else V
        bound = lower_bound(P, Q, omega, U, V, **statement)
        assert bound <= design.value * (1 + 1e-9)


@pytest.mark.parametrize("ends", ["zero", "hold"])
def test_operators_are_what_the_trials_apply_and_their_adjoints(loop, ends):
    rng = np.random.default_rng(2)
    samples = 60
    Q = zero_phase_butterworth(ends=ends)
    L = LearningFilter(published.matrix("L_full"), 1.0, ends)
    P_N, Q_N, L_N = trial_operators(loop.P, Q, L, samples)
    x = rng.standard_normal((samples, 2))
    response = control.forced_response(loop.P, inputs=x.T).outputs.T
    np.testing.assert_allclose((P_N @ x.ravel()).reshape(-1, 2), response, atol=1e-10)
    np.testing.assert_allclose((Q_N @ x.ravel()).reshape(-1, 2), Q.apply(x), atol=1e-12)
    np.testing.assert_allclose((L_N @ x.ravel()).reshape(-1, 2), L.apply(x), atol=1e-11)
    for operator in (P_N, Q_N, L_N):
        matrix, adjoint = operator @ np.eye(2 * samples), operator.H @ np.eye(2 * samples)
        np.testing.assert_allclose(adjoint, matrix.T, atol=1e-11)


@pytest.mark.parametrize("ends", ["zero", "hold"])
def test_lanczos_finds_the_norm_of_the_matrix(loop, ends):
    Q = zero_phase_butterworth(ends=ends)
    L = LearningFilter(published.matrix("L_diagonal"), 1.0, ends)
    for trials, rest in ((1, 0), (3, 0), (1, 15)):
        matrix = trial_map(loop.P, Q, L, 120) @ np.eye(240)
        matrix[240 - 2 * rest :] = 0
        matrix[:, 240 - 2 * rest :] = 0
        norm, before, after = trial_norm(loop.P, Q, L, 120, trials, rest)
        expected = np.linalg.norm(np.linalg.matrix_power(matrix, trials), 2)
        assert norm == pytest.approx(expected, rel=1e-6)
        assert np.linalg.norm(before) == pytest.approx(1)
        assert np.linalg.norm(after) == pytest.approx(norm)


def test_trials_move_by_the_trial_map(loop, Q):
    """v_{k+1} - v_k obeys T as simulated by run_trials."""
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    run = run_trials(loop, Q, L, assumed_reference(300), None, 4)
    steps = np.diff(run.v.values, axis=0).reshape(3, -1)
    T = trial_map(loop.P, Q, L, 300)
    np.testing.assert_allclose(T @ steps[0], steps[1], atol=1e-9)
    np.testing.assert_allclose(T @ steps[1], steps[2], atol=1e-9)


def test_the_end_of_the_trial_breaks_the_norm_of_lemma_1(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    norm, _, after = trial_norm(loop.P, Q, L, 400)
    assert norm == pytest.approx(1.304, abs=1e-3)
    assert (after[-40:] ** 2).sum() > 0.9 * norm**2
    assert trial_norm(loop.P, Q, L, 400, trials=2)[0] < 1


def test_at_rest_near_the_end_v_converges_as_without_ends(loop, Q, omega):
    """The norm is then at most that of Q (I - L P), by which v converges on the whole line."""
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    without_ends = Q.frequency_response(omega)[:, None, None] * (
        np.eye(2) - L.frequency_response(omega) @ loop.frequency_response(omega)
    )
    peak = largest_singular_values(without_ends).max()
    assert peak == pytest.approx(0.9361, abs=1e-3)
    assert 0.98 * peak < trial_norm(loop.P, Q, L, 400, rest=15)[0] < peak
    with pytest.raises(ValueError, match="rest = 400 must be a whole number from 0"):
        trial_norm(loop.P, Q, L, 400, rest=400)


def test_a_certificate_prints_and_fails_as_it_should(loop, Q, omega):
    design = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), samples=200)
    assert design.certificate.failures == []
    text = str(design.certificate)
    assert "norm of one trial of 200 samples: 1.27" in text
    assert "over all frequencies" in text and "no filter below" in text and "FAILS" not in text
    bad = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), M_max=0.95).certificate
    wrong = replace(bad, M_max=0.9, all_M=1.01, lower_bound=bad.value / 2)
    assert len(wrong.failures) == 3 and str(wrong).count("FAILS") == 3
