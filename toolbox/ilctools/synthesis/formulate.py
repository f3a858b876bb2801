"""From a problem to the program that the solvers take: bounds, and a basis for the filter.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise a weighted sum, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. Each of these is a `solver.bounds.Bound`, and so are the cuts,
those for other plants and for a radius.

The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L give
each frequency. It is computed in long doubles, see :func:`ilctools.filters.time_shifts`.
"""

from dataclasses import dataclass, replace

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
    """The bound on M, (40), for pairs of a plant, by number, and a frequency."""
    P, Q = problem.plants[plant, frequency], problem.Q[frequency]
    identity = np.eye(problem.channels)[..., None]
    F, T = identity * Q, -Q * np.moveaxis(P, 0, -1)  # M = Q I - Q P L
    if radius is not None:  # [M; |Q| r L]
        r = np.maximum(radius, SMALLEST * np.abs(problem.P).max())[frequency]
        F, T = np.concatenate([F, 0 * F]), np.concatenate([T, np.abs(Q) * r * identity])
    F, T = (np.ascontiguousarray(X, dtype=complex) for X in (F, T))  # as long vectors
    return Bound(F, T, frequency, level)


def _by_K(problem, bound):
    """A bound on what L makes, G = F + T L, as one on what K makes."""
    if problem.base is None:
        return bound
    T = np.moveaxis(problem.through_base(np.moveaxis(bound.T, -1, 0), bound.at), 0, -1)
    return replace(bound, T=np.ascontiguousarray(T))


def joined(*bounds) -> Bound:
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
    """The cost of each t, both limits, and which of these numbers bounds what.

    Returns the numbers for M at each frequency, for the cuts, and for W L.
    """
    n, in_sum = len(problem.omega), np.flatnonzero(problem.weights)
    if problem.objective == "sum":  # (39): M by t in the sum, else by M_max; W L by 1
        cost, limits = problem.weights[in_sum], [problem.M_max, 1.0]
        of_M = np.full(n, len(cost))
        of_M[in_sum] = np.arange(len(cost))
        return cost, limits, of_M, len(cost), len(cost) + 1
    if problem.objective == "peak":  # (45), (46): M by t; W L by 1
        return np.ones(1), [GENEROUS * problem.idle, 1.0], np.full(n, 0), 0, 2
    # the least gain: M by M_max; W L by t
    return np.ones(1), [GENEROUS, problem.M_max], np.full(n, 2), 2, 0


def formulate(problem: Problem, plant=(), frequency=()) -> Formulation:
    """State (39), (45) with (46), or the least gain, with cuts of these plants and frequencies."""
    every, summed = np.arange(len(problem.omega)), problem.weights * (problem.objective == "sum")
    of_M = (problem.Q != 0) | (summed > 0)  # elsewhere L alone is bounded
    nominal, plant, frequency = every[of_M], np.array(plant, int), np.array(frequency, int)
    if problem.radius is not None:  # the bound within the radius implies the nominal one
        nominal = np.flatnonzero(of_M & ((problem.radius == 0) | (summed > 0)))
        within = np.flatnonzero(of_M & (problem.radius > 0))
        plant, frequency = np.append(0 * within, plant), np.append(within, frequency)
    cost, limits, levels, of_cuts, of_L = levels_of(problem)
    M = bound_on_M(problem, 0 * nominal, nominal, None, levels[nominal])
    W = np.ascontiguousarray(np.moveaxis(problem.weight, 0, -1), dtype=complex)
    L = Bound(0 * W, W, every, np.full(len(every), of_L))
    cuts = bound_on_M(problem, plant, frequency, problem.radius, np.full(len(plant), of_cuts))
    M, cuts = (_by_K(problem, bound) for bound in (M, cuts))
    bounds = (joined(M, L, cuts),) if problem.radius is None else (joined(M, L), cuts)
    basis, R = whitened_basis(problem)
    rows, cols = entries_of(problem.channels, problem.structure)
    most = GENEROUS if problem.objective == "gain" else problem.M_max
    program = Program(bounds, basis, rows, cols, cost, np.array(limits), most)
    return Formulation(problem, program, R, nominal, plant, frequency)
