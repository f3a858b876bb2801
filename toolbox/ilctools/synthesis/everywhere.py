"""Solve a problem with bounds at every frequency, by adding only the bounds that are needed.

Bounds at all frequencies follow from bounds on a dense grid. Among these thousands of bounds, only
a few are active. The solver starts with the bounds at the design frequencies. The bounds that its
solution violates are added, until the solution meets all bounds. A solution that is optimal for
some bounds and meets all bounds is optimal for all bounds.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import find_peaks

from ilctools.evidence.robustness import worst_sigma
from ilctools.problem.grid import on_a_grid, part
from ilctools.problem.problem import Problem, Solution
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.cuts import solve

ROUNDING_OF_BOUND = 1e-9  # relative: a smaller violation of a bound is rounding
ROUNDS = 50  # number of rounds after which the search gives up
FEW = 100  # number of bounds that are added in a round, besides the most violated bounds


def solve_everywhere(problem: Problem, nearest=False) -> tuple[Problem, Solution]:
    """Solve a problem with bounds at every frequency.

    Return the problem at all frequencies that needed bounds, and its solution. With `nearest`, find
    the least M_max for which the problem is feasible, instead of the optimum.
    """
    grid, chosen = on_a_grid(problem)
    if nearest:
        peak = replace(grid.objective, kind="peak")
        grid = replace(grid, objective=peak, bounds=replace(grid.bounds, M_max=np.inf))
    for _ in range(ROUNDS):
        wider = part(grid, chosen)
        solution = solve(wider)
        share = np.where(chosen, 0, _share(grid, solution))
        if share.max() <= 1 + ROUNDING_OF_BOUND:
            break
        chosen = chosen | _worst(share)
    return wider, solution


def _share(problem, solution):
    """Compute the largest ratio of a bounded value to its limit at each frequency, (n,)."""
    limit_M, gain = problem.M_max, 1.0
    if problem.objective.kind == "peak":  # with room for rounding if the peak is near zero
        limit_M = solution.largest + ROUNDING_OF_BOUND * problem.gap_scale(solution.largest)
    if problem.objective.kind == "gain":
        gain = solution.largest
    L, K = problem.L(solution), problem.K(solution)
    numbers = range(len(problem.plants))
    sigma_M = np.max([worst_sigma(problem, L, k, limit_M) for k in numbers], axis=0)
    shares = np.maximum(sigma_M / limit_M, largest_singular_values(problem.L_bound @ K) / gain)
    at, W = problem.L_bound_beside
    shares[at] = np.maximum(shares[at], largest_singular_values(W @ K[at]))
    return shares


def _worst(share):
    """Select frequencies at which bounds are violated.

    These are all local maxima of `share`, and FEW other frequencies.
    """
    passed = np.flatnonzero(share > 1 + ROUNDING_OF_BOUND)
    crests, _ = find_peaks(np.pad(share, 1), height=1 + ROUNDING_OF_BOUND)
    chosen = np.zeros(len(share), bool)
    chosen[crests - 1] = chosen[passed[:: 1 + len(passed) // FEW]] = True
    return chosen
