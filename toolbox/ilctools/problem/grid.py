"""Grids that are dense enough for bounds on the grid to hold at every frequency.

From one frequency of a grid to the next, the phase of the all-pass with the poles of Q, P and L
changes by at most h, see :mod:`.evidence.peak`. If sigma_max(M) is at most M_max cos(h / 2) on the
grid, sigma_max(M) is at most M_max between the frequencies of the grid. The same holds for L. A
plant that is known by samples has no known poles. Between two samples the grid has
FREQUENCIES_PER_SAMPLE frequencies, or as many as the poles of L need. Below the first sample, no
bound on M is added. Only the certificate shows how large M may be there.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase, phase_grid, subdivided
from ilctools.singular_values import largest_singular_values

# h with a proof, and h without a proof: limits are lowered by 1 - cos(h / 2), 1e-5 and 3e-4
PROVEN_PHASE_STEP, ESTIMATED_PHASE_STEP = 0.01, 0.05
MOST_ON_A_GRID = 30_000  # frequencies; if B in L = B K has thousands of samples, steps are larger
COARSE_PHASE_STEP = np.pi / 2  # in the phase of L: with it, L exceeds its bound by 8 % at most
FREQUENCIES_PER_SAMPLE = 10  # between two samples


def on_a_grid(problem: Problem) -> tuple[Problem, np.ndarray]:
    """Return the problem at all frequencies that need bounds, and which of them are the user's.

    If the bounds hold `everywhere`, M and L are also bounded between the frequencies omega.
    Otherwise only L is bounded between these frequencies, if omega is too coarse for L. Bounds are
    also added above the last sample of P, where only the size of P is known. The mask selects the
    frequencies that belong to the user's omega.
    """
    grid, dense = problem, _dense(problem)
    if problem.bounds.everywhere or _is_coarse(problem):
        grid = _bounded_between(problem, dense)
    if problem.response.beyond is not None:
        grid = _bounded_above(grid, problem, dense)
    return grid, np.isin(grid.omega, problem.omega)


class Dense(NamedTuple):
    """A grid with small steps in the phase of the all-pass with the poles of M or L."""

    theta: np.ndarray  # angles from 0 to pi
    shrink: float  # factor on the limits on the grid: cos(h / 2), with the largest step h


def _is_coarse(problem):
    """Check if L may clearly exceed a bound between the frequencies that the user stated."""
    ends = np.concatenate([[0], problem.response.angles, [np.pi]])
    step = np.diff(phase(problem.poles_of_L, ends)).max()
    return step > COARSE_PHASE_STEP and bool(problem.bounds.on("L"))


def _bounded_between(problem, dense) -> Problem:
    """Return the problem with bounds also between its frequencies, where P is known."""
    everywhere, stated = problem.bounds.everywhere, problem.omega
    omega = [dense.theta / problem.Ts, [claim.lowest for claim in problem.bounds.on("L")]]
    if everywhere and not problem.proven:
        omega.append(subdivided(stated, FREQUENCIES_PER_SAMPLE))
    omega = np.setdiff1d(np.concatenate(omega), stated)
    if problem.response.beyond is not None:
        omega = omega[omega < stated[-1]]
    bounds = problem.bounds.lowered(dense.shrink, M=everywhere)
    return replace(_joined(problem, omega, *_between(problem, omega)), bounds=bounds)


def _bounded_above(grid, problem, dense) -> Problem:
    """Return the problem `grid` with bounds also above the last sample of P."""
    last, omega = problem.omega[-1], dense.theta / problem.Ts
    omega = np.append(np.nextafter(last, np.inf), omega[omega > last])
    return _joined(grid, omega, *_above(problem, omega, grid.M_max, dense.shrink))


def _dense(problem) -> Dense:
    """Make a grid with small steps in the phase of the all-pass with the poles of L.

    With `everywhere`, the poles of P and Q are added.
    """
    of_L, lowpass = problem.poles_of_L, problem.lowpass
    step, systems = ESTIMATED_PHASE_STEP, [of_L]
    if problem.bounds.everywhere and isinstance(lowpass, ZeroPhaseButterworth):
        of_P = [model.poles() for model in problem.response.models if model is not None]
        systems = [np.concatenate([poles, of_L, lowpass.poles]) for poles in of_P] or systems
        step = PROVEN_PHASE_STEP if problem.proven else ESTIMATED_PHASE_STEP
    theta = phase_grid(systems, step, MOST_ON_A_GRID)
    h = np.max([np.diff(phase(poles, theta)).max() for poles in systems])
    return Dense(theta, np.cos(h / 2))


def _between(problem, omega):
    """Return P, Q and the radius at additional frequencies.

    Q is set to zero where only L is bounded.
    """
    response = problem.response
    P, radius = _known(response, omega)
    inside = (omega >= response.omega[0]) & (omega <= response.omega[-1])
    bounded = problem.bounds.everywhere & (inside | (not response.sampled))
    Q = problem.lowpass.frequency_response(omega)
    return P, np.where(bounded, Q, 0), np.where(bounded, radius.max(axis=0), 0)


def _known(response, omega):
    """Return P, (plants, k, p, m), and the radius, (plants, k), of all plants at omega, (k,)."""
    plants = range(len(response.models))
    P, radius = zip(*(response.anywhere(plant, omega) for plant in plants), strict=True)
    return np.array(P), np.array(radius)


def _above(problem, omega, M_max, shrink):
    """Return P, Q and radius above the last sample, where only the size of P is known.

    P is zero there, with a radius as large as this size.
    """
    response = problem.response
    # M must also keep its bound between these frequencies. Q decreases there, so that the value of
    # Q at the frequency before counts. L may be larger by the factor 1 / shrink.
    before = np.append(response.omega[-1], omega[:-1])
    Q = np.abs(problem.lowpass.frequency_response(before))
    P, radius = _known(response, omega)
    sizes = np.array([largest_singular_values(of_one) for of_one in P])
    radius = (sizes + radius).max(axis=0) / shrink
    bounded = M_max > Q  # else no filter meets the bound: see Problem.findings
    return 0 * P, np.where(bounded, Q, 0), np.where(bounded, radius, 0)


def _joined(problem, omega, P, Q, radius):
    """Add further frequencies to a problem.

    The further frequencies do not count in the objective.
    """
    response = problem.response
    order = np.argsort(np.append(problem.omega, omega), kind="stable")

    def extended(own, further, axis=0):
        return np.concatenate([own, further], axis).take(order, axis)

    radius = extended(response.radii, radius)
    response = replace(
        response,
        omega=extended(response.omega, omega),
        P=extended(response.P, P, axis=1),
        radius=radius if radius.any() else None,
    )
    objective = problem.objective
    objective = replace(objective, weights=extended(objective.weights, 0 * omega))
    return replace(problem, response=response, Q=extended(problem.Q, Q), objective=objective)


def part(problem: Problem, chosen) -> Problem:
    """Return the problem at the frequencies that the mask `chosen`, (n,), selects."""
    objective = replace(problem.objective, weights=problem.objective.weights[chosen])
    response, Q = problem.response.at(chosen), problem.Q[chosen]
    return replace(problem, response=response, Q=Q, objective=objective)
