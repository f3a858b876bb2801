"""The solver, by way of synthesise, where it gets hard; against CVXPY: test_formulate."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_choices
from plants import LOOPS, lag, random_response
from problems import memory, posed, statement
from scipy.optimize import brentq

from ilctools import InfeasibleError, LearningFilter, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response
from ilctools.synthesis.design import certified
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.interior_point import minimise


@pytest.mark.filterwarnings(
    "ignore:almost nothing is learned", "ignore:.*between the frequencies omega"
)
@settings(max_examples=6)
@given(
    st.integers(1, 3),
    st.sampled_from([1, 2, 5, 10]),
    st.sampled_from(["diagonal", "full"]),
    st.sampled_from(["sum", "peak"]),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.integers(0, 999),
)
def test_every_filter_is_certified_or_refused_with_a_reason(
    m, order, structure, objective, gain, seed
):
    """Any size, order and scaling: a gap of 1e-8, and no bound passed by more than 1e-9."""
    P, Q, omega = random_response(seed, m, 16, gain)
    L_max = 10.0 / gain
    arguments = {"order": order, "structure": structure, "objective": objective, "M_max": 0.9}
    arguments["band"] = 0.01, 0.3
    try:
        design = synthesise(P, Q, omega, 1.0, L_max=L_max, **arguments)
    except InfeasibleError:
        arguments |= {"objective": "peak", "M_max": 0.999999}
        assert synthesise(P, Q, omega, 1.0, L_max=L_max, **arguments).value > 0.9
        return
    certificate = design.certificate
    assert certificate.gap < 1e-8
    assert certificate.grid_M <= 0.9 * (1 + 1e-9)
    assert certificate.sigma_L.max() <= L_max * (1 + 1e-9)
    scaled = synthesise(P / gain, Q, omega, 1.0, L_max=10.0, **arguments)
    assert scaled.value == pytest.approx(design.value, rel=1e-7, abs=1e-9)


def test_nearly_infeasible_problems_are_solved(loop, Q, omega):
    grid = omega[::4]
    arguments, margin = paper_choices(band=(grid[0], 0.01)), 1.00001
    peak = synthesise(loop, Q, grid, 1.0, **arguments, objective="peak").value
    arguments["M_max"] = peak * margin
    design = synthesise(loop, Q, grid, 1.0, **arguments)
    assert design.certificate.gap < 1e-7
    assert design.certificate.grid_M <= peak * margin * (1 + 1e-9)
    with pytest.raises(InfeasibleError) as error:
        synthesise(loop, Q, grid, 1.0, **arguments | {"M_max": peak / margin})
    named = re.search(r"smallest feasible M_max is (0\.\d+)", str(error.value))[1]
    assert 0 <= float(named) - peak < 1e-6  # in six digits, rounded up


@pytest.mark.filterwarnings("ignore:.*weakest direction")  # one channel in another unit
@pytest.mark.parametrize(("objective", "unit"), [("sum", 1e-3), ("peak", 1.0)])
def test_without_a_bound_filters_compete_up_to_a_gain_that_doubles_can_hold(
    loop, Q, omega, objective, unit
):
    """The limit counts in units of each input: a plant in other units has the same optimum."""
    P, U = loop.frequency_response(omega), np.diag([1.0, unit])
    choices = paper_choices(L_max=None, objective=objective)
    design = synthesise(P @ U, Q, omega, 1.0, **choices)
    response = Q.frequency_response(omega)[:, None, None] * P @ U
    sizes = np.linalg.norm(response, axis=1).max(axis=0)[:, None, None]
    assert np.abs(sizes * design.filter.coefficients).max() < 1e7
    assert design.certificate.failures == []
    if objective == "peak":
        assert design.value == pytest.approx(0.461827, abs=1e-6)  # Clarabel: 0.4618272


def of_lag(T, cutoff, n):
    """The lag 1 / (T s + 1) behind a zero-order hold, and Q, at logarithmic frequencies."""
    omega, Q = np.geomspace(1e-4, np.pi, n), zero_phase_butterworth(2, cutoff, 1.0)
    P = frequency_response(lag(np.exp(-1 / T)), omega)
    return P, Q.frequency_response(omega), omega


def test_the_gap_may_widen_before_it_closes():
    """While the objective falls by orders of magnitude, the dual does not follow at once."""
    arguments = *of_lag(30, 0.3, 500), 1.0
    choices = {"order": 20, "L_max": 50.0, "band": (1e-4, 0.1)}
    design = certified(posed(*arguments, **choices))
    _, value = statement(*arguments, **choices)
    assert design.value == pytest.approx(value, rel=1e-4)


def test_memory_grows_neither_as_the_square_of_the_order_nor_of_the_frequencies():
    """Of synthesis and certificate: complex, 1,500 x 1,500 have 36 MB, 60 x 60 x 1,500 have 86."""
    arguments = *of_lag(30, 0.1, 1500), 1.0
    assert memory(lambda: synthesise(*arguments, order=60)) < 5e7


@pytest.mark.parametrize(("T", "order", "gain"), [(3.0, 40, 1e-6), (300.0, 10, 1e6)])
def test_a_perfect_filter_is_certified(T, order, gain):
    """Where the optimum is next to zero, the gap counts by the objective without learning."""
    P, Q, omega = of_lag(T, 0.05, 100)
    choices = {"order": order, "L_max": 5 * T / gain, "band": (1e-4, 0.01)}
    design = synthesise(P * gain, Q, omega, 1.0, **choices)
    idle = design.problem.idle
    assert design.value < 1e-3 * idle
    assert design.value - design.certificate.lower_bound <= 1e-9 * idle


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
def test_a_failure_is_not_called_infeasible():
    """Of a Newton system that cannot be factored: the squares of these numbers are no doubles."""
    P, Q, omega = random_response(1, 2)
    program = formulate(posed(P, Q, omega, 1.0, order=3, L_max=5.0, band=(0.01, 0.3))).program
    huge = tuple(replace(bound, T=1e200 * bound.T) for bound in program.bounds)
    with pytest.raises(RuntimeError, match=r"neither meet .* nor rule them out: rounding") as error:
        minimise(replace(program, bounds=huge))
    assert error.type is RuntimeError  # and not Infeasible


def test_an_optimum_that_rounding_puts_on_its_bound_is_found():
    """Of one coefficient, the largest with sigma_max(M) <= 0.9, which is a root."""
    loop = LOOPS["stage"]()
    low_pass = zero_phase_butterworth(2, 100.0, loop.Ts)
    design = synthesise(loop, low_pass, order=1, L_max=8.0)
    ahead = LearningFilter(np.ones((1, 1, 1)), loop.Ts, first=design.filter.first)
    dense = np.geomspace(1.0, np.pi / loop.Ts, 20_000)
    response = loop.frequency_response(dense) * ahead.frequency_response(dense)
    Q = low_pass.frequency_response(dense)[:, None, None]

    def above(gain):
        return np.abs(Q * (1 - gain * response)).max() - 0.9

    # between two frequencies of its grid, a design may pass M_max by 1e-5 (problem/grid.py)
    largest = brentq(above, 0.9, 1.1)
    np.testing.assert_allclose(design.filter.coefficients, largest, rtol=2e-5)
