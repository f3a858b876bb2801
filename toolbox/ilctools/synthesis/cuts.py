"""Which of the bounds on M for many plants, and for a radius, a program needs: the cuts.

Of thousands of plants a handful is active, each at a few frequencies. A program starts with few of
these bounds and is extended by those that its solution violates, until it violates none. What is
optimal for a part of the bounds and meets all of them is optimal for all.
"""

import numpy as np

from ilctools.problem.problem import largest_singular_values
from ilctools.synthesis.formulate import bound_on_M, entries_of

PASSED = 1e-10  # relative violation that is rounding


def violated(problem, solution, limit, plant, frequency):
    """Plant and frequency of new cuts: at each frequency that which a solution violates most."""
    L = problem.response(solution)
    n = len(problem.omega)
    highest, which = np.full(n, limit * (1 + PASSED)), np.full(n, -1)
    for k in range(1, len(problem.plants)):
        new = np.ones(n, dtype=bool)
        new[frequency[plant == k]] = False
        value = _worst_case(problem, L, k, highest)
        higher = new & (value > highest)
        highest[higher], which[higher] = value[higher], k
    frequency = np.flatnonzero(which >= 0)
    return which[frequency], frequency


def _worst_case(problem, L, k, level):
    """Of M for a plant, exact where it exceeds the level."""
    if problem.radius is None:
        return largest_singular_values(problem.M(L, k))
    every = np.arange(len(problem.omega))
    rows, cols = entries_of(problem.channels, "full")
    bound = bound_on_M(problem, np.full_like(every, k), every, rows, cols)
    G = bound.matrices(L[:, rows, cols].T)
    return bound.tighten(G, bound.first_split(G), level)[1]


def first_cuts(problem, start):
    """The cuts of an earlier solution, if any, as far as the problem has such plants."""
    none = np.array([], dtype=int)
    if start is None or start.cuts is None:
        return none, none
    plant, frequency = start.cuts.plant, start.cuts.frequency
    # the nominal one is in every program
    known = (plant > 0) & (plant < len(problem.plants))
    return plant[known], frequency[known]
