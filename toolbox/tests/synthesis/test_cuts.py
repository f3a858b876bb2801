"""Which bounds on many plants are needed, against all of them at once."""

import numpy as np
import pytest
from plants import random_response, sigma_of_M
from problems import posed

from ilctools.synthesis.cuts import solve
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.interior_point import minimise


def test_a_handful_of_cuts_gives_the_optimum_of_all():
    P, Q, omega = random_response(3, 2, 12)
    plants, choices = [P, 0.7 * P, P @ np.diag([1.3, 0.7])], {"order": 3, "L_max": 8.0}
    least = solve(posed(plants, Q, omega, 1.0, **choices, objective="peak")).largest
    problem = posed(plants, Q, omega, 1.0, **choices, M_max=1.02 * least)
    others = np.repeat([1, 2], len(omega))
    every = formulate(problem, others, np.tile(np.arange(len(omega)), 2))
    few, all_of_them = solve(problem), every.solution(minimise(every.program))
    assert 0 < len(few.cuts.plant) < len(others) / 2
    by_few, by_all = (sigma_of_M(omega, P, Q, problem.L(found)) for found in (few, all_of_them))
    weights = problem.objective.weights
    assert weights @ by_few == pytest.approx(weights @ by_all, rel=1e-6)
