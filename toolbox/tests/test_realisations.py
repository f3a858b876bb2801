"""Realisations of transfer functions, of delays that entries share above all."""

import control
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import companion

from ilctools import minimal_realisation, state_sequence
from ilctools.models import sampled_plant

POLES = st.lists(st.sampled_from([0.0, 0.0, 0.5, 0.9, 0.99, -0.3]), max_size=3)
NUMERATORS = st.sampled_from([[0.0], [0.2], [1.0, -0.9], [0.3, 0.0], [1.0, 0.2, 0.5]])
ENTRY = st.tuples(NUMERATORS, POLES, st.integers(0, 12))
ANGLES = np.exp(1j * np.linspace(0.003, 3.1, 40))


@given(st.integers(1, 3).flatmap(lambda m: st.lists(ENTRY, min_size=m * m, max_size=m * m)))
def test_a_transfer_function_and_its_realisation_have_one_response(entries):
    """Whatever entries share: poles, delays, zeros; P(z) is a quotient of polynomials."""
    m = round(len(entries) ** 0.5)
    num, den = [[] for _ in range(m)], [[] for _ in range(m)]
    for k, (numerator, poles, delay) in enumerate(entries):
        late = max(delay, len(numerator) - 1 - len(poles))
        num[k // m].append(numerator)
        den[k // m].append(np.append(np.poly(poles), np.zeros(late)))
    P = control.tf(num, den, 1.0)
    model = sampled_plant(P)
    found, exact = (system(ANGLES, squeeze=False) for system in (model, P))
    assert np.abs(found - exact).max() <= 1e-8 * np.abs(exact).max()
    longest = [max(len(row[j]) for row in den) for j in range(m)]
    assert model.nstates <= sum(longest) + 3 * m * m


def test_states_that_rounding_cannot_tell_apart_are_not_left_out():
    """Four entries with their delays as states: 90, of which two registers would do."""
    entry = control.tf([1], [1, -0.95] + 20 * [0], 1.0)
    parts = [control.ss(entry * (1 + k)) for k in range(4)]
    sums, both = np.kron(np.eye(2), [[1, 1]]), np.tile(np.eye(2), (2, 1))
    P = sums * control.append(*parts) * both
    try:
        minimal = minimal_realisation(P, P.input_labels)
    except ValueError as error:
        assert "rounding decides" in str(error)
    else:
        assert_allclose(minimal(ANGLES), P(ANGLES), rtol=0, atol=1e-7)


def test_a_numerator_that_is_small_is_no_zero():
    P = control.tf([8e-15, 1.2e-14], [1, -0.5], 1.0)
    assert_allclose(sampled_plant(P)(1.0), P(1.0), rtol=1e-12)


def test_states_of_a_companion_form_obey_their_recursion():
    """Of three modes and a servo at 1 kHz, whose A has entries of up to 70: no power of it is A."""
    poles = np.exp(1e-3 * np.array([-2 + 190j, -5 + 530j, -9 + 1200j, -30 + 30j]))
    A = companion(np.poly([*poles, *poles.conj()]).real)
    forcing = np.random.default_rng(0).standard_normal((2000, 8))
    x = state_sequence(A, forcing, forcing[0])
    residual = x[1:] - x[:-1] @ A.T - forcing[:-1]
    assert np.abs(residual).max() < 1e-12 * np.abs(x).max()
