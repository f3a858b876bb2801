import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from plants import furnace, lifted, random_stable

from ilctools import minimal_realisation, state_sequence
from ilctools.models import dynamics_on_trial, frequency_response, on_trial, sampled_plant


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_hidden_states_of_any_plant_are_removed(n, unreachable, unobservable, seed):
    rng = np.random.default_rng(seed)
    size = n + unreachable + unobservable
    A = np.diag(rng.permutation(np.linspace(-1, -0.1, size)))
    B, C = rng.uniform(0.5, 1, (size, 2)), rng.uniform(0.5, 1, (2, size))
    B[n : n + unreachable] = 0
    C[:, n + unreachable :] = 0
    T = np.linalg.qr(rng.standard_normal((size, size)))[0]
    plant = control.ss(T @ A @ T.T, T @ B, C @ T.T, 0, inputs=["u1", "u2"])
    minimal = minimal_realisation(plant, ["u1", "u2"])
    assert minimal.nstates == n
    assert_allclose(frequency_response(minimal, [0.3]), frequency_response(plant, [0.3]), atol=1e-8)


def test_a_trial_as_sparse_matrices_is_the_recursion_and_its_outputs():
    P, d = random_stable(0), np.random.default_rng(0).standard_normal((9, 2))
    x = state_sequence(P.A, d @ P.B.T, np.zeros(4))
    z = np.append(x, d)
    assert_allclose(dynamics_on_trial(9, P.A, P.B) @ z, 0, atol=1e-13)
    assert_allclose(on_trial(9, P.C, P.D) @ z, lifted(P, 9) @ d.ravel(), rtol=1e-9)


RESTING = control.ss(-1, [[0.0, 1.0]], 1, 0, inputs=["u", "d"])
REFUSED = [  # a call, and how the error begins
    (lambda: minimal_realisation(RESTING, ["Q1", "Q9"]), "controls = "),
    (lambda: minimal_realisation(RESTING, []), "controls = "),
    (lambda: minimal_realisation(RESTING, ["u"]), "controls = .* act on no state"),
    (lambda: frequency_response(control.ss(0, 1, 1, 0), [1, 0]), "omega contains the freq"),
    (lambda: frequency_response(control.ss(0.5, 1, 1, 0, True), [1]), "system.dt = Tr"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


def test_a_long_delay_turns_the_phase_of_what_follows():
    """Where most of a triangular matrix is zero, substitution leaves it out."""
    theta = np.linspace(0.01, np.pi, 50)
    exact = np.exp(-300j * theta) * 0.1 / (np.exp(1j * theta) - 0.95)
    response = frequency_response(sampled_plant(furnace(300, gain=0.5)), theta)[:, 0, 0]
    # rounding of 1e-16 in sums of some 300 terms whose sizes sum to one
    assert np.allclose(response, exact, rtol=0, atol=1e-12)
