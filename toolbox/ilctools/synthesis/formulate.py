"""From a problem to the program that the solvers take: bounds, and a basis for the filter.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise a weighted sum, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. Each of these is a `solver.bounds.Bound`, and so are the cuts,
those for other plants and for a radius.

The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L give
each frequency. It is computed in long doubles, see :func:`ilctools.filters.time_shifts`.
"""

from dataclasses import dataclass

import numpy as np

from ilctools.filters import time_shifts
from ilctools.problem.problem import Cuts, Problem, Solution
from ilctools.singular_values import largest_singular_values
from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.program import GENEROUS, Optimum, Program

SMALLEST = 1e-10  # radius that counts as such, relative to the plant


def orthonormalise(A):
    """A = Q R by Gram and Schmidt, in the precision of A; NumPy's QR is for doubles only."""
    Q, R = A.copy(), np.zeros((A.shape[1],) * 2, dtype=A.dtype)
    for j in range(A.shape[1]):
        for _ in range(3):  # one pass loses a digit for each of the condition number
            share = Q[:, :j].T @ Q[:, j]
            Q[:, j] -= Q[:, :j] @ share
            R[:j, j] += share
        R[j, j] = np.sqrt(Q[:, j] @ Q[:, j])
        Q[:, j] /= R[j, j]
    return Q, R


def whitened_basis(problem):
    """Phi = R^-T [z; z^2; ...], orthonormal with the weight that M and W L give each frequency."""
    Q = np.abs(problem.Q)
    P = problem.through_base(problem.P, np.arange(len(Q)))
    weight = Q * np.linalg.norm(P, axis=(1, 2)) / Q.max()
    weight = np.hypot(weight, largest_singular_values(problem.weight))
    weight = np.maximum(weight, 1e-8 * weight.max())
    z = weight * time_shifts(problem.omega * problem.Ts, problem.order).T
    Phi, R = orthonormalise(np.concatenate([z.real, z.imag], axis=1).T)
    real, imag = np.split(Phi, 2)
    return ((real + 1j * imag).T / weight).astype(complex, order="C"), R


def entries_of(channels, structure):
    """Rows and columns of the entries of L that are not zero."""
    if structure == "full":
        return np.indices((channels, channels)).reshape(2, -1)
    return np.arange(channels), np.arange(channels)


def bound_on_M(problem, plant, frequency, radius, level) -> Bound:
    """The bound on M, (40), for pairs of a plant and a frequency, or on [M; |Q| r L]."""
    if radius is not None:
        radius = np.maximum(radius, SMALLEST * np.abs(problem.P).max())
    F, T = problem.affine(plant, frequency, radius)
    T = problem.through_base(T, frequency)
    return Bound(_long(F), _long(T), frequency, np.broadcast_to(level, len(frequency)))


def _long(X):
    """A matrix for each frequency as a matrix of long vectors."""
    return np.ascontiguousarray(np.moveaxis(X, 0, -1), dtype=complex)


def side_by_side(*bounds) -> Bound:
    """Bounds with matrices of one size as one."""
    return Bound(
        np.concatenate([bound.F for bound in bounds], axis=2),
        np.concatenate([bound.T for bound in bounds], axis=2),
        np.concatenate([bound.at for bound in bounds]),
        np.concatenate([bound.level for bound in bounds]),
    )


@dataclass(frozen=True)
class Formulation:
    """A problem as a program, whose columns are those of M, of L, and of the cuts."""

    problem: Problem
    program: Program
    R: np.ndarray  # (order, order): coefficients are the rows of x R^-T
    nominal: np.ndarray  # frequencies of the bounds on the nominal M
    plant: np.ndarray  # plants and frequencies of the cuts
    frequency: np.ndarray

    def solution(self, optimum: Optimum) -> Solution:
        """The filter and the multipliers of an optimum of the program."""
        problem, program = self.problem, self.program
        m, n = problem.channels, len(problem.omega)
        C, (U, V) = np.zeros((m, m, problem.order)), np.zeros((2, n, m, m), dtype=complex)
        C[program.rows, program.cols] = back_substituted(optimum.x, self.R)
        N = [np.moveaxis(N, -1, 0) for N in optimum.multipliers]
        of_M, of_L, of_cuts = np.split(N[0], [len(self.nominal), len(self.nominal) + n])
        U[self.nominal], V[:] = of_M, problem.weight @ of_L  # of G = M and of G = W L
        if problem.radius is not None:
            of_cuts = N[1]
        cuts = Cuts(self.plant, self.frequency, of_cuts) if len(self.plant) else None
        return Solution(C, U, V, optimum.largest, optimum.iterations, cuts)


def back_substituted(x, R):
    """c of x = c R^T, in the precision of R."""
    c = x.astype(R.dtype)
    for k in reversed(range(len(R))):
        c[:, k] = (c[:, k] - c[:, k + 1 :] @ R[k, k + 1 :]) / R[k, k]
    return c


def levels_of(problem):
    """The cost of each t, both limits, of which the first is that of t, and what bounds what.

    That is a number for M at each frequency, for the cuts, and for W L: of a t, or of a limit.
    """
    of_M, summed = np.zeros(len(problem.omega), int), problem.objective.summed
    if problem.objective.kind == "gain":  # minimise t; W L below t, M below M_max
        return np.ones(1), [GENEROUS, problem.M_max], of_M + 2, 2, 0
    if problem.objective.kind == "peak":  # minimise t; M below t, W L below 1: (45), (46)
        return np.ones(1), [GENEROUS * problem.idle, 1.0], of_M, 0, 2
    # minimise c t; M below t in the sum, else below M_max, W L below 1: (39)
    cost = problem.objective.weights[summed]
    of_M[:], of_M[summed] = len(cost), np.arange(len(cost))
    return cost, [problem.M_max, 1.0], of_M, len(cost), len(cost) + 1


def formulate(problem: Problem, plant=(), frequency=()) -> Formulation:
    """State (39), (45) with (46), or the least gain, with cuts of these plants and frequencies."""
    every, radius = np.arange(len(problem.omega)), problem.radius
    nominal, plant, frequency = _bounded(problem, np.array(plant, int), np.array(frequency, int))
    cost, limits, of_M, of_cuts, of_L = levels_of(problem)
    W = _long(problem.weight)
    M = bound_on_M(problem, 0 * nominal, nominal, None, of_M[nominal])
    L = Bound(0 * W, W, every, 0 * every + of_L)
    cuts = bound_on_M(problem, plant, frequency, radius, of_cuts)
    bounds = (side_by_side(M, L, cuts),) if radius is None else (side_by_side(M, L), cuts)
    basis, R = whitened_basis(problem)
    rows, cols = entries_of(problem.channels, problem.structure)
    most = GENEROUS if problem.objective.kind == "gain" else problem.M_max
    program = Program(bounds, basis, rows, cols, cost, np.array(limits), most)
    return Formulation(problem, program, R, nominal, plant, frequency)


def _bounded(problem, plant, frequency):
    """Frequencies of bounds on the nominal M, and plants and frequencies of the cuts."""
    summed, radius = problem.objective.summed, problem.radius
    of_M = (problem.Q != 0) | summed  # elsewhere L alone is bounded
    # the bound within the radius implies the nominal one
    within = np.zeros(len(of_M), bool) if radius is None else of_M & (radius > 0)
    nominal, within = np.flatnonzero(of_M & (summed | ~within)), np.flatnonzero(within)
    return nominal, np.append(0 * within, plant), np.append(within, frequency)
