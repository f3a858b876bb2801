"""The peak over all frequencies, against exact fractions, closed forms and dense grids."""

from fractions import Fraction

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import LearningFilter, zero_phase_butterworth
from rodlib.ilc.evidence.peak import (
    _ceiling,
    _phase,
    balanced,
    error_model,
    learning_model,
    peak_gain,
)
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.paper import published


def random_system(rng, n, m, scale=1.0):
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.3, 0.99) / np.abs(np.linalg.eigvals(A)).max()
    return control.ss(
        A,
        rng.standard_normal((n, m)) * scale,
        rng.standard_normal((m, n)),
        np.eye(m) * scale,
        1.0,
    )


@given(
    st.integers(1, 8),
    st.integers(1, 3),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.integers(0, 999),
)
def test_peak_gain_is_above_and_close_to_brute_force(n, m, scale, seed):
    system = random_system(np.random.default_rng(seed), n, m, scale)
    gain, place = peak_gain(system)
    angles = np.linspace(0, np.pi, 4001)
    brute = largest_singular_values(frequency_response(system, angles)).max()
    there = largest_singular_values(frequency_response(system, [place]))[0]
    assert brute <= gain * (1 + 1e-12)
    assert gain <= there * (1 + 1.01e-8)


@given(
    st.sampled_from([1, 2, 3]),
    st.sampled_from([1e-2, 1e-4, 1e-8, 1e-10]),
    st.floats(0.02, 3.12),
)
def test_peak_gain_of_resonances_in_series_is_not_too_low(copies, distance, angle):
    """1 / |z^2 + b z + c|^2 peaks at 1 / ((1 - c)^2 (1 - b^2 / 4c)): exact in fractions."""
    b, c = -2 * (1 - distance) * np.cos(angle), (1 - distance) ** 2
    one = control.ss([[-b, -c], [1, 0]], [[1], [0]], [[0, 1]], 0, 1.0)
    system = one
    for _ in range(copies - 1):
        system = one * system
    try:
        gain, _ = peak_gain(system)
    except (
        ValueError,
        RuntimeError,
    ) as error:  # rounding splits a multiple pole further apart
        assert (
            copies > 1 and distance**copies < 1e-11 and "pole of modulus" in str(error)
        )
        return
    b, c = Fraction(b), Fraction(c)
    inverse = ((1 - c) ** 2 * (1 - b**2 / (4 * c))) ** copies
    ratio = Fraction(gain) ** 2 * inverse
    assert ratio >= 1
    if copies == 1:
        assert ratio <= 1 + 2.1e-8 + 1e-13 / (distance * np.sin(angle) ** 2)


def modulus_squared(polynomial, t):
    """That of a polynomial, highest power first, at z = (1 + jt)^2 / (1 + t^2), in fractions."""
    real, imag = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
    x, y = Fraction(0), Fraction(0)
    for coefficient in polynomial:
        x, y = x * real - y * imag + Fraction(coefficient), x * imag + y * real
    return x * x + y * y


def exact_gain_squared(system, half_tangents):
    """|G|^2 at z = (1 + jt)^2 / (1 + t^2) for fractions t, by Faddeev and LeVerrier's algorithm."""
    A, B, C, D = (
        np.vectorize(Fraction, otypes=[object])(X)
        for X in (system.A, system.B, system.C, system.D)
    )
    n = len(A)
    identity = np.vectorize(Fraction, otypes=[object])(np.eye(n, dtype=int))
    denominator, numerator, X = [Fraction(1)], [D[0, 0]], identity
    for k in range(1, n + 1):
        denominator.append(-(A @ X).trace() / k)
        numerator.append((C @ X @ B)[0, 0] + D[0, 0] * denominator[-1])
        X = A @ X + denominator[-1] * identity

    return [
        modulus_squared(numerator, t) / modulus_squared(denominator, t)
        for t in half_tangents
    ]


@given(st.integers(1, 5), st.sampled_from([1e-1, 1e-4, 1e-8]), st.integers(0, 999))
def test_peak_gain_is_above_the_exact_gain_of_random_systems(n, distance, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= (1 - distance) / np.abs(np.linalg.eigvals(A)).max()
    system = control.ss(
        A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)), 1, 1.0
    )
    gain, place = peak_gain(system)
    poles = np.linalg.eigvals(A)
    near = np.append(place, np.abs(np.angle(poles)))
    angles = (near[:, None] + distance * np.linspace(-1, 1, 11) * 1e-3).ravel()
    tangents = [Fraction(t) for t in np.tan(angles / 2) if np.isfinite(t)]
    assert max(exact_gain_squared(system, tangents)) <= Fraction(gain) ** 2


@given(st.integers(1, 5), st.sampled_from([0.5, 1e-3]), st.integers(0, 999))
def test_the_phase_is_that_of_the_all_pass(n, distance, seed):
    rng = np.random.default_rng(seed)
    poles = (1 - distance * rng.uniform(size=n)) * np.exp(
        1j * rng.uniform(-np.pi, np.pi, n)
    )
    theta = np.sort(rng.uniform(0, np.pi, 9))
    z = np.exp(1j * theta)[:, None]
    all_pass = ((z - poles) / (1 - poles.conj() * z)).prod(axis=1)
    phase = _phase(poles, theta)
    np.testing.assert_allclose(
        np.exp(1j * (phase - phase[0])), all_pass / all_pass[0], atol=1e-9
    )
    assert np.all(np.diff(phase) > 0)


