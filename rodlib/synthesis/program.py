"""The problem in the form in which the solvers take it: bounds, and a basis for the filter.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise the sum over a band, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. Each of these is a :class:`rodlib.synthesis.bounds.Bound`.

The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L give
each frequency. It is computed in long doubles, see :func:`rodlib.filters.time_shifts`.
"""

from dataclasses import dataclass, replace

import numpy as np

from rodlib.filters import time_shifts
from rodlib.problem import Problem, Solution
from rodlib.synthesis.bounds import Bound, product

GENEROUS = 3.0  # bound on what is minimised, in its unit: never active


class Infeasible(RuntimeError):
    """No filter of this order and structure meets the bounds; see `smallest_M_max`."""

    def __init__(self, M_max, smallest_M_max):
        super().__init__(f"M_max = {M_max:.10g} is too small, {smallest_M_max:.10g} is possible")
        self.smallest_M_max = smallest_M_max


@dataclass(frozen=True)
class Program:
    """What to minimise, and within which bounds.

    Attributes
    ----------
    bounds : tuple of Bound
        M, then W L, or each of its entries if L is diagonal; W L, then M, for the least gain.
    basis, R : ndarray, shape (order, n) and (order, order)
        L = x basis at the frequencies, for x of shape (entries, order); the coefficients are
        the rows of x R^-T.
    entries : int
        How many entries of L are not zero.
    free : ndarray
        Frequencies at which the first bound has a variable t for its level.
    shared : bool
        Whether it is the same for all of them: their largest is minimised, not their sum.
    limits : ndarray, shape (2,)
        Of the first bound, and of t; of the others.
    M_max : float
        What the largest of the first bound must not exceed.
    """

    bounds: tuple
    basis: np.ndarray
    R: np.ndarray
    entries: int
    free: np.ndarray
    shared: bool
    limits: np.ndarray
    M_max: float

    @property
    def idle(self):
        """The objective without learning."""
        size = np.abs(self.bounds[0].F[0, 0, self.free])
        return size.max() if self.shared else size.sum()

    def peak(self):
        """The program of the smallest possible bound on M."""
        size = np.abs(self.bounds[0].F[0, 0])
        limits = np.array([GENEROUS * size.max(), self.limits[1]])
        return replace(self, free=np.arange(len(size)), shared=True, limits=limits)

    def levels(self, t, limits):
        """The level b of each bound, given t and the limits on M and L."""
        b = [np.full(self.basis.shape[1], limits[min(j, 1)]) for j in range(len(self.bounds))]
        b[0][self.free] = t
        return b

    def matrices(self, x):
        """G of each bound, from the unknowns x, shape (entries, order)."""
        L = x @ self.basis
        return [bound.F + bound.response(L) for bound in self.bounds]

    def unknowns(self, coefficients):
        """The x of given coefficients, shape (m, m, order)."""
        bound = self.bounds[0]
        return (coefficients[bound.rows, bound.cols] @ self.R.T).astype(float)

    def solution(self, x, multipliers, method, iterations):
        """Solution from the unknowns and the multipliers of G, shape (q, q, n) for each bound."""
        bound, m = self.bounds[0], len(self.bounds[0].T)
        C = np.zeros((m, m, x.shape[1]))
        c = x.astype(self.R.dtype)  # back substitution, in the precision of R
        for k in reversed(range(len(self.R))):
            c[:, k] = (c[:, k] - c[:, k + 1 :] @ self.R[k, k + 1 :]) / self.R[k, k]
        C[bound.rows, bound.cols] = c
        U, *V = (
            product(bound.T if j else np.eye(m)[..., None], N).transpose(2, 0, 1)
            for j, (bound, N) in enumerate(zip(self.bounds, multipliers, strict=True))
        )
        V = V[0] if V[0].shape[1] == m else np.concatenate(V, axis=1) * np.eye(m)
        peak = np.linalg.norm(self.matrices(x)[0], 2, axis=(0, 1)).max()
        return Solution(C, U, V, peak, method, iterations)


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


def whitened_basis(P, Q, angles, order, W):
    """Phi = R^-T [z; z^2; ...], orthonormal with the weight that M and W L give each frequency."""
    weight = np.linalg.norm(Q[:, None, None] * P, axis=(1, 2)) / np.abs(Q).max()
    weight = np.hypot(weight, np.linalg.norm(W, 2))
    weight = np.maximum(weight, 1e-8 * weight.max())
    z = weight * time_shifts(angles, order).T
    Phi, R = orthonormalise(np.concatenate([z.real, z.imag], axis=1).T)
    n = len(angles)
    return ((Phi[:n] + 1j * Phi[n:]).T / weight).astype(complex, order="C"), R


def formulate(problem: Problem) -> Program:
    """State (39), (45) with (46), or the least gain for M_max, in terms of bounds."""
    P, Q, W = problem.P, problem.Q, problem.weight
    n, m, _ = P.shape
    full = problem.structure == "full"
    rows, cols = np.indices((m, m)).reshape(2, -1) if full else 2 * (np.arange(m),)
    entries = np.arange(len(rows))
    identity = np.repeat(np.eye(m, dtype=complex)[..., None], n, axis=2)
    T = np.ascontiguousarray(-Q * P.transpose(1, 2, 0))
    bounds = [Bound(Q * identity, T, entries, rows, cols)]
    if full or problem.objective == "gain":
        bounds.append(Bound(0 * identity, W[..., None] * np.ones(n), entries, rows, cols))
    else:  # smaller ones, one for each entry
        one = np.ones((1, 1, n), dtype=complex)
        bounds += [Bound(0 * one, W[e, e] * one, entries[[e]], rows[:1], cols[:1]) for e in entries]
    basis, R = whitened_basis(P, Q, problem.angles, problem.order, W)
    if problem.objective == "gain":
        free, limits = np.arange(n), np.array([GENEROUS, problem.M_max])
        return Program(tuple(bounds[::-1]), basis, R, len(rows), free, True, limits, GENEROUS)
    limits = np.array([problem.M_max, 1.0])
    free = np.flatnonzero(problem.in_band)
    program = Program(tuple(bounds), basis, R, len(rows), free, False, limits, problem.M_max)
    return program.peak() if problem.objective == "peak" else program
