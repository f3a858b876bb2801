"""The grids on which bounds are bounds at every frequency.

With steps of h at most in the phase of the poles of Q, P and L, see :mod:`.evidence.peak`, what is
M_max cos(h / 2) at most on a grid is M_max at most between its frequencies, and so is L. Samples
have no poles: between them the grid is DENSER than theirs, and as dense as the poles of L ask for.
"""

from dataclasses import replace

import numpy as np

from ilctools.problem.between import between
from ilctools.problem.phase import phase, phase_grid
from ilctools.problem.problem import Problem

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
    of_L = problem.filter(np.zeros((problem.channels, problem.channels, problem.order))).poles
    angles = np.concatenate([[0], problem.omega * problem.Ts, [np.pi]])
    coarse = np.diff(phase(of_L, angles)).max() > COARSE and problem.L_max is not None
    if not (problem.everywhere or coarse or problem.beyond is not None):
        return problem, np.ones(len(problem.omega), bool)
    systems, proven = [of_L], problem.everywhere and problem.known
    if problem.everywhere and problem.butterworth is not None:
        models = [P.poles() for P in problem.models if P is not None]
        systems = [np.concatenate([P, of_L, problem.butterworth.poles]) for P in models] or systems
    turn = max(float(phase(each, np.array([np.pi]))[0]) for each in systems)
    theta = phase_grid(systems, max(PROVEN if proven else ESTIMATED, turn / MOST))
    h = np.max([np.diff(phase(each, theta)).max() for each in systems])
    omega = theta / problem.Ts
    if problem.everywhere and not proven:
        parts = np.linspace(0, 1, DENSER, endpoint=False)[1:]
        gaps = problem.omega[:-1, None] + parts * np.diff(problem.omega)[:, None]
        omega = np.union1d(omega, gaps)
    if not (problem.everywhere or coarse):
        omega = np.append(np.nextafter(problem.omega[-1], np.inf), omega[omega > problem.omega[-1]])
    lower, L_max = np.cos(h / 2), problem.L_max
    grid = replace(
        problem,
        M_max=problem.M_max * (lower if problem.everywhere else 1),
        L_max=L_max and L_max * (lower if problem.everywhere or coarse else 1),
        stated=problem.design,
    )
    return _merged(grid, np.setdiff1d(omega, problem.omega), lower)


def _merged(problem, omega, lower):
    """The problem at further frequencies, and which of all were stated."""
    design, models = problem.design, problem.models
    inside = (omega >= design.omega[0]) & (omega <= design.omega[-1])
    above = (omega > design.omega[-1]) & (problem.beyond is not None)
    known = problem.butterworth is not None and None not in models
    of_M = (inside | known) & problem.everywhere | above
    plants, (Q, *_), radii = zip(
        *(between(problem, k, omega) for k in range(len(models))), strict=True
    )
    plants, radius = np.array(plants), np.max([_or_zero(r, omega) for r in radii], axis=0)
    if above.any():  # M must keep its bound between these, too: Q falls, and L is larger by lower
        Q[above] = np.abs(design.Q_at(np.append(design.omega[-1], omega[above][:-1])))
        size = np.linalg.norm(plants[:, above], 2, axis=(2, 3)).max(axis=0)
        radius[above] = np.maximum(radius[above], size) / lower
        plants[:, above] = 0
        of_M &= ~above | (problem.M_max > Q)  # else no filter does: see `findings`
    order = np.argsort(np.append(problem.omega, omega), kind="stable")

    def merged(values, added):
        return np.concatenate([values, added])[order]

    radius = merged(_or_zero(problem.radius, problem.omega), np.where(of_M, radius, 0))
    grid = replace(
        problem,
        omega=merged(problem.omega, omega),
        plants=np.concatenate([problem.plants, plants], axis=1)[:, order],
        Q=merged(problem.Q, np.where(of_M, Q, 0)),
        weights=merged(problem.weights, np.zeros(len(omega))),
        radius=radius if radius.any() else None,
    )
    return grid, merged(np.ones(len(problem.omega), bool), np.zeros(len(omega), bool))


def _or_zero(radius, omega):
    return np.zeros(len(omega)) if radius is None else radius


def part(problem: Problem, chosen) -> Problem:
    """The problem at some of its frequencies, (n,) bool."""
    if chosen.all():
        return problem
    radius = None if problem.radius is None else problem.radius[chosen]
    return replace(
        problem,
        omega=problem.omega[chosen],
        plants=problem.plants[:, chosen],
        Q=problem.Q[chosen],
        weights=problem.weights[chosen],
        radius=radius if np.any(radius) else None,
    )
