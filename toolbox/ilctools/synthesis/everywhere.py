"""Bounds at every frequency: where a filter passes them between those of omega, they are added.

The crests become further frequencies, which have bounds and no part in the sum, until no bound is
passed. Each problem on the way asks for less than the bounds at every frequency do, so that no
filter that meets those is better than its lower bound says.
"""

import numpy as np
from tqdm import tqdm

from ilctools.evidence.peak import crests, peak_of_L, proven_peaks, vertices
from ilctools.problem.grid import refined
from ilctools.problem.problem import Problem, Solution
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.cuts import solve, worst_sigma

ROUNDS, FURTHER = 50, 5000  # and further frequencies, at which to give up
PASSED = 2e-8  # share of a bound that the proof of a peak may pass it by
SAME = 1e-8  # relative distance of frequencies that are one
NEAR = 0.99  # share of a bound from which on a crest is held with those that pass it
# Of the way from a crest to the next frequencies: a filter that is held at its crests moves them,
# so that next time they are between these.
PARTS = (0.01, 0.05, 0.2, 0.5)


def solve_everywhere(problem: Problem) -> tuple[Problem, Solution]:
    """Solve a problem; returned with all frequencies that its bounds need."""
    solution = solve(problem)
    if not problem.everywhere:
        return problem, solution
    for _ in tqdm(range(ROUNDS), "bounds at every frequency", leave=False, delay=3, disable=None):
        wider = _wider(problem, solution, 1 + PASSED)
        if wider is None or len(wider.omega_L) - len(wider.design.omega) > FURTHER:
            break
        problem, solution = wider, solve(wider)
    return problem, solution


def _wider(problem, solution, allowance):
    """The problem with frequencies at which a solution passes its bounds; None if there are none.

    These are the crests that samples show or, where none of them does, the peaks that are proven,
    of which some is only what rounding may add.
    """
    for places in (_crests_of, _peaks_of):
        omega = np.array(places(problem, solution, allowance))
        omega = _new(np.sort(problem.omega_L), omega)
        if not len(omega):
            continue
        wider = refined(problem, omega)
        limit_M, limit_L = _limits(wider, solution, allowance)
        sigma_M, sigma_L = _sigmas(wider, solution, limit_M)
        if sigma_M.max() > limit_M or sigma_L.max() > limit_L:
            return wider
    return None


def _limits(problem, solution, allowance):
    """What sigma_max of M and of L must not exceed, with an allowance for rounding."""
    limit_M = problem.M_max * allowance
    limit_L = np.inf if problem.L_max is None else problem.L_max * allowance
    if problem.objective == "peak":  # less, where that is nearly zero
        value = solution.largest
        limit_M = allowance * (value + (allowance - 1) * (problem.unit(value) - value))
    if problem.objective == "gain":
        limit_L *= solution.largest
    return limit_M, limit_L


def _sigmas(problem, solution, level):
    """The largest singular values of M of all plants at omega, (n,), and of L at omega_L.

    Below the level M within the radius may be less.
    """
    L, plants = problem.response(solution), range(len(problem.plants))
    sigma_M = np.max([worst_sigma(problem, L, k, level) for k in plants], axis=0)
    return sigma_M, largest_singular_values(L)


def _crests_of(problem, solution, allowance):
    """Where the crests of samples pass a bound, if any does; then others that nearly do, too."""
    limit_M, limit_L = _limits(problem, solution, allowance)
    sigma_M, sigma_L = _sigmas(problem, solution, NEAR * limit_M)
    omega_L, order = problem.omega_L, np.argsort(problem.omega_L)

    def passing(share):
        of_M = vertices(problem.omega, sigma_M, share * limit_M)
        of_L = vertices(omega_L[order], sigma_L[order], share * limit_L)
        return [*of_M, *of_L]

    # the next round could hold one and have another rise
    return passing(NEAR) if passing(1) else []


def _peaks_of(problem, solution, allowance):
    """Where M passes its bound, proven, or between samples and within the radius; and L."""
    limit_M, limit_L = _limits(problem, solution, allowance)
    L = problem.learned(solution)
    passing = [peak.omega for peak in proven_peaks(problem, L) if peak.sigma > limit_M]
    for _, omega, sigma in crests(problem, L, limit_M):
        passing += omega[sigma > limit_M].tolist()
    sigma_L, omega = peak_of_L(L)
    return [*passing, omega] if sigma_L > limit_L else passing


def _new(known, omega):
    """Those of some frequencies, and between them and the next, that are not known."""
    after = np.searchsorted(known, omega).clip(1, len(known) - 1)
    around = [omega]
    for neighbour in (known[after], known[after - 1]):
        around += [omega + part * (neighbour - omega) for part in PARTS]
    omega = np.sort(around, axis=None)
    near = np.abs(known - omega[:, None]).min(axis=1, initial=np.inf)
    return omega[np.minimum(near, np.diff(omega, prepend=-np.inf)) > SAME * omega]
