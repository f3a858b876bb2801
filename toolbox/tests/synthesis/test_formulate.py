"""Filters for several plants, and for all within a radius: against CVXPY, and among each other."""

from dataclasses import replace

import numpy as np
import pytest
from plants import bump, complex_normal, random_response, sigma_of_M
from problems import optimum

from ilctools import InfeasibleError, synthesise
from ilctools.evidence.optimality import lower_bound

pytestmark = pytest.mark.filterwarnings("ignore:.*between the frequencies omega")
SHAPES = [(1, "full"), (2, "full"), (2, "diagonal")]
OBJECTIVES = ["sum", "peak", "weighted"]
KINDS = ("radius", "plants", "plants and radius")
# any two choices meet
CASES = [(SHAPES[i], OBJECTIVES[j], KINDS[i - j]) for i, j in np.ndindex(3, 3)]
OTHERS = 3


def question(m, kind, seed, n=5):
    """Plants, Q, frequencies and choices for which the bounds on more than one plant matter."""
    P, Q, omega = random_response(seed, m, n)
    rng = np.random.default_rng(seed)
    choices = {"order": 3, "L_max": 8.0, "band": (0.01, 0.3)}
    if "radius" in kind:
        share = 0.1 if "plants" in kind else 0.3
        choices["uncertainty"] = share * np.linalg.matrix_norm(P, ord=2) * (np.arange(n) != 1)
    if "plants" in kind:
        P = [P, *(P * (1 + 0.4 * rng.uniform(-1, 1, (m, m))) for _ in range(OTHERS))]
    return P, Q, omega, choices


def check_multipliers(problem, value, U, V, cuts):
    """The bound from those of CVXPY is its optimum, and others are below."""
    bound = lower_bound(problem, U, V, cuts)
    assert value * (1 - 1e-5) < bound < value * (1 + 1e-7)
    if len(problem.plants) > 1:  # what the cuts contribute is needed
        assert lower_bound(problem, U, V) < value / 2
    if problem.radius is not None:  # where it is zero, G has no rows below M
        N = cuts.N.copy()
        N[problem.radius[cuts.frequency] == 0, problem.channels :] += 7
        other = lower_bound(problem, U, V, replace(cuts, N=N))
        assert other == pytest.approx(bound, rel=1e-6)
    rng = np.random.default_rng(0)

    def wrong(X, share):
        return X + share * np.abs(X).max() * complex_normal(rng, *X.shape)

    for share in [1e-3, 0.03, 1, 100] * 3:
        N = replace(cuts, N=wrong(cuts.N, share))
        assert lower_bound(problem, wrong(U, share), wrong(V, share), N) < value * (1 + 1e-7)


@pytest.mark.parametrize(("shape", "objective", "kind"), CASES)
def test_cvxpy_finds_the_same_optimum(shape, objective, kind):
    m, structure = shape
    P, Q, omega, choices = question(m, kind, m)
    choices |= {"structure": structure, "objective": objective}
    if objective == "weighted":
        choices |= {"objective": "sum", "band": None, "reference": bump(100, 1.0 + np.arange(m))}
    if objective != "peak":  # a little more than what is possible, so that it is active
        try:
            synthesise(P, Q, omega, 1.0, **choices, M_max=0.01)
        except InfeasibleError as error:
            choices["M_max"] = 1.01 * error.smallest_M_max
    ours = synthesise(P, Q, omega, 1.0, **choices)
    problem = ours.certificate.problem_on_grid  # with all bounds that were needed
    theirs, U, V, cuts = optimum(problem)
    slack = {"abs": 1e-6 * problem.idle} if objective == "weighted" else {"rel": 1e-5}
    assert ours.value == pytest.approx(theirs, **slack)
    assert ours.certificate.gap < 1e-6
    nominal = P[0] if "plants" in kind else P
    if objective == "peak":  # it costs something
        choices["uncertainty"] = None
        assert ours.value > synthesise(nominal, Q, omega, 1.0, **choices).value * (1 + 1e-6)
    else:
        sigma = sigma_of_M(omega, nominal, Q, ours.filter)
        weights = ours.problem.objective.weights
        assert ours.value == pytest.approx(weights @ sigma, rel=1e-9)
    if theirs > 1e-3:
        check_multipliers(problem, theirs, U, V, cuts)
