"""Translate a design problem into a program for the solver: bounds, and a basis for the filter.

Equation numbers are those of the paper. P_i (m x m) and Q_i (scalar) are given at the frequencies
omega_i. The unknowns are the real coefficients C_k of L(z) = sum_k C_k z^k. The objective is a
weighted sum of all sigma_max(M_i), or the largest sigma_max(M_i), where M_i = Q_i (I - P_i L_i).
The constraints are sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all frequencies, where W is
I / L_max. Each constraint is a `solver.bounds.Bound`. The constraints for further plants and for a
radius, called cuts, are bounds as well.

The powers z, z^2, ... are nearly dependent. They are replaced by a basis that is orthonormal over
the frequencies, with the weight that each frequency has in M and L.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from ilctools.filters import time_shifts
from ilctools.problem.problem import Cuts, Problem, Solution
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.program import GENEROUS, Optimum, Program

SMALLEST_RADIUS = 1e-10  # relative to the plant: a smaller radius is replaced by this one
# Smallest weight of a frequency in the basis, relative to the largest weight. Smaller weights would
# amplify rounding.
SMALLEST_WEIGHT = 1e-8


def whitened_basis(problem):
    """Compute the basis Phi = R^-T [z; z^2; ...] and R.

    Phi is orthonormal over the frequencies, with the weights of M and W L.
    """
    Q = np.abs(problem.Q)
    P = problem.through_base(problem.turned(problem.P), np.arange(len(Q)))
    weight = Q * np.linalg.matrix_norm(P) / Q.max()
    weight = np.hypot(weight, largest_singular_values(problem.L_bound))
    weight = np.maximum(weight, SMALLEST_WEIGHT * weight.max())
    z = weight[:, None] * time_shifts(problem.omega * problem.Ts, problem.order)
    Phi, R = np.linalg.qr(np.concatenate([z.real, z.imag]).astype(float))
    real, imag = np.split(Phi, 2)
    return np.ascontiguousarray((real + 1j * imag).T / weight), R


def bound_on_M(problem, plant, frequency, radius, level) -> Bound:
    """Make the bound on M, (40), for pairs of a plant and a frequency.

    If there is a radius r, the bound is on [M; |Q| r L].
    """
    if radius is not None:
        radius = np.maximum(radius, SMALLEST_RADIUS * np.abs(problem.P).max())
    F, T = problem.affine(plant, frequency, radius)
    levels = np.broadcast_to(level, len(frequency))
    return Bound(_long(F), _long(T), frequency, levels, radius is not None)


def bound_on_L(W, frequency, level) -> Bound:
    """Make the bound on W L, (46), at some frequencies."""
    W = _long(W)
    return Bound(0 * W, W, frequency, np.full(len(frequency), level), within_radius=False)


def _long(X):
    """Return matrices X (n, p, m), one for each frequency, with the frequency as the last axis."""
    return np.ascontiguousarray(np.moveaxis(X, 0, -1), dtype=complex)


@dataclass(frozen=True)
class Formulation:
    """A design problem as a program for the solver."""

    problem: Problem
    program: Program
    R: np.ndarray  # (order, order): the coefficients of L are the rows of x R^-T
    bounds: dict[str, Bound]  # those of "M", "L", "cuts", "beside" that have a frequency
    plant: np.ndarray  # plant of each cut

    def solution(self, optimum: Optimum) -> Solution:
        """Compute the filter and the multipliers from an optimum of the program."""
        problem, program = self.problem, self.program
        m, n = problem.channels, len(problem.omega)
        C, U = np.zeros((m, m, problem.order)), np.zeros((n, m, m), dtype=complex)
        C[program.rows, program.cols] = solve_triangular(self.R, optimum.x.T).T
        multipliers = [np.moveaxis(N, -1, 0) for N in optimum.multipliers]
        of, cuts = dict(zip(self.bounds, multipliers, strict=True)), None
        if "M" in of:
            U[self.bounds["M"].at] = of["M"]
        if "cuts" in of:
            cuts = Cuts(self.plant, self.bounds["cuts"].at, of["cuts"])
        V = problem.L_bound @ of["L"]  # multipliers of L, from those of W L
        return Solution(C, U, V, optimum.largest, cuts)


class Levels(NamedTuple):
    """The right-hand sides of the bounds, which are called levels and have numbers.

    A level is a variable t, which is minimised, or a fixed limit. The numbers count the t from
    zero, and then the limits.
    """

    cost: np.ndarray  # cost of each t
    limits: list[float]  # t <= limits[0]
    M: np.ndarray  # (n,): number of the level of the nominal M at each frequency
    cuts: int  # number of the level of M for other plants, or within a radius
    L: int  # number of the level of W L

    @property
    def one(self) -> int:
        """Number of the last level, the limit 1."""
        return len(self.cost) + len(self.limits) - 1


def levels_of(problem) -> Levels:
    """Define the levels for the objective: (39), (45) with (46), or the least gain."""
    n, one_t = len(problem.omega), np.ones(1)
    match problem.objective.kind:
        case "gain":  # minimise t:  W L <= t,  M <= M_max
            t, _, M_max = range(3)
            limits = [GENEROUS, problem.M_max, 1.0]
            return Levels(one_t, limits, np.full(n, M_max), cuts=M_max, L=t)
        case "peak":  # minimise t:  M <= t,  W L <= 1                    (45), (46)
            t, _, one = range(3)
            limits = [GENEROUS * problem.idle, 1.0]
            return Levels(one_t, limits, np.full(n, t), cuts=t, L=one)
        case "sum":  # minimise w t:  M_i <= t_i <= M_max,  W L <= 1      (39)
            summed = problem.objective.summed
            cost = problem.objective.weights[summed]
            M_max, one = len(cost), len(cost) + 1
            of_M = np.full(n, M_max)
            of_M[summed] = np.arange(len(cost))
            return Levels(cost, [problem.M_max, 1.0], of_M, cuts=M_max, L=one)


def formulate(problem: Problem, plant=(), frequency=()) -> Formulation:
    """Formulate a problem as a program, with cuts at these plants and frequencies."""
    every, kind = np.arange(len(problem.omega)), problem.objective.kind
    nominal, plant, frequency = _bounded(problem, np.array(plant, int), np.array(frequency, int))
    levels, (at, W_beside) = levels_of(problem), problem.L_bound_beside
    bounds = {
        "M": bound_on_M(problem, 0 * nominal, nominal, None, levels.M[nominal]),
        "L": bound_on_L(problem.L_bound, every, levels.L),
        "cuts": bound_on_M(problem, plant, frequency, problem.radius, levels.cuts),
        "beside": bound_on_L(W_beside, at, levels.one),
    }
    bounds = {name: bound for name, bound in bounds.items() if len(bound.at)}
    basis, R = whitened_basis(problem)
    m = problem.channels
    rows, cols = np.nonzero(np.ones((m, m)) if problem.structure == "full" else np.eye(m))
    most = GENEROUS if kind == "gain" else problem.M_max
    limits = np.array(levels.limits)
    program = Program(tuple(bounds.values()), basis, rows, cols, levels.cost, limits, most)
    return Formulation(problem, program, R, bounds, plant)


def _bounded(problem, plant, frequency):
    """Select the frequencies of bounds on the nominal M, and the plants and frequencies of cuts."""
    summed = problem.objective.summed
    of_M = (problem.Q != 0) | summed  # at other frequencies only L is bounded
    # the bound for all plants within the radius implies the bound for the nominal plant
    within = of_M & (problem.response.radii > 0)
    nominal, within = np.flatnonzero(of_M & (summed | ~within)), np.flatnonzero(within)
    return nominal, np.append(0 * within, plant), np.append(within, frequency)
