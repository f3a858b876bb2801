"""From a problem to the program that the solvers take: bounds, and a basis for the filter.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise a weighted sum, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. Each of these is a `solver.bounds.Bound`, and so are the cuts,
those for other plants and for a radius.

The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L give
each frequency. It is computed in long doubles, see :func:`ilctools.filters.time_shifts`.
"""

from dataclasses import replace

import numpy as np

from ilctools.filters import time_shifts
from ilctools.problem.problem import Problem, largest_singular_values
from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.program import GENEROUS, Program

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
    n, Q = len(problem.omega), np.abs(problem.Q)
    weight = np.zeros(len(problem.omega_L))
    weight[:n] = Q * np.linalg.norm(problem.P, axis=(1, 2)) / Q.max()
    weight = np.hypot(weight, largest_singular_values(problem.weight))
    weight = np.maximum(weight, 1e-8 * weight.max())
    z = weight * time_shifts(problem.omega_L * problem.Ts, problem.order).T
    Phi, R = orthonormalise(np.concatenate([z.real, z.imag], axis=1).T)
    real, imag = np.split(Phi, 2)
    return ((real + 1j * imag).T / weight).astype(complex, order="C"), R


def entries_of(channels, structure):
    """Rows and columns of the entries of L that are not zero."""
    if structure == "full":
        return np.indices((channels, channels)).reshape(2, -1)
    return np.arange(channels), np.arange(channels)


def bound_on_M(problem, plant, frequency, rows, cols, limit=0):
    """The bound on M, or that for the radius, for pairs of a plant, by number, and a frequency."""
    m, Q = problem.channels, problem.Q[frequency]
    P = problem.plants[plant, frequency]
    F, T = np.eye(m)[..., None] * Q, -Q * P.transpose(1, 2, 0)
    if problem.radius is not None:
        r = np.maximum(problem.radius, SMALLEST * np.abs(problem.P).max())[frequency]
        below = np.abs(Q) * r * np.eye(m)[..., None]
        F, T = np.concatenate([F, 0 * below]), np.concatenate([T, below])
    F, T = (np.ascontiguousarray(X, dtype=complex) for X in (F, T))  # as long vectors
    entries = np.arange(len(rows))
    return Bound(F, T, entries, rows, cols, frequency, limit=limit, plant=plant)


def bounds_on_L(problem, rows, cols, limit, whole):
    """The bound sigma_max(W L) <= 1 at omega_L, of L as a whole or of each of its entries."""
    W = np.ascontiguousarray(np.moveaxis(problem.weight, 0, -1), complex)
    at, entries = slice(0, W.shape[-1]), np.arange(len(rows))
    if whole:
        return [Bound(0 * W, W, entries, rows, cols, at, limit=limit, gain=True)]
    first = np.zeros(1, dtype=int)
    weights = [W[entry, entry][None, None] for entry in entries]
    return [
        Bound(0 * w, w, first + entry, first, first, at, limit=limit, gain=True)
        for entry, w in zip(entries, weights, strict=True)
    ]


def formulate(problem: Problem, plant=(), frequency=()) -> Program:
    """State (39), (45) with (46), or the least gain, with cuts of these plants and frequencies."""
    gain = problem.objective == "gain"
    n, m, _ = problem.P.shape
    n_L = len(problem.omega_L)
    rows, cols = entries_of(m, problem.structure)
    on_M = {"rows": rows, "cols": cols, "limit": int(gain)}
    nominal = replace(problem, radius=None)
    # sigma_max(M) <= M_max, or, where it is in the sum (39) or the largest (45), a level
    every, some = np.arange(n), np.flatnonzero(problem.weights)
    first = bound_on_M(problem, 0 * every, every, **on_M)
    if problem.radius is None:
        bounds = [replace(first, at=slice(0, n), plant=None)]
    elif problem.objective == "sum":  # that for the radius implies the nominal one
        of_sum = bound_on_M(nominal, 0 * some, some, **on_M)
        bounds = [replace(of_sum, plant=None), first]
    else:
        bounds = [first]
    # sigma_max(L) <= L_max, (39), (46)
    whole = gain or problem.structure == "full"
    of_L = bounds_on_L(problem, rows, cols, int(not gain), whole)
    bounds = [*of_L, *bounds] if gain else [bounds[0], *of_L, *bounds[1:]]
    if len(plant):
        plant, frequency = np.asarray(plant), np.asarray(frequency)
        bounds.append(bound_on_M(problem, plant, frequency, **on_M))
    basis, R = whitened_basis(problem)
    free, cost = np.arange(n_L), np.ones(1)
    if not gain:
        weights = problem.weights[bounds[0].at]
        free, cost = np.flatnonzero(weights), weights[weights > 0]
    program = Program(
        bounds=tuple(bounds),
        basis=basis,
        R=R,
        entries=len(rows),
        free=free,
        cost=cost,
        shared=gain,
        limits=np.array([GENEROUS, problem.M_max] if gain else [problem.M_max, 1.0]),
        M_max=GENEROUS if gain else problem.M_max,
    )
    return program.minimax() if problem.objective == "peak" else program  # (45)
