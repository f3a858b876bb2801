"""The grids on which bounds are bounds at every frequency.

With steps of h at most in the phase of the poles of Q, P and L, see :mod:`.evidence.peak`, what is
M_max cos(h / 2) at most on a grid is M_max at most between its frequencies, and so is L. Samples
have no poles: between them the grid is DENSER than theirs, and as dense as the poles of L ask for.
"""

from dataclasses import replace

import numpy as np

from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase, phase_grid, subdivided

# h, with a proof and else: bounds are lower by 1 - cos(h / 2), which is 1e-5 and 3e-4
PROVEN, ESTIMATED = 0.01, 0.05
MOST = 30_000  # frequencies; of a base of thousands of samples the steps are larger
COARSE = np.pi / 2  # in the phase of L: between steps of this L passes its bound by 8 % at most
DENSER = 10  # frequencies between two samples


def on_a_grid(problem: Problem) -> tuple[Problem, np.ndarray]:
    """The problem at all frequencies at which it needs bounds, and which of them were stated.

    With `everywhere` these are bounds on M and L. Else on L, if omega is coarse for it, and above
    the last sample of P, where only its size is known.
    """
    response, of_L, everywhere = problem.response, problem.poles_of_L, problem.everywhere
    ends = np.concatenate([[0], response.angles, [np.pi]])
    coarse = np.diff(phase(of_L, ends)).max() > COARSE and problem.L_max is not None
    if not (everywhere or coarse or response.beyond is not None):
        return problem, np.ones(len(problem.omega), bool)
    theta, h = _dense(problem)
    omega, last, lower = theta / problem.Ts, problem.omega[-1], np.cos(h / 2)
    if everywhere and not problem.proven:
        omega = np.union1d(omega, subdivided(problem.omega, DENSER))
    if not (everywhere or coarse):
        omega = np.append(np.nextafter(last, np.inf), omega[omega > last])
    grid = replace(
        problem,
        M_max=problem.M_max * (lower if everywhere else 1),
        L_max=problem.L_max and problem.L_max * (lower if everywhere or coarse else 1),
        stated=problem,
    )
    return _extended(grid, np.setdiff1d(omega, problem.omega), lower)


def _dense(problem):
    """Angles from 0 to pi, and the largest step between them in the phase of what is bounded."""
    of_L, lowpass = problem.poles_of_L, problem.lowpass
    step, systems = ESTIMATED, [of_L]
    if problem.everywhere and isinstance(lowpass, ZeroPhaseButterworth):
        of_P = [model.poles() for model in problem.response.models if model is not None]
        systems = [np.concatenate([poles, of_L, lowpass.poles]) for poles in of_P] or systems
        step = PROVEN if problem.proven else ESTIMATED
    turn = max(float(phase(poles, np.array([np.pi]))[0]) for poles in systems)
    theta = phase_grid(systems, max(step, turn / MOST))
    return theta, np.max([np.diff(phase(poles, theta)).max() for poles in systems])


def _extended(problem, omega, lower):
    """The problem at further frequencies, and which of all were stated."""
    design = problem.design
    response, last = design.response, design.omega[-1]
    known = [response.anywhere(k, omega) for k in range(len(response.models))]
    P, radius = np.array([P for P, _ in known]), np.max([radius for _, radius in known], axis=0)
    Q, above = design.lowpass.frequency_response(omega), omega > last
    bounded = (omega >= design.omega[0]) & ~above | (not response.sampled)
    bounded &= problem.everywhere
    if response.beyond is not None:
        # M must keep its bound between these, too: Q falls, and L is larger by 1 / lower
        before = np.append(last, omega[above][:-1])
        Q[above] = np.abs(design.lowpass.frequency_response(before))
        size = np.linalg.norm(P[:, above], 2, axis=(2, 3)).max(axis=0)
        radius[above] = np.maximum(radius[above], size) / lower
        P[:, above] = 0
        bounded |= above & (problem.M_max > Q)  # else no filter does: see `findings`
    order = np.argsort(np.append(problem.omega, omega), kind="stable")

    def merged(stated, added, axis=0):
        return np.concatenate([stated, added], axis).take(order, axis)

    zero = np.zeros(len(problem.omega))
    stated = zero if response.radius is None else response.radius
    radius = merged(stated, np.where(bounded, radius, 0))
    grid = replace(
        problem,
        response=replace(
            response,
            omega=merged(problem.omega, omega),
            P=merged(response.P, P, axis=1),
            radius=radius if radius.any() else None,
        ),
        Q=merged(problem.Q, np.where(bounded, Q, 0)),
        weights=merged(problem.weights, 0 * omega),
    )
    return grid, merged(zero, 0 * omega + 1) == 0


def part(problem: Problem, chosen) -> Problem:
    """The problem at some of its frequencies, (n,) bool."""
    return replace(
        problem,
        response=problem.response.at(chosen),
        Q=problem.Q[chosen],
        weights=problem.weights[chosen],
    )
