"""Which of the bounds on M for many plants, and for a radius, a program needs: the cuts.

Of thousands of plants a handful is active, each at a few frequencies. A program starts with few of
these bounds and is extended by those that its solution violates, until it violates none. What is
optimal for a part of the bounds and meets all of them is optimal for all.
"""

import numpy as np

from ilctools.problem.problem import Problem, Solution
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.formulate import bound_on_M, formulate
from ilctools.synthesis.solver.interior_point import minimise
from ilctools.synthesis.solver.program import Infeasible

PASSED = 1e-10  # relative violation that is rounding
HALVINGS = 50  # of an interval of shares, which is then below rounding


def solve(problem: Problem, enough: float = 0.0) -> Solution:
    """Solve a problem at its frequencies; Infeasible, with the nearest solution, if it is.

    Below the objective `enough` the solution need not be the optimum.
    """
    plant, frequency = np.empty((2, 0), dtype=int)
    while True:
        formulation = formulate(problem, plant, frequency)
        try:
            solution = formulation.solution(minimise(formulation.program, enough))
        except Infeasible as error:
            raise Infeasible(formulation.solution(error.nearest)) from None
        limit = solution.largest if problem.objective == "peak" else problem.M_max
        of_plant, at = violated(problem, solution, limit, plant, frequency)
        if not len(at):
            return solution
        plant, frequency = np.append(plant, of_plant), np.append(frequency, at)


def violated(problem, solution, limit, plant, frequency):
    """Plant and frequency of new cuts: at each frequency that which a solution violates most."""
    L = problem.response(solution)
    n = len(problem.omega)
    highest, which = np.full(n, limit * (1 + PASSED)), np.full(n, -1)
    for k in range(1, len(problem.plants)):
        new = np.ones(n, dtype=bool)
        new[frequency[plant == k]] = False
        value = worst_sigma(problem, L, k, highest)
        higher = new & (value > highest)
        highest[higher], which[higher] = value[higher], k
    frequency = np.flatnonzero(which >= 0)
    return which[frequency], frequency


def worst_sigma(problem, L, k, level):
    """sigma_max(M) of a plant within the radius; where it is below the level, an upper bound."""
    if problem.radius is None:
        return largest_singular_values(problem.M(L, k))
    every = np.arange(len(problem.omega))
    bound = bound_on_M(problem, np.full_like(every, k), every, problem.radius, every)
    G = bound.F + np.einsum("ijn,njk->ikn", bound.T, L[every])
    value = bound.value(G, bound.first_share(G))
    active = value > level
    value[active] = least_value(bound, G[..., active])
    return value


def least_value(bound, G):
    """The least of sigma_max(Lambda(share)^(-1/2) G), convex in the share, by bisection.

    With the right singular vector x, its derivative has the sign of

        |M x|^2 / (1 - share)^2 - |H x|^2 / share^2,    G = [M; H].
    """
    q = G.shape[1]
    low, high = np.zeros(G.shape[2]), np.ones(G.shape[2])
    for _ in range(HALVINGS):
        share = (low + high) / 2
        scaled = G / np.sqrt(bound.diagonal(1.0, share))[:, None]
        x = np.linalg.svd(np.moveaxis(scaled, -1, 0))[2][:, 0].conj()
        images = np.einsum("ijn,nj->in", G, x)
        M_x, H_x = (np.linalg.norm(part, axis=0) for part in (images[:q], images[q:]))
        rises = M_x * share > H_x * (1 - share)
        low, high = np.where(rises, low, share), np.where(rises, share, high)
    return bound.value(G, share)
