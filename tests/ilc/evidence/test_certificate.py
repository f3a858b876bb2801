from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import (
    Law,
    LearningFilter,
    SolverError,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.case import assumed_reference
from rodlib.ilc import convergence, trial_map, trial_norm, trial_operators
from rodlib.ilc.evidence.optimality import lower_bound
from rodlib.ilc.evidence.peak import (
    _ceiling,
    _phase,
    _rounded_up,
    balanced,
    error_model,
    learning_model,
    peak_gain,
)
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.pose import pose
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


def test_peak_gain_of_known_systems():
    lag = control.ss(0.5, 1, 1, 0, 1.0)  # 1 / (z - 0.5): peak 2 at z = 1
    assert peak_gain(lag)[0] == pytest.approx(2, rel=1e-8)
    resonance = control.ss([[1.8, -0.81 * 1.2], [1, 0]], [[1], [0]], [[1, 0]], 0, 1.0)
    gain, place = peak_gain(resonance)
    w = np.linspace(place - 1e-3, place + 1e-3, 200001)
    brute = np.abs(
        np.exp(2j * w) / (np.exp(2j * w) - 1.8 * np.exp(1j * w) + 0.972)
    ).max()
    assert gain == pytest.approx(brute, rel=1e-8)
    assert peak_gain(control.ss([], [], [], [[3.0, 0], [0, 4]], 1.0))[
        0
    ] == pytest.approx(4, rel=1e-14)


@pytest.mark.parametrize("distance", [1e-2, 1e-4, 1e-8, 1e-10])
def test_peak_gain_of_a_pole_next_to_the_circle_is_not_too_low(distance):
    for a in (1 - distance, distance - 1):
        gain, _ = peak_gain(
            control.ss(a, 1, 1, 0, 1.0)
        )  # 1 / (z - a): peak 1 / (1 - |a|)
        ratio = Fraction(gain) * (1 - abs(Fraction(a)))
        assert 1 <= ratio <= 1 + 1.01e-8 + 1e-14 / distance


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


@pytest.mark.parametrize("distance", [1e-3, 1e-6])
def test_the_bound_of_rounding_is_above_what_the_last_digit_of_A_does(distance):
    angle = 0.7
    A = (1 - distance) * np.array(
        [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    )
    B, C, D = np.array([[1.0], [0.5]]), np.array([[1.0, -2.0]]), np.array([[0.3]])
    bound = _rounded_up(A, B, C, D, angle)
    z, eps = np.clongdouble(np.exp(1j * angle)), np.longdouble(np.finfo(float).eps)
    gains = []
    for signs in np.ndindex(2, 2, 2, 2):
        (a, b), (c, d) = A * (1 + eps * (2 * np.reshape(signs, (2, 2)) - 1))
        adjugate = np.array([[z - d, b], [c, z - a]])
        gains.append(
            abs((C @ adjugate @ B)[0, 0] / ((z - a) * (z - d) - b * c) + D[0, 0])
        )
    assert max(gains) <= bound <= max(gains) * (1 + 1e-13 / distance)


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"P": control.ss(0.2, 0.8, 1, 0, True)},
            "P.dt = True must be a sampling period",
        ),
        ({"P": control.tf([1], [1, -0.5], 1.0)}, "P = .* must be a StateSpace"),
        ({"P": control.ss([], [], [], np.eye(2), 1.0)}, "P is 2 by 2, but L is 1 by 1"),
        ({"Q": np.ones(50)}, "Q = .* must be a ZeroPhaseButterworth"),
        ({"L": np.ones((1, 1, 3))}, "L = .* must be a LearningFilter"),
    ],
)
def test_what_is_no_model_or_no_filter_is_refused(changes, message):
    L = LearningFilter(np.ones((1, 1, 3)), 1.0)
    given = {
        "P": control.ss(0.5, 1, 1, 0, 1.0),
        "Q": zero_phase_butterworth(),
        "L": L,
    } | changes
    with pytest.raises(ValueError, match=message):
        trial_norm(**given, samples=9)


def test_whole_numbers_are_numbers():
    """A lag of whole numbers, 1 / z, is that of floats, as a model and as samples."""
    whole, omega = control.ss([[0]], [[1]], [[1]], [[0]], 1), np.linspace(0.1, 3, 9)
    assert peak_gain(whole)[0] == pytest.approx(1, rel=1e-8)
    Q, numbers = zero_phase_butterworth(), {"order": 2, "band": (0.1, 1)}
    for P in (whole, np.ones((9, 1, 1), dtype=int)):
        floats = (
            P.astype(float)
            if isinstance(P, np.ndarray)
            else control.ss(0.0, 1.0, 1, 0, 1.0)
        )
        one, other = (synthesise(p, Q, omega, 1.0, **numbers) for p in (P, floats))
        np.testing.assert_array_equal(
            one.filter.coefficients, other.filter.coefficients
        )


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


