"""Grids that are dense enough for bounds on the grid to hold at every frequency.

The steps of a grid are at most h in the phase of the poles of Q, P and L, see
:mod:`.evidence.peak`. If sigma_max(M) is at most M_max cos(h / 2) on the grid, it is at most M_max
between its frequencies. The same holds for L. Samples have no poles. Between two samples the grid
has FREQUENCIES_PER_SAMPLE frequencies, or as many as the poles of L need.
Below the first sample no bound on M is added. Only the certificate shows what may happen there.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase, phase_grid, subdivided
from ilctools.singular_values import largest_singular_values

# h with a proof, and h without: bounds are lower by 1 - cos(h / 2), which is 1e-5 and 3e-4
PROVEN_PHASE_STEP, ESTIMATED_PHASE_STEP = 0.01, 0.05
MOST_ON_A_GRID = 30_000  # frequencies; with a base of thousands of samples the steps are larger
COARSE_PHASE_STEP = np.pi / 2  # of L: between such steps L exceeds its bound by 8 % at most
FREQUENCIES_PER_SAMPLE = 10  # between two samples


def on_a_grid(problem: Problem) -> tuple[Problem, np.ndarray]:
    """Return the problem at all frequencies that need bounds, and which of them were stated.

    With `everywhere`, M and L are bounded between the frequencies. Otherwise L is bounded between
    them if omega is coarse for L. Bounds are also added above the last sample of P, where only the
    size of P is known.
    """
    between = problem.bounds.everywhere or _is_coarse(problem)
    if not between and problem.response.beyond is None:
        return problem, np.ones(len(problem.omega), bool)
    dense = _dense(problem)
    grid = _bounded_between(problem, dense) if between else problem
    if problem.response.beyond is not None:
        grid = _bounded_above(grid, problem, dense)
    return grid, np.isin(grid.omega, problem.omega)


class Dense(NamedTuple):
    """A grid that is dense in the phase of what is bounded."""

    theta: np.ndarray  # angles from 0 to pi
    shrink: float  # cos(h / 2), with the largest step h: factor on limits on the grid


def _is_coarse(problem):
    """Whether L may exceed a bound between the stated frequencies."""
    ends = np.concatenate([[0], problem.response.angles, [np.pi]])
    step = np.diff(phase(problem.poles_of_L, ends)).max()
    return step > COARSE_PHASE_STEP and bool(problem.bounds.on("L"))


def _bounded_between(problem, dense) -> Problem:
    """The problem with bounds also between its frequencies, where P is known."""
    everywhere, stated = problem.bounds.everywhere, problem.omega
    denser = stated
    if everywhere and not problem.proven:
        denser = subdivided(stated, FREQUENCIES_PER_SAMPLE)
    first = [claim.lowest for claim in problem.bounds.on("L")]
    omega = np.concatenate([dense.theta / problem.Ts, denser, first])
    omega = np.setdiff1d(omega, stated)
    if problem.response.beyond is not None:
        omega = omega[omega < stated[-1]]
    bounds = problem.bounds.lowered(dense.shrink, M=everywhere)
    return replace(_joined(problem, omega, *_between(problem, omega)), bounds=bounds)


def _bounded_above(grid, problem, dense) -> Problem:
    """A grid of the problem with bounds also above the last sample of P."""
    last, omega = problem.omega[-1], dense.theta / problem.Ts
    omega = np.append(np.nextafter(last, np.inf), omega[omega > last])
    return _joined(grid, omega, *_above(problem, omega, grid.M_max, dense.shrink))


def _dense(problem) -> Dense:
    """The grid for the poles of L; with `everywhere`, also for the poles of P and Q."""
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
    """P, Q and the radius between the frequencies; Q is zero where L alone is bounded."""
    response = problem.response
    P, radius = _known(response, omega)
    inside = (omega >= response.omega[0]) & (omega <= response.omega[-1])
    bounded = problem.bounds.everywhere & (inside | (not response.sampled))
    Q = problem.lowpass.frequency_response(omega)
    return P, np.where(bounded, Q, 0), np.where(bounded, radius.max(axis=0), 0)


def _known(response, omega):
    """P, (p, k, m, m), and the radius, (p, k), of all plants."""
    plants = range(len(response.models))
    P, radius = zip(*(response.anywhere(plant, omega) for plant in plants), strict=True)
    return np.array(P), np.array(radius)


def _above(problem, omega, M_max, shrink):
    """P, Q and radius above the last sample: P is zero, and the radius is the size of P."""
    response = problem.response
    # M must also keep its bound between these frequencies: Q falls, L is larger by 1 / shrink
    before = np.append(response.omega[-1], omega[:-1])
    Q = np.abs(problem.lowpass.frequency_response(before))
    P, radius = _known(response, omega)
    sizes = np.array([largest_singular_values(of_one) for of_one in P])
    radius = (sizes + radius).max(axis=0) / shrink
    bounded = M_max > Q  # else no filter keeps the bound: see `findings`
    return 0 * P, np.where(bounded, Q, 0), np.where(bounded, radius, 0)


def _joined(problem, omega, P, Q, radius):
    """The problem with further frequencies, which do not count in the objective."""
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
    """Return the problem at some of its frequencies, chosen by (n,) bool."""
    objective = replace(problem.objective, weights=problem.objective.weights[chosen])
    response, Q = problem.response.at(chosen), problem.Q[chosen]
    return replace(problem, response=response, Q=Q, objective=objective)
