"""Each bound is a claim, and no claim gets lost on the way to the certificate."""

from dataclasses import replace

import numpy as np
import pytest
from plants import lag, random_response
from problems import optimum, posed

from ilctools import InfeasibleError, least_gain, synthesise, zero_phase_butterworth
from ilctools.evidence.certificate import check
from ilctools.problem.bounds import Bounds
from ilctools.synthesis.everywhere import solve_everywhere

OMEGA = np.geomspace(1e-3, np.pi, 120)
Q = zero_phase_butterworth(2, 0.3, 1.0)
HIGH, GAIN = 0.8, 1.5  # rad/s, and a gain below that without the bound
ASKED = {"order": 8, "L_max": 20.0, "band": (1e-3, 0.2), "L_high": (HIGH, GAIN)}
FINE = np.linspace(HIGH, np.pi, 5000)


def high_gain(design):
    """The largest sigma_max(L) from HIGH on, on a grid of its own."""
    return np.linalg.matrix_norm(design.filter.frequency_response(FINE), ord=2).max()


def test_claims_are_all_bounds_and_the_least_counts():
    bounds = Bounds(0.9, 50.0, (0.3, 12.0), everywhere=True)
    said = ["M_max = 0.9", "L_max = 50", "L_high = (0.3, 12)"]
    assert [str(claim) for claim in bounds.claims] == said
    np.testing.assert_array_equal(bounds.limit_on_L(np.array([0.1, 0.3, 1.0])), [50, 12, 12])
    assert np.isinf(Bounds(0.9, None).limit_on_L(OMEGA)).all()
    lower = bounds.lowered(0.5, M=False)
    assert lower == Bounds(0.9, 25.0, (0.3, 6.0), everywhere=True)


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"everywhere": True},
        {"uncertainty": 0.05},
        {"objective": "peak", "band": None},
        {"L_max": None},
        {"base": "auto", "order": None},
    ],
    ids=str,
)
def test_it_holds_in_each_kind_of_design(more):
    """And without it L passes it, so that it had to be kept; on the grid, to 1e-9."""
    more = ASKED | more
    design = synthesise(lag(), Q, OMEGA, 1.0, **more)
    free = synthesise(lag(), Q, OMEGA, 1.0, **more | {"L_high": None})
    assert high_gain(free) > 1.3 * GAIN
    on_grid = design.sigma_L[design.omega >= HIGH].max()
    assert on_grid <= GAIN * (1 + 1e-9)
    assert design.certificate.failures == []
    if more.get("everywhere"):
        assert high_gain(design) <= GAIN
    claim = design.problem.bounds.claims[-1]
    assert design.certificate.anywhere(claim) == pytest.approx(high_gain(design), rel=1e-5)
    assert f"sigma_max(L) from {HIGH} rad/s on" in str(design)


def test_it_is_the_optimum_of_another_solver():
    P, samples, omega = random_response(5, 2)
    problem = posed(P, samples, omega, 1.0, order=3, L_max=5.0, L_high=(1.0, 0.8), M_max=0.99)
    _, solution = solve_everywhere(problem)
    certificate = check(problem, problem.scaled_filter(solution.coefficients))
    value, *_ = optimum(problem)
    assert certificate.value == pytest.approx(value, rel=1e-6)  # Clarabel's accuracy
    assert certificate.on_grid(problem.bounds.claims[-1]) == pytest.approx(0.8, rel=1e-6)


def test_the_least_gain_keeps_it_without_scaling_it():
    choices = {"order": 8, "M_max": 0.9}
    free = least_gain(lag(), Q, OMEGA, 1.0, **choices)
    gain = 0.5 * free.sigma_L[OMEGA >= HIGH].max()
    design = least_gain(lag(), Q, OMEGA, 1.0, L_high=(HIGH, gain), **choices)
    assert design.sigma_L[OMEGA >= HIGH].max() <= gain * (1 + 1e-9)
    assert design.value > free.value  # at a price
    asked = {"order": 8, "objective": "peak", "L_high": (HIGH, gain)}
    asked |= {"M_max": design.value * (1 + 1e-6), "L_max": None}
    for more in ({"M_max": 0.999 * design.value}, {"L_max": 0.99 * design.sigma_L.max()}):
        with pytest.raises(InfeasibleError, match=r"L_high = \(0.8, "):
            synthesise(lag(), Q, OMEGA, 1.0, **asked | more)


def test_a_bound_that_a_solver_forgets_is_not_certified():
    """A filter found without the bound, judged by the problem with it."""
    asked = posed(lag(), Q, OMEGA, 1.0, **ASKED, base=None)
    forgot = replace(asked, bounds=replace(asked.bounds, L_high=None))
    _, solution = solve_everywhere(forgot)
    for everywhere in (False, True):
        problem = replace(asked, bounds=replace(asked.bounds, everywhere=everywhere))
        found = check(problem, problem.scaled_filter(solution.coefficients)).failures
        assert {one.claim.name for one in found} == {"L_high"}
        assert len(found) == 1 + everywhere and "above L_high = (0.8, 1.5)" in str(found[0])


@pytest.mark.parametrize("L_high", [(0.0, 1.0), (0.3, -1.0), (4.0, 1.0), 3.0])
def test_what_is_no_bound_is_refused(L_high):
    with pytest.raises(ValueError, match=r"^L_high"):
        synthesise(lag(), Q, OMEGA, 1.0, **ASKED | {"L_high": L_high})