@pytest.mark.parametrize("cutoff", [0.003, 0.02, 0.5])
@pytest.mark.parametrize("order", [1, 2, 6, 9])
def test_the_peak_with_a_filter_of_high_order_and_low_cutoff(loop, order, cutoff):
    """Its poles are all but one, twice over; the analytic Q does not care."""
    L = LearningFilter(published.matrix("L_full"), 1.0)
    try:
        Q = zero_phase_butterworth(order, cutoff)
    except ValueError:  # what rounding leaves of it is another filter
        assert order == 9 and cutoff == 0.003
        return
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


@pytest.mark.parametrize("tolerance", [0.1, 1.0])
@pytest.mark.parametrize(
    ("order", "cutoff"), [(1, 0.01), (2, 1e-3), (2, 1.0), (5, 0.02), (8, 0.3)]
)
def test_however_coarse_the_bound_with_a_filter_is_not_too_low(
    order, cutoff, tolerance
):
    """The poles of Q narrow the peak that a differentiator has with it."""
    Q = zero_phase_butterworth(order, cutoff)
    gain, _ = peak_gain(control.ss(0, 1, -1, 1, 1.0), Q, tolerance)  # 1 - 1 / z
    dense = cutoff * np.linspace(0.1, 1, 10001)
    peak = (2 * np.sin(dense / 2) * Q.frequency_response(dense)).max()
    assert peak <= gain <= (1 + tolerance) * peak


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
    for _ in range(20):
        U, V = rng.standard_normal((2, 40, 2, 2)) + 1j * rng.standard_normal(
            (2, 40, 2, 2)
        )
        V = None if L_max is None else V
        bound = lower_bound(design.problem, U, V)
        assert bound <= design.value * (1 + 1e-9)


@given(
    st.sampled_from([1, 10, 40]),
    st.sampled_from(["diagonal", "full"]),
    st.integers(0, 999),
)
def test_lower_bound_ignores_what_a_filter_could_do_to_the_multipliers(
    order, structure, seed
):
    """T L for any L is projected out of U. These L have a given gain, and huge coefficients."""
    rng = np.random.default_rng(seed)
    angles = np.geomspace(1e-4, np.pi, 250)
    z = np.exp(1j * angles)
    P = np.eye(2) * (0.1 / (z - 0.9))[:, None, None] + 0.2 * rng.standard_normal((2, 2))
    Q = 1 / (1 + (angles / 0.1) ** 4)
    problem = pose(P, Q, angles, 1.0, order=order, L_max=None, structure=structure)
    U = rng.standard_normal((250, 2, 2)) + 1j * rng.standard_normal((250, 2, 2))
    bound = lower_bound(problem, U, None)

    L = np.zeros((250, 2, 2), dtype=complex)
    for i, j in np.ndindex(2, 2):
        if structure == "full" or i == j:
            L[:, i, j] = z
            for _ in range(
                (order - 1) // 2
            ):  # a pair of zeros on the circle: real coefficients
                zero = np.exp(1j * 10 ** rng.uniform(-3, 0))
                L[:, i, j] *= (z - zero) * (z - zero.conj())
    change = -Q[:, None, None] * (P @ L)
    change *= np.linalg.norm(U) / np.linalg.norm(change)
    moved = lower_bound(problem, U + change, None)
    assert moved == pytest.approx(bound, rel=1e-11, abs=1e-11 * np.linalg.norm(U))


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
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
        matrix, adjoint = (
            operator @ np.eye(2 * samples),
            operator.H @ np.eye(2 * samples),
        )
        np.testing.assert_allclose(adjoint, matrix.T, atol=1e-11)


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
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


