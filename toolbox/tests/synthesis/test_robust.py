"""Filters for several plants, and for all within a radius: against CVXPY, and among each other."""

import numpy as np
import pytest
from plants import half, random_response
from problems import optimum

from ilctools import InfeasibleError, synthesise
from ilctools.problem.pose import pose
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.cuts import solve
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.interior_point import minimise

pytestmark = pytest.mark.filterwarnings("ignore:.*between the frequencies omega")
KINDS = ("radius", "plants", "plants and radius")
OTHERS = 3
CHOICES = {"order": 3, "L_max": 8.0, "band": (0.01, 0.3)}


def question(m, kind, seed, n=8):
    """Plants, Q, frequencies and choices for which the bounds on more than one plant matter."""
    P, Q, omega = random_response(seed, m, n)
    rng = np.random.default_rng(seed)
    choices = dict(CHOICES)
    size = np.linalg.norm(P, 2, axis=(1, 2))
    if kind == "radius":
        choices["uncertainty"] = 0.3 * size
    if kind.startswith("plants"):
        P = [P, *(P * (1 + 0.4 * rng.uniform(-1, 1, (m, m))) for _ in range(OTHERS))]
    if kind == "plants and radius":
        choices["uncertainty"] = 0.1 * size
    return P, Q, omega, choices


@pytest.mark.parametrize(
    ("shape", "objective", "kind"),
    half([(1, "full"), (2, "full"), (2, "diagonal")], ["sum", "peak"], KINDS),
)
def test_cvxpy_finds_the_same_optimum(shape, objective, kind):
    m, structure = shape
    P, Q, omega, choices = question(m, kind, m)
    choices |= {"structure": structure, "objective": objective}
    if objective == "sum":  # a little more than what is possible, so that it is active
        try:
            synthesise(P, Q, omega, 1.0, **choices, M_max=0.01)
        except InfeasibleError as error:
            choices["M_max"] = 1.01 * error.smallest_M_max
    ours = synthesise(P, Q, omega, 1.0, **choices)
    theirs, *_ = optimum(ours.certificate.grid)  # with all bounds that were needed
    assert ours.value == pytest.approx(theirs, rel=1e-5)
    assert ours.certificate.gap < 1e-6
    nominal = synthesise(P[0] if kind.startswith("plants") else P, Q, omega, 1.0,
                         **choices | {"uncertainty": None})  # fmt: skip
    assert ours.value > nominal.value * (1 - 1e-8) - 1e-12 * ours.problem.idle  # or rounding
    if objective == "peak":
        assert ours.value > nominal.value * (1 + 1e-6)  # it costs something


@pytest.mark.parametrize("objective", ["sum", "peak"])
def test_a_selection_of_the_bounds_is_as_good_as_all_of_them(objective):
    P, Q, omega, choices = question(2, "plants", 5)
    problem = pose(P, Q, omega, 1.0, **choices, objective=objective, M_max=0.9)
    plant, frequency = np.indices((OTHERS, len(omega))).reshape(2, -1)
    values = []
    some = solve(problem)
    whole = formulate(problem, plant + 1, frequency)
    for solution in (whole.solution(minimise(whole.program)), some):
        L = problem.L(solution)
        sigma = [largest_singular_values(problem.M(L, k)) for k in range(1 + OTHERS)]
        largest = np.max(sigma)
        assert largest <= 0.9 * (1 + 1e-9)
        values.append(largest if objective == "peak" else problem.objective.value(sigma[0]))
    assert values[1] == pytest.approx(values[0], rel=1e-7)
    assert some.cuts is None or len(some.cuts.plant) < OTHERS * len(omega)


def test_what_stands_in_the_way_is_named():
    """A plant of the wrong sign cannot be learned together with the nominal one."""
    P, Q, omega = random_response(1, 2)
    with pytest.raises(InfeasibleError, match="most in the way: plant 2 at") as error:
        synthesise([P, 1.1 * P, -P], Q, omega, 1.0, **CHOICES)
    assert error.value.plant == 2 and error.value.omega in omega
    assert error.value.smallest_M_max >= Q.max() * (1 - 1e-6)
