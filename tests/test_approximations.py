from dataclasses import replace

import numpy as np
import pytest
import skfem
from hypothesis import given
from hypothesis import strategies as st
from rods import BRASS, MATERIALS
from scipy.linalg import solve_continuous_lyapunov

from ilctools.models import frequency_response
from rodlib import Rod, exact_response, midr
from rodlib.approximations import balanced_truncation, finite_elements, finite_volumes, modal_series

PAIR = Rod(sections=2, sensors=(0.0, 0.08, 0.16, 0.32))  # at both ends and on an edge
P1, P2, HERMITE = (skfem.ElementLineP1(), skfem.ElementLineP2(), skfem.ElementLineHermite())
OMEGA = np.geomspace(1e-4, 1e-1, 30)
BUILD = {
    "finite volumes": finite_volumes,
    "linear elements": lambda rod, n: finite_elements(rod, P1, n),
    "quadratic elements": lambda rod, n: finite_elements(rod, P2, n),
    "cubic elements": lambda rod, n: finite_elements(rod, skfem.ElementLinePp(3), n),
    "Hermite's elements": lambda rod, n: finite_elements(rod, HERMITE, n),
    "modal series": lambda rod, n: modal_series(rod, 8 * rod.sections * n),
    "midr": midr,
}


def error(model, rod):
    """Of the responses to the heat flows, relative to the largest."""
    exact = exact_response(rod, 1j * OMEGA)
    return (
        np.abs(frequency_response(model, OMEGA) - exact)[:, :, :-1].max()
        / np.abs(exact[:, :, :-1]).max()
    )


@pytest.mark.parametrize("rod", [BRASS, PAIR], ids=["brass", "pair"])
@pytest.mark.parametrize(
    ("method", "order", "slack"),
    [
        ("finite volumes", 2, 0.1),
        ("linear elements", 2, 0.1),
        ("quadratic elements", 4, 0.15),  # 2p at a sensor on an element's end
        ("cubic elements", 6, 0.15),
        ("Hermite's elements", 4, 0.4),
        ("modal series", 3, 0.1),
    ],
)
def test_error_falls_with_the_order_known_from_theory(rod, method, order, slack):
    coarse, fine = (error(BUILD[method](rod, n), rod) for n in (4, 8))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=slack)


@given(MATERIALS, st.tuples(*[st.floats(0, 0.05)] * 3), st.integers(1, 4))
def test_any_rod_is_stable_has_its_names_and_follows_the_air(rod, sensors, count):
    """And volumes never cool what is heated: off the diagonal of A, in B, C nothing is negative."""
    rod = replace(rod, sensors=sensors)
    np.testing.assert_allclose(exact_response(rod, [0.0])[0].real[:, -1], 1, rtol=1e-12)
    for method, build in BUILD.items():
        model = build(rod, count)
        assert model.input_labels == rod.inputs and model.output_labels == rod.outputs, method
        assert model.poles().real.max() < 0, method
        at_rest = frequency_response(model, [0.0])[0]
        np.testing.assert_allclose(at_rest[:, -1], 1, rtol=1e-8, err_msg=method)
        if method == "finite volumes":
            model.A[np.diag_indices(model.nstates)] = 0
            assert min(model.A.min(), model.B.min(), model.C.min()) >= 0


@given(MATERIALS, st.lists(st.floats(0, 0.05), min_size=1, max_size=4), st.integers(1, 6))
def test_one_element_in_each_section_is_midr(rod, sensors, degree):
    """Any number of sensors: cubic elements have four quadrature points."""
    element = {1: P1, 2: P2}.get(degree) or skfem.ElementLinePp(degree)
    rod = replace(rod, sensors=sensors)
    model = frequency_response(finite_elements(rod, element), OMEGA)
    expected = frequency_response(midr(rod, degree), OMEGA)
    np.testing.assert_allclose(model, expected, atol=1e-9 * np.abs(expected).max())


def hankel_singular_values(model):
    """From the eigenvalues of the product of both Gramians."""
    A, B, C = model.A, model.B, model.C
    P = solve_continuous_lyapunov(A, -B @ B.T)
    O = solve_continuous_lyapunov(A.T, -C.T @ C)  # noqa: E741
    return np.sort(np.sqrt(np.abs(np.linalg.eigvals(P @ O))))[::-1]


@pytest.mark.parametrize(("rod", "inputs"), [(Rod(), Rod().inputs), (PAIR, ["theta_a", "Q2"])])
def test_truncation_errs_by_twice_the_hankel_singular_values_left_out_at_most(rod, inputs):
    hankel = hankel_singular_values(midr(rod, 8)[:, inputs])
    omega = np.append(0, np.geomspace(1e-5, 10, 200))
    exact = exact_response(rod, 1j * omega)
    columns = [rod.inputs.index(name) for name in inputs]
    for states in (1, 2, 4, 6):
        model = balanced_truncation(rod, states, inputs)
        assert (model.nstates, model.input_labels) == (states, rod.inputs)
        left = (frequency_response(model, omega) - exact)[:, :, columns]
        errors = np.linalg.norm(left, 2, axis=(1, 2))
        assert hankel[states] * 0.1 < errors.max() <= 2 * hankel[states:].sum() * 1.01
