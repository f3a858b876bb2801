"""Filters for several plants, and for all within a radius: against CVXPY, and among each other."""

import numpy as np
import pytest
from plants import half, random_response

from rodlib import InfeasibleError, LearningFilter, synthesise
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.synthesis.cuts import violated
from rodlib.ilc.synthesis.design import certified, solve
from rodlib.ilc.synthesis.formulate import formulate
from rodlib.ilc.synthesis.solver import interior_point

KINDS = ("radius", "plants", "plants and radius")
CHOICES = {"order": 3, "L_max": 8.0, "band": (0.01, 0.3)}


def question(m, kind, seed, n=15):
    """Plants, Q, frequencies and choices for which the bounds on more than one plant matter."""
    P, Q, omega = random_response(seed, m, n)
    rng = np.random.default_rng(seed)
    choices = dict(CHOICES)
    size = np.linalg.norm(P, 2, axis=(1, 2))
    if kind == "radius":
        choices["uncertainty"] = 0.3 * size
    if kind.startswith("plants"):
        P = [P, *(P * (1 + 0.4 * rng.uniform(-1, 1, (m, m))) for _ in range(4))]
    if kind == "plants and radius":
        choices["uncertainty"] = 0.1 * size
    return P, Q, omega, choices


@pytest.mark.parametrize(
    ("shape", "objective", "kind"),
    half([(1, "full"), (2, "full"), (2, "diagonal")], ["sum", "peak"], KINDS),
)
def test_structured_and_cvxpy_find_the_same_optimum(shape, objective, kind):
    m, structure = shape
    P, Q, omega, choices = question(m, kind, m)
    choices |= {"structure": structure, "objective": objective}
    if objective == "sum":  # a little more than what is possible, so that it is active
        try:
            synthesise(P, Q, omega, 1.0, **choices, M_max=0.01)
        except InfeasibleError as error:
            choices["M_max"] = 1.01 * error.smallest_M_max
    ours = synthesise(P, Q, omega, 1.0, **choices)
    theirs = certified(pose(P, Q, omega, 1.0, **choices), solver="cvxpy")
    assert ours.value == pytest.approx(theirs.value, rel=1e-5)
    assert ours.certificate.gap < 1e-6 and theirs.certificate.gap < 1e-5
    nominal = synthesise(P[0] if kind.startswith("plants") else P, Q, omega, 1.0,
                         **choices | {"uncertainty": None})  # fmt: skip
    assert ours.value >= nominal.value * (1 - 1e-8)
    if objective == "peak":
        assert ours.value > nominal.value * (1 + 1e-6)  # it costs something


@pytest.mark.parametrize("objective", ["sum", "peak"])
def test_a_selection_of_the_bounds_is_as_good_as_all_of_them(objective):
    P, Q, omega, choices = question(2, "plants", 5)
    problem = pose(P, Q, omega, 1.0, **choices, objective=objective, M_max=0.9)
    plant, frequency = np.indices((4, len(omega))).reshape(2, -1)
    whole = formulate(problem, plant + 1, frequency)
    reference = interior_point.solve(whole)
    found = solve(problem)
    for solution in (reference, found):
        none = np.array([], dtype=int)
        limit = solution.largest if objective == "peak" else problem.M_max
        assert not len(violated(problem, solution, limit * (1 + 1e-9), none, none)[0])
    values = [
        problem.value(
            largest_singular_values(problem.M(response)), solution.largest * np.ones(1)
        )
        for solution in (reference, found)
        for response in [
            LearningFilter(solution.coefficients, 1.0).frequency_response(omega)
        ]
    ]
    assert values[1] == pytest.approx(values[0], rel=1e-7)
    assert found.cuts is None or len(found.cuts.plant) < 4 * len(omega)


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize("m", [1, 2])
def test_no_radius_is_the_nominal_design_and_a_larger_one_costs_more(m):
    P, Q, omega = random_response(7, m, 12)
    size = np.linalg.norm(P, 2, axis=(1, 2))

    def least_peak(uncertainty=None):
        try:
            return synthesise(
                P, Q, omega, 1.0, **CHOICES, objective="peak", uncertainty=uncertainty
            ).value
        except InfeasibleError as error:  # the peak is above M_max
            return error.smallest_M_max

    nominal, values = (
        least_peak(),
        [least_peak(share * size) for share in (0, 0.1, 0.2)],
    )
    assert values[0] == nominal < values[1] < values[2]


def test_for_one_channel_the_bound_is_the_closed_form():
    """|M| + |Q| r |L| <= M_max."""
    P, Q, omega = random_response(3, 1)
    r = 0.25 * np.abs(P[:, 0, 0])
    choices = CHOICES | {"objective": "peak"}
    norm = synthesise(P, Q, omega, 1.0, uncertainty=r, **choices)
    L = norm.filter.frequency_response(omega)
    M = convergence_matrix(P, Q, L)
    worst = np.abs(M[:, 0, 0]) + np.abs(Q) * r * np.abs(L[:, 0, 0])
    assert worst.max() == pytest.approx(norm.value, rel=1e-8)


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize(
    "earlier",
    ["other bounds", "fewer plants and no radius", "more plants and another radius"],
)
def test_from_an_earlier_design_the_result_is_the_same(earlier):
    P, Q, omega, choices = question(2, "plants and radius", 7, n=12)
    choices["objective"] = "peak"
    cold = synthesise(P, Q, omega, 1.0, **choices)
    radius = 0.05 * np.linalg.norm(P[0], 2, axis=(1, 2))
    other, stated = {
        "other bounds": (P, {"L_max": 6.0}),
        "fewer plants and no radius": (P[:2], {"uncertainty": None}),
        "more plants and another radius": ([*P, 1.05 * P[0]], {"uncertainty": radius}),
    }[earlier]
    start = synthesise(other, Q, omega, 1.0, **choices | stated)
    warm = synthesise(P, Q, omega, 1.0, **choices, start=start)
    assert warm.value == pytest.approx(cold.value, rel=1e-7)


def test_what_stands_in_the_way_is_named():
    """A plant of the wrong sign cannot be learned together with the nominal one."""
    P, Q, omega = random_response(1, 2)
    with pytest.raises(InfeasibleError, match="most in the way: plant 2 at") as error:
        synthesise([P, 1.1 * P, -P], Q, omega, 1.0, **CHOICES)
    assert error.value.plant == 2 and error.value.omega in omega
    assert error.value.smallest_M_max >= Q.max() * (1 - 1e-6)


def test_in_other_units_the_filter_is_the_same():
    """Kelvin and bar against kelvin and pascal, for two plants; a radius is in units of scale."""
    P, Q, omega, choices = question(2, "plants", 4)
    choices |= {"M_max": 0.95, "uncertainty": np.full(len(omega), 0.01)}
    units = np.array([1.0, 1e5])
    factor = units[:, None] / units
    here = synthesise(P, Q, omega, 1.0, **choices)
    there = synthesise([p * factor for p in P], Q, omega, 1.0, scale=units, **choices)
    assert there.value == pytest.approx(here.value, rel=1e-6)
    np.testing.assert_allclose(
        there.filter.coefficients / factor[..., None],
        here.filter.coefficients,
        atol=1e-3,
    )
