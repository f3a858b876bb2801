"""The peak over all frequencies, against exact fractions, closed forms and dense grids."""

from fractions import Fraction

import control
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from plants import random_stable

from ilctools import zero_phase_butterworth
from ilctools.evidence.peak import CLOSE, proven_peak
from ilctools.models import frequency_response
from ilctools.response.phase import phase, phase_grid
from ilctools.singular_values import largest_singular_values


def peak_gain(system, Q=None):
    """Of a system by itself."""

    def sigma(omega):
        gain = 1.0 if Q is None else Q.frequency_response(omega)
        return gain * largest_singular_values(frequency_response(system, omega))

    return proven_peak(sigma, np.append(system.poles(), [] if Q is None else Q.poles), 1.0)


orders = st.integers(1, 5)
seeds = st.integers(0, 999)


@given(orders, st.integers(1, 3), st.sampled_from([1e-6, 1.0, 1e6]), seeds)
def test_peak_gain_is_above_and_close_to_brute_force(n, m, scale, seed):
    """In whatever units the states are."""
    system = random_stable(seed, n, m, 0.1, scale, Ts=1.0)
    units = 10.0 ** np.random.default_rng(seed).uniform(-8, 8, n)
    A, B, C = system.A * units / units[:, None], system.B / units[:, None], system.C
    gain, place = peak_gain(control.ss(A, B, C * units, system.D, 1.0))
    angles = np.append(np.linspace(0, np.pi, 4001), place)
    sigma = largest_singular_values(frequency_response(system, angles))
    assert sigma.max() <= gain * (1 + 1e-12)
    assert gain <= sigma[-1] * (1 + CLOSE)


def modulus_squared(polynomial, t):
    """That of a polynomial, highest power first, at z = (1 + jt)^2 / (1 + t^2), in fractions."""
    real, imag = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
    x, y = Fraction(0), Fraction(0)
    for coefficient in polynomial:
        x, y = x * real - y * imag + Fraction(coefficient), x * imag + y * real
    return x * x + y * y


def exact_gain_squared(system, half_tangents):
    """|G|^2 at z = (1 + jt)^2 / (1 + t^2) for fractions t, by Faddeev and LeVerrier's algorithm."""
    exact = np.vectorize(Fraction, otypes=[object])
    A, B, C, D = map(exact, (system.A, system.B, system.C, system.D))
    identity = exact(np.eye(len(A), dtype=int))
    denominator, numerator, X = [Fraction(1)], [D[0, 0]], identity
    for k in range(1, len(A) + 1):
        denominator.append(-(A @ X).trace() / k)
        numerator.append((C @ X @ B)[0, 0] + D[0, 0] * denominator[-1])
        X = A @ X + denominator[-1] * identity
    return [modulus_squared(numerator, t) / modulus_squared(denominator, t) for t in half_tangents]


@given(
    orders,
    st.sampled_from([1e-1, 1e-4, 1e-8]),
    st.none() | st.tuples(st.integers(1, 8), st.sampled_from([1e-3, 0.1, 3])),
    seeds,
)
def test_the_peak_is_above_the_exact_gain_of_random_systems_with_a_filter_or_without(
    n, distance, lowpass, seed
):
    system = random_stable(seed, n, 1, distance, Ts=1.0)
    rounding, Q = 1e-14 / distance, None
    if lowpass:
        try:
            Q = zero_phase_butterworth(*lowpass, 1.0)
        except ValueError:
            assume(False)
        rounding += 1e-15 / lowpass[1] ** 2  # of |z - p|^2, p a pole of Q
    gain, place = peak_gain(system, Q)
    near = np.append(place, np.abs(np.angle(system.poles())))
    angles = (near[:, None] + distance * np.linspace(-1, 1, 11) * 1e-3).ravel()
    angles = np.append(angles, np.random.default_rng(seed).uniform(0, 3.1, 20))
    tangents = [Fraction(t) for t in np.tan(angles / 2)]
    for t, value in zip(tangents, exact_gain_squared(system, tangents), strict=True):
        for section in Q.sections if Q else ():
            above, below = (modulus_squared(x, t) for x in np.split(section, 2))
            value *= (above / below) ** 2
        assert value <= Fraction(gain * (1 + rounding)) ** 2


@given(orders, st.sampled_from([0.5, 1e-3]), seeds)
def test_the_phase_is_that_of_the_all_pass(n, distance, seed):
    rng = np.random.default_rng(seed)
    size, angle = 1 - distance * rng.uniform(size=n), rng.uniform(-np.pi, np.pi, n)
    poles, theta = size * np.exp(1j * angle), np.sort(rng.uniform(0, np.pi, 9))
    z = np.exp(1j * theta)[:, None]
    all_pass = ((z - poles) / (1 - poles.conj() * z)).prod(axis=1)
    turns = phase(poles, theta)
    turned = np.exp(1j * (turns - turns[0]))
    np.testing.assert_allclose(turned, all_pass / all_pass[0], atol=1e-9)
    assert np.all(np.diff(turns) > 0)


@given(st.lists(orders, min_size=1, max_size=3), st.sampled_from([0.5, 1e-3, 1e-6]), seeds)
def test_a_grid_is_even_in_the_phase_of_each_set_of_poles(sizes, distance, seed):
    """More or less: what it is exactly is measured where it counts."""
    rng = np.random.default_rng(seed)
    systems = [
        (1 - distance * rng.uniform(size=n)) * np.exp(1j * rng.uniform(-3, 3, n)) for n in sizes
    ]
    theta = phase_grid(systems, 0.05)
    steps = np.array([np.diff(phase(poles, theta)) for poles in systems])
    assert theta[0] == 0 and theta[-1] == np.pi and np.all(np.diff(theta) > 0)
    assert steps.max() < 0.08 and len(theta) < 3 + sum(sizes) * 2 * np.pi / 0.05


@pytest.mark.parametrize("gain", [1e-170, 1e170])
def test_gains_whose_squares_leave_the_doubles_are_found(gain):
    for m in (1, 3):
        lag = control.ss(0.5 * np.eye(m), gain * np.eye(m), np.eye(m), 0, 1.0)
        assert peak_gain(lag)[0] == pytest.approx(2 * gain, rel=CLOSE, abs=0)


def test_an_unstable_system_has_no_peak():
    with pytest.raises(ValueError, match="unstable: it has a pole of modulus 1"):
        peak_gain(control.ss(1.0, 1, 1, 0, 1.0))
