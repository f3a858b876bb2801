"""Realisations of transfer functions, of delays that entries share above all."""

import control
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ilctools import minimal_realisation
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
        np.testing.assert_allclose(minimal(ANGLES), P(ANGLES), rtol=0, atol=1e-7)