@pytest.mark.parametrize("samples", [1, 2, 3])
@pytest.mark.parametrize("m", [1, 2])
def test_the_shortest_trials_have_a_norm(m, samples):
    P = control.ss(0.5 * np.eye(m), np.eye(m), np.eye(m), np.eye(m), 1.0)
    L = LearningFilter(np.full((m, m, 2), 0.2), 1.0)
    Q = zero_phase_butterworth(cutoff=1.0)
    matrix = trial_map(P, Q, L, samples) @ np.eye(samples * m)
    norm, before, after = trial_norm(P, Q, L, samples)
    assert norm == pytest.approx(np.linalg.norm(matrix, 2)) and norm > 0
    assert before.shape == after.shape == (samples, m)
    np.testing.assert_allclose(matrix @ before.ravel(), after.ravel(), atol=1e-14)


def test_trials_move_by_the_trial_map(loop, Q):
    """v_{k+1} - v_k obeys T as simulated by run_trials."""
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    run = run_trials(loop, Law(Q, L), assumed_reference(300), None, 4)
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 0}, "samples = 0 must be a whole number, 1 or more"),
        ({"samples": 2.5}, "samples = 2.5 must be a whole number"),
        ({"trials": 0}, "trials = 0 must be a whole number, 1 or more"),
        ({"trials": 1.0}, "trials = 1.0 must be a whole number"),
        ({"rest": 40}, "rest = 40 must be a whole number, from 0 to 39"),
        ({"rest": -1}, "rest = -1 must be a whole number, from 0 to 39"),
    ],
)
def test_trials_that_cannot_be_are_refused(loop, Q, arguments, message):
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    with pytest.raises(ValueError, match=message):
        trial_norm(loop.P, Q, L, **{"samples": 40} | arguments)


def test_a_certificate_prints_and_fails_as_it_should(loop, Q, omega):
    design = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), samples=200)
    assert design.certificate.failures == []
    text = str(design.certificate)
    assert "norm of one trial of 200 samples: 1.27" in text
    assert (
        "over all frequencies" in text
        and "no diagonal filter of order 10 below" in text
        and "FAILS" not in text
    )
    bad = synthesise(
        loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), M_max=0.95
    ).certificate
    tighter, peak = (
        replace(bad.problem, M_max=0.9),
        replace(bad.peak, sigma=1.01, omega=0.25),
    )
    wrong = replace(
        bad, problem=tighter, peak=peak, exact=peak, lower_bound=bad.value / 2
    )
    assert len(wrong.failures) == 3 and str(wrong).count("FAILS") == 3
    assert "sigma_max(M) reaches 1.01 at 0.25 rad/s, not in omega" in str(wrong)
    peak = replace(peak, sigma=1.2, omega=0.3)
    estimated = replace(design.certificate, peak=peak, estimated=1)
    assert "WARNING: sigma_max(M) may reach 1.2 at 0.3 rad/s" in str(estimated)
    assert design.certificate.warnings == estimated.failures == []
    at_rest = str(replace(design.certificate, rest=15))
    assert "norm of one trial of 200 samples, the last 15 at rest: 1.27" in at_rest


def test_a_certificate_says_what_limits_leave_of_the_claim(loop, Q, omega):
    """In the plant's own units, in which commands are projected, whatever the scale."""
    grid = omega[::10]
    for scale in (None, [1.0, 2.0]):
        design = synthesise(
            loop, Q, grid, 1.0, band=(1e-4, 0.01), scale=scale, M_max=0.97
        )
        own = convergence(loop, Q, design.filter, grid).within()
        assert design.certificate.within == pytest.approx(own, rel=1e-9)
        assert f"limits: a rate of {own:.4f}, without ends" in str(design)
    assert "have limits: no rate" in str(replace(design.certificate, within=1.0))


def test_a_certificate_fails_from_the_tolerance_on(loop, Q, omega):
    """A gap of 1e-6, a bound on the grid passed by 1e-9, relative; from 0.25 of the margin on."""
    good = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01)).certificate

    def failing(sigma_M=None, all_M=0.9, **changes):
        worst = (
            replace(good.worst, sigma=np.array([sigma_M])) if sigma_M else good.worst
        )
        peak = replace(good.peak, sigma=all_M)
        return len(
            replace(good, worst=worst, peak=peak, exact=peak, **changes).failures
        )

    def estimated(all_M, missed):
        return replace(
            good, peak=replace(good.peak, sigma=all_M, missed=missed), estimated=1
        )

    value, idle = good.value, good.problem.idle
    assert value > 1e-3 * idle
    assert not failing(lower_bound=value * (1 - 0.99e-6))
    assert failing(lower_bound=value * (1 - 1.01e-6)) == 1
    assert not failing(0.9 * (1 + 0.99e-9), grid_L=50 * (1 + 0.99e-9))
    assert failing(0.9 * (1 + 1.01e-9)) == failing(grid_L=50 * (1 + 1.01e-9)) == 1
    assert not failing(passed_L=1 + 0.99e-9) and failing(passed_L=1 + 1.01e-9) == 1
    assert failing(grid_L=50.1, passed_L=1.002) == 1
    assert not failing(all_M=np.nextafter(1, 0)) and failing(all_M=1.0) == 1
    for missed, warned in ((0.049, 0), (0.051, 1)):
        assert len(estimated(0.8, missed).warnings) == warned
    assert len(estimated(1.0, 0.0).warnings) == 1
    perfect = replace(good, value=1e-9 * idle, lower_bound=0.0)
    assert perfect.gap == pytest.approx(
        1e-6
    )  # relative to a thousandth of the objective, idle


