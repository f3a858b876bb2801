"""Solve a problem with bounds on M for many plants, by adding only the bounds that are needed.

Among thousands of plants, the bounds of only a handful are active, each at a few frequencies. The
solver starts with few bounds. The bounds that its solution violates, called cuts, are added, until
the solution meets all bounds. A solution that is optimal for some bounds and meets all bounds is
optimal for all bounds.
"""

import numpy as np

from ilctools.evidence.robustness import worst_sigma
from ilctools.problem.problem import Problem, Solution
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.interior_point import minimise

ROUNDING_OF_M = 1e-10  # relative: a smaller violation of M_max is rounding


def solve(problem: Problem) -> Solution:
    """Solve a problem at its own frequencies.

    If no filter meets the bounds, Infeasible is raised.
    """
    plant, frequency = np.empty((2, 0), dtype=int)
    while True:
        formulation = formulate(problem, plant, frequency)
        solution = formulation.solution(minimise(formulation.program))
        limit = solution.largest if problem.objective.kind == "peak" else problem.M_max
        of_plant, at = violated(problem, solution, limit, plant, frequency)
        if not len(at):
            return solution
        plant, frequency = np.append(plant, of_plant), np.append(frequency, at)


def violated(problem, solution, limit, plant, frequency):
    """Find the new bound that is most violated at each frequency.

    Return the plants and the frequencies of these bounds.
    """
    L = problem.L(solution)
    n = len(problem.omega)
    highest, which = np.full(n, limit * (1 + ROUNDING_OF_M)), np.full(n, -1)
    for k in range(1, len(problem.plants)):
        new = np.ones(n, dtype=bool)
        new[frequency[plant == k]] = False
        value = worst_sigma(problem, L, k, highest)
        higher = new & (value > highest)
        highest[higher], which[higher] = value[higher], k
    frequency = np.flatnonzero(which >= 0)
    return which[frequency], frequency
