"""Bounds at further frequencies, where the design frequencies alone would not do.

The learning filter is known at all frequencies, and keeps its bound between those of a coarse grid.
Where the samples of a plant end below the Nyquist frequency, only a bound on its size is assumed,
at any phase; that bounds M.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ilctools.problem.between import between
from ilctools.problem.problem import ROUNDING, Problem


def without_gaps(problem: Problem) -> Problem:
    """The problem with L bounded at further frequencies, where omega is coarse or ends too soon."""
    # But for a delay, a filter of n samples is a polynomial of degree (n - 1) / 2 in exp(i angle).
    # Next to its largest value it falls no faster than the cosine of that degree (M. Riesz).
    angles, near = problem.omega * problem.Ts, np.pi / (4 * problem.order)
    coarse = problem.L_max is not None and _reach(angles).max() > near
    if not coarse and problem.beyond is None:
        return problem
    added = _in_gaps(angles, 0 if coarse else angles[-1], near) / problem.Ts
    if problem.everywhere:  # then L is held at its crests, too
        problem = refined(problem, added)
    else:
        problem = with_L_bounded(problem, added)
        if coarse:
            reach = _reach(problem.omega_L * problem.Ts)
            share = np.cos((problem.order - 1) / 2 * reach)
            problem = replace(problem, share_L=share)
    return problem if problem.beyond is None else _bounded_beyond(problem, near)


def refined(problem: Problem, omega) -> Problem:
    """The problem with bounds on M and L at further frequencies, which are not in the sum.

    There P, Q and the radius are as :func:`.between.between` says. Where samples have ended, the
    first model stands for their plants; without one L alone is bounded.
    """
    omega, design = np.sort(omega), problem.design
    inside = (omega >= design.omega[0]) & (omega <= design.omega[-1])
    models = [k for k, model in enumerate(problem.models) if model is not None]
    if problem.butterworth is None or not models:
        problem, omega = with_L_bounded(problem, omega[~inside]), omega[inside]
        inside = inside[inside]
    if not len(omega):
        return problem
    plants, (Q, *_), radii = zip(
        *(between(problem, k, omega) for k in range(len(problem.plants))), strict=True
    )
    radii = [radius for radius in radii if radius is not None]
    known = np.zeros(len(problem.omega)) if problem.radius is None else problem.radius
    for k, model in enumerate(problem.models):
        if model is None and models:
            plants[k][~inside] = plants[models[0]][~inside]
    n, none = len(problem.omega), np.zeros(len(omega))
    order = np.argsort(np.append(problem.omega, omega), kind="stable")

    def merged(values, added):
        """In the new order; behind it what is known at the frequencies of L alone."""
        return np.append(np.append(values[:n], added)[order], values[n:])

    return replace(
        problem,
        omega=merged(problem.omega, omega),
        plants=np.concatenate([problem.plants, np.array(plants)], axis=1)[:, order],
        Q=merged(problem.Q, Q),
        weights=merged(problem.weights, none),
        radius=merged(known, np.max(radii, axis=0)) if radii else None,
        share_L=merged(problem.share_L, none + 1),
        limit_L=merged(problem.limit_L, none + np.inf),
        stated=design,
    )


def with_L_bounded(problem, omega):
    """The problem with L alone bounded at further frequencies."""
    return replace(
        problem,
        further=np.append(problem.further, omega),
        share_L=np.append(problem.share_L, np.ones(len(omega))),
        limit_L=np.append(problem.limit_L, np.full(len(omega), np.inf)),
    )


def _in_gaps(angles, start, near):
    """Angles from `start` to pi, no farther than `near` apart together with those that are known.

    The ends of the unit circle's upper half are among them, unless they are known.
    """
    pieces = [
        np.linspace(a, b, int(np.ceil((b - a) / near)), endpoint=False)[1:]
        for a, b in pairwise([0, *angles, np.pi])
    ]
    ends = np.array([0, np.pi])[np.abs(angles[[0, -1]] - [0, np.pi]) > ROUNDING]
    grid = np.sort(np.concatenate([ends, *pieces]))
    return grid[grid >= start]


def _reach(angles):
    """The farthest from each angle that another can be and have no nearer one."""
    order = np.argsort(angles)
    between = np.diff(angles[order]) / 2
    reach = np.empty(len(angles))
    reach[order] = np.maximum([angles[order[0]], *between], [*between, np.pi - angles[order[-1]]])
    return reach


def _bounded_beyond(problem, near):
    """The problem with L bounded above the last sample so that M is, whatever the phase of P."""
    [beyond] = np.nonzero(problem.omega_L >= problem.design.omega[-1])
    beyond = beyond[np.argsort(problem.omega_L[beyond])]
    Q = problem.Q_beyond(problem.omega_L[beyond])
    Q = np.maximum.accumulate(np.append(Q[0], Q[:-1]))  # M must keep its bound in between, too
    limits = problem.limit_L.copy()
    with np.errstate(divide="ignore"):  # |Q (I - P L)| <= |Q| (1 + size sigma_max(L))
        limit = np.cos((problem.order - 1) / 4 * near) * (problem.M_max / Q - 1) / problem.beyond
    limits[beyond] = np.where(problem.M_max > Q, limit, np.inf)
    return replace(problem, limit_L=limits)