def with_resonance(angle, distance, height):
    """A lag, and a resonance of `height` times the gain of the lag, at an angle."""
    lag = control.tf([0.1], [1, -0.9], 1.0)
    radius = 1 - distance
    height *= abs(lag(np.exp(1j * angle))) * distance * 2 * np.sin(angle)
    return lag + control.tf([height], [1, -2 * radius * np.cos(angle), radius**2], 1.0)


def peak_around(plant, design, Q, angle):
    """Largest sigma_max(M) on a grid so fine around an angle that nothing hides there."""
    omega = angle * (1 + np.linspace(-0.3, 0.3, 60001))
    L = design.filter.frequency_response(omega)
    P = plant(np.exp(1j * omega))[:, None, None]
    return largest_singular_values(
        convergence_matrix(P, Q.frequency_response(omega), L)
    ).max()


@pytest.mark.parametrize(
    ("distance", "shown"),
    [(1e-5, False), (1e-3, True)],
    ids=["hidden", "on its flanks"],
)
def test_a_resonance_between_measured_samples(Q, distance, shown):
    omega = np.geomspace(1e-3, np.pi, 60)
    angle = np.sqrt(omega[33] * omega[34])
    plant = with_resonance(angle, distance, 4.0)
    P = plant(np.exp(1j * omega))[:, None, None]
    with pytest.warns(match="too coarse") if shown else nullcontext():
        design = synthesise(P, Q, omega, 1.0, order=3, band=(1e-3, 0.02))
    certificate, text = design.certificate, str(design.certificate)
    assert certificate.all_M < 1 < peak_around(plant, design, Q, angle)
    assert (
        bool(certificate.warnings)
        == shown
        == ("WARNING: the samples are too coarse" in text)
    )
    assert "not known" in text and "at resonances that no sample shows" in text


def test_what_lies_below_the_first_measured_frequency(Q):
    omega = np.geomspace(1e-2, np.pi, 100)
    slow = control.tf([-2e-4], [1, -(1 - 1e-4)], 1.0)
    plant = (
        control.tf([0.1], [1, -0.9], 1.0) + slow
    )  # its gain is 1, but -1 below 1e-4 rad/s
    P = plant(np.exp(1j * omega))[:, None, None]
    design = synthesise(P, Q, omega, 1.0, band=(1e-2, 0.02))
    certificate, text = design.certificate, str(design.certificate)
    assert certificate.all_M < 1 < peak_around(plant, design, Q, 1e-5)
    assert "sigma_max(M) from 0.01 to 3.142 rad/s, between the samples:" in text
    assert "sigma_max(M) unknown: below 0.01 rad/s, at resonances" in text
    assert certificate.warnings == [] and certificate.failures == []
    with pytest.raises(
        SolverError, match=r"sigma_max\(M\) reaches 2.00\d* at 0 rad/s, not in omega"
    ):
        synthesise(control.ss(plant), Q, omega, 1.0, band=(1e-2, 0.02))


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize(
    "grid", [np.geomspace(1e-3, np.pi, 60), np.linspace(0.01, np.pi, 300)]
)
def test_the_estimate_between_samples_misses_less_than_it_says(loop, Q, grid):
    P = loop.frequency_response(grid)
    design = synthesise(P, Q, grid, 1.0, band=(grid[0], 0.03), M_max=0.99)
    dense = np.geomspace(grid[0], np.pi, 20001)
    L = design.filter.frequency_response(dense)
    M = convergence_matrix(
        loop.frequency_response(dense), Q.frequency_response(dense), L
    )
    peak = largest_singular_values(M).max()
    assert abs(design.certificate.all_M - peak) < design.certificate.peak.missed