@given(
    st.floats(-0.4, 1.9), st.floats(0.01, 1.57), st.sampled_from([1e-200, 1.0, 1e200])
)
def test_the_ceiling_is_the_crest_of_the_sinusoid_through_two_values(place, h, crest):
    a, b = crest * np.cos(place), crest * np.cos(h - place)
    if min(a, b) > 0:
        expected = crest if 0 <= place <= h else max(a, b)
        assert _ceiling(a, b, h) == pytest.approx(expected, rel=1e-9, abs=0)
        assert _ceiling(a, b, np.pi / 2) == np.inf


@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 999))
def test_balancing_changes_units_of_states_only_and_leaves_none_out_of_scale(
    n, m, seed
):
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-8, 8, (3, n, n))
    A, B, C = (
        sizes[0],
        sizes[1][:, :1] * 10.0 ** rng.uniform(-8, 0, (n, m)),
        sizes[2][:m],
    )
    scaled, inputs, outputs = balanced(A, B, C)
    for k in range(
        3
    ):  # scaled by powers of two, the same sums are the same to the last bit
        moved = outputs @ np.linalg.matrix_power(scaled, k) @ inputs
        np.testing.assert_array_equal(moved, C @ np.linalg.matrix_power(A, k) @ B)
    for i in range(n):
        rest = np.arange(n) != i
        row = np.linalg.norm([*scaled[i, rest], np.abs(inputs[i]).max()])
        column = np.linalg.norm([*scaled[rest, i], np.abs(outputs[:, i]).max()])
        assert (
            3 / 7 <= row / column <= 7 / 3
        )  # another power gains less than LAPACK's 5 %


@pytest.mark.parametrize("gain", [1e-300, 1e-170, 1e-150, 1.0, 1e150, 1e170, 1e300])
def test_gains_whose_squares_leave_the_doubles_are_found(gain):
    for m in (1, 2, 3):
        lag = control.ss(
            0.5 * np.eye(m), gain * np.eye(m), np.eye(m), np.zeros((m, m)), 1.0
        )
        assert peak_gain(lag)[0] == pytest.approx(2 * gain, rel=2e-8, abs=0)


def test_an_unstable_system_has_no_peak():
    with pytest.raises(ValueError, match="unstable: it has a pole of modulus 1"):
        peak_gain(control.ss(1.0, 1, 1, 0, 1.0))


@pytest.mark.parametrize("name", ["L_diagonal", "L_full"])
def test_models_have_the_singular_values_of_M_and_L(loop, name):
    L = LearningFilter(published.matrix(name), 1.0)
    omega = np.geomspace(1e-4, np.pi, 300)
    M = convergence_matrix(
        loop.frequency_response(omega), 1.0 + 0 * omega, L.frequency_response(omega)
    )
    model = error_model(loop.P, L)
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


@given(
    st.integers(1, 8), st.sampled_from([1e-5, 1e-4, 1e-3, 0.1, 3]), st.floats(-0.99, 0.99),
    st.integers(0, 999),
)  # fmt: skip
def test_the_peak_with_a_filter_is_above_exact_values(order, cutoff, pole, seed):
    try:
        Q = zero_phase_butterworth(order, cutoff)
    except ValueError:
        return
    system = control.ss(pole, 1, 1, 0.3, 1.0)
    gain, place = peak_gain(system, Q, 1e-11)
    rng = np.random.default_rng(seed)
    tangents = [
        Fraction(t) for t in np.tan(np.append(place, rng.uniform(0, 3.1, 20)) / 2)
    ]
    exact = exact_gain_squared(system, tangents)
    for section in Q.sections:
        H = [
            modulus_squared(section[:3], t) / modulus_squared(section[3:], t)
            for t in tangents
        ]
        exact = [value * each**2 for value, each in zip(exact, H, strict=True)]
    assert max(exact) <= Fraction(gain) ** 2


def test_peaks_of_the_printed_filter_over_all_frequencies(loop, Q):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    dense = np.linspace(1e-5, np.pi, 200001)
    brute_L = largest_singular_values(L.frequency_response(dense)).max()
    gain, _ = peak_gain(learning_model(L))
    assert brute_L <= gain * (1 + 1e-13) and gain == pytest.approx(brute_L, rel=1e-7)
    assert gain > 50.03  # the paper's grid does not see this


@pytest.mark.parametrize("cutoff", [0.02, 0.5])
@pytest.mark.parametrize("order", [2, 6])
def test_the_peak_with_a_filter_of_high_order_and_low_cutoff(loop, order, cutoff):
    """Its poles are all but one, twice over; the analytic Q does not care."""
    L = LearningFilter(published.matrix("L_full"), 1.0)
    Q = zero_phase_butterworth(order, cutoff)
    gain, place = peak_gain(error_model(loop.P, L), Q)
    dense = np.append(np.geomspace(1e-5, 3, 20001), place)
    analytic = 1 / (1 + (np.tan(dense / 2) / np.tan(cutoff / 2)) ** (2 * order))
    peaks = [
        largest_singular_values(
            convergence_matrix(
                loop.frequency_response(dense), q, L.frequency_response(dense)
            )
        ).max()
        for q in (Q.frequency_response(dense), analytic)
    ]
    assert 1 - 1e-11 <= gain / peaks[0] <= 1 + 1.1e-8 + 1e-12 / cutoff**2  # rounding
    assert gain == pytest.approx(
        peaks[1], rel=2e-6
    )  # the coefficients of Q are rounded
