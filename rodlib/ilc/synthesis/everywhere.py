"""Bounds at every frequency: where a filter passes them between those of omega, they are added.

The crests become further frequencies, which have bounds and no part in the sum, until no bound is
passed. Each problem on the way asks for less than the bounds at every frequency do, so that no
filter that meets those is better than its lower bound says.
"""

from dataclasses import replace

import numpy as np

from rodlib.ilc.evidence.peak import (
    estimated_peaks,
    learning_model,
    peak_gain,
    proven_peaks,
    spline_scale,
    splined,
)
from rodlib.ilc.filters import LearningFilter
from rodlib.ilc.problem.grid import refined
from rodlib.ilc.problem.problem import Problem, Solution, largest_singular_values

ROUNDS, FURTHER = 50, 5000  # and further frequencies, at which to give up
PASSED = 2e-8  # share of a bound that the proof of a peak may pass it by
SAME = 1e-8  # relative distance of frequencies that are one
NEAR = 0.99  # share of a bound from which on a crest is held with those that pass it
PARTS = (
    0.05,
    0.5,
)  # of the way from a crest to the next frequencies: what is held, too


def settled(
    problem: Problem, solver, start: Solution | None = None, passed=PASSED
) -> tuple[Problem, Solution]:
    """The problem, with all frequencies that its bounds need, and what a solver makes of it."""
    solution = solver(problem, start)
    for _ in range(ROUNDS if problem.everywhere else 0):
        wider = _wider(problem, solution, 1 + passed)
        if wider is None or len(wider.omega) - problem.asked.sum() > FURTHER:
            break
        found = solver(wider, carried(solution, problem.omega, wider.omega))
        iterations = solution.iterations + found.iterations
        solution = replace(found, method=solution.method, iterations=iterations)
        problem = wider
    return problem, solution


def _wider(problem, solution, most):
    """The problem with frequencies at which a solution passes its bounds; None if there are none.

    These are the crests that samples show or, where none of them does, the peaks that are proven,
    of which some is only what rounding may add.
    """
    for places in (_crests_of, _peaks_of):
        omega = _new(problem.omega, np.array(places(problem, solution, most)))
        if not len(omega):
            continue
        wider = refined(problem, omega, *_between(problem, solution, omega))
        if any((sigma > limit).any() for sigma, limit in _sizes(wider, solution, most)):
            return wider
    return None


def _sizes(problem, solution, most):
    """The largest singular values of M, of all plants, and of L, each with what it may be."""
    limit, limit_L = problem.M_max, np.inf if problem.L_max is None else problem.L_max
    if problem.objective == "peak":  # of which next to nothing may be rounding
        limit = solution.largest + (most - 1) * (
            problem.unit(solution.largest) - solution.largest
        )
    if problem.objective == "gain":
        limit_L *= solution.largest
    response, plants = problem.response(solution), range(1 + len(problem.others))
    sigma_M = [largest_singular_values(problem.M(response, k)) for k in plants]
    return (np.array(sigma_M), most * limit), (
        largest_singular_values(response),
        most * limit_L,
    )


def _crests_of(problem, solution, most):
    """Where the crests of samples pass a bound, if any does; then others that nearly do, too."""
    (sigma_M, limit), (sigma_L, limit_L) = _sizes(problem, solution, most)
    known = problem.P.any(axis=(1, 2))  # elsewhere M stands as zero

    def crests(share):
        of_M = _crests(problem.omega[known], sigma_M.max(axis=0)[known], share * limit)
        return [*of_M, *_crests(problem.omega, sigma_L, share * limit_L)]

    # the next round could hold one and have another rise
    return crests(NEAR) if crests(1) else []


def _peaks_of(problem, solution, most):
    """Where a peak passes a bound, proven, or estimated between samples."""
    (sigma_M, limit), (_, limit_L) = _sizes(problem, solution, most)
    L = LearningFilter(solution.coefficients, problem.Ts)
    peaks = [
        *proven_peaks(problem, L),
        *estimated_peaks(problem, L, sigma_M.max(axis=1)),
    ]
    sigma, omega = peak_gain(learning_model(L))
    passing = [peak.omega for peak in peaks if peak.sigma > limit]
    return [*passing, omega] if sigma > limit_L else passing


def _crests(omega, sigma, limit):
    """Where the parabola through three samples, of which the middle one is highest, passes it."""
    (a, b, c), (x, y, z) = (
        [values[i : len(values) - 2 + i] for i in range(3)] for values in (omega, sigma)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        left, right = (y - x) / (b - a), (z - y) / (c - b)
        curvature = (left - right) / (c - a)
        slope = (left * (c - b) + right * (b - a)) / (c - a)
        top, place = y + slope**2 / (4 * curvature), b + slope / (2 * curvature)
    return [*place[(y >= np.maximum(x, z)) & (curvature > 0) & (top > limit)]]


def _new(known, omega):
    """Those of some frequencies that are not known, and between them and the next that are."""
    # A filter that is held at its crests moves them: next time they are between these.
    after = np.searchsorted(known, omega).clip(1, len(known) - 1)
    sides = [
        omega + part * (known[after - k] - omega) for k in (0, 1) for part in PARTS
    ]
    omega = np.sort([omega, *sides], axis=None)
    near = np.abs(known - omega[:, None]).min(axis=1, initial=np.inf)
    return omega[np.minimum(near, np.diff(omega, prepend=-np.inf)) > SAME * omega]


def _between(problem, solution, omega):
    """P of all plants and Q by splines, zero where none are; nothing if all are models."""
    if problem.butterworth is not None and None not in problem.models:
        return ()
    asked, n = problem.asked, len(omega)
    P = np.array([problem.plant(k)[asked] for k in range(len(problem.models))])
    Q, known = problem.Q[asked], problem.omega[asked]
    scale, _ = spline_scale(P[0], Q, known, problem.response(solution)[asked])
    inside = (omega >= known[0]) & (omega <= known[-1])
    all_P, all_Q = np.zeros((len(P), n, *P.shape[2:]), complex), np.zeros(n, Q.dtype)
    between, all_Q[inside] = splined(P.swapaxes(0, 1), Q, known, omega[inside], scale)
    all_P[:, inside] = between.swapaxes(0, 1)
    return all_P, all_Q


def carried(solution: Solution, omega, wider) -> Solution:
    """A solution for frequencies `omega` as a start for others, where multipliers are zero."""
    known = np.isin(omega, wider)
    at = np.searchsorted(wider, omega)
    U, V = np.zeros((2, len(wider), *solution.U.shape[1:]), dtype=complex)
    U[at[known]], V[at[known]] = solution.U[known], solution.V[known]
    cuts = solution.cuts
    if cuts is not None:
        some = known[cuts.frequency]
        parts = {name: getattr(cuts, name)[some] for name in ("plant", "N", "split")}
        cuts = replace(cuts, frequency=at[cuts.frequency[some]], **parts)
    return replace(solution, U=U, V=V, cuts=cuts)
