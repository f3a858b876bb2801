"""The problem in the form in which the solvers take it: bounds, and a basis for the filter.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise the sum over a band, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. Each of these is a `bounds.Bound`,
and so are the cuts, those for other plants and for a radius.

The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L give
each frequency. It is computed in long doubles, see :func:`rodlib.ilc.filters.time_shifts`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rodlib.ilc.filters import time_shifts
from rodlib.ilc.problem.problem import (
    Cuts,
    Problem,
    Solution,
    joined,
    largest_singular_values,
)
from rodlib.ilc.synthesis.solver.bounds import Bound, product

GENEROUS = 3.0  # bound on what is minimised, in its unit: never active
SMALLEST = 1e-10  # radius that counts as such, relative to the plant


class Infeasible(RuntimeError):
    """No filter meets the bounds; `nearest` has the smallest possible M_max, its `largest`."""

    def __init__(self, M_max, nearest):
        super().__init__(
            f"M_max = {M_max:.10g} is too small, {nearest.largest:.10g} is possible"
        )
        self.nearest = nearest


@dataclass(frozen=True)
class Program:
    """What to minimise, and within which bounds."""

    # M, then W L or, if L is diagonal, each of its entries; W L, then M, for the least gain; the
    # cuts. M is left out where a cut implies it.
    bounds: tuple
    # (order, n) and (order, order): L = x basis for x of shape (entries, order), and the
    # coefficients are the rows of x R^-T
    basis: np.ndarray
    R: np.ndarray
    entries: int  # how many of L are not zero
    free: np.ndarray  # columns at which the first bound has a variable t for its level
    # whether t is the same for these, and for all bounds with the first limit: their largest is
    # minimised, not a sum
    shared: bool
    limits: np.ndarray  # of the bounds; the first is that of t, too
    M_max: float  # what the largest with the first limit must not exceed

    @cached_property
    def products(self):
        """phi_k^* phi_l and phi_k^* phi_l^*, real and imaginary parts in turn, (2 n, order^2)."""
        conjugate = self.basis.conj()
        both = (conjugate[:, None] * second for second in (self.basis, conjugate))
        return [X.reshape(-1, X.shape[-1]).view(float).T for X in both]

    @property
    def idle(self):
        """The objective without learning."""
        size = np.abs(self.bounds[0].F[0, 0, self.free])
        return size.max() if self.shared else size.sum()

    def minimax(self):
        """The program of the smallest possible bound on M."""
        size = max(
            np.abs(bound.F[0, 0]).max() for bound in self.bounds if bound.limit == 0
        )
        limits = np.array([GENEROUS * size, self.limits[1]])
        free = np.arange(self.bounds[0].shape[2])
        return replace(self, free=free, shared=True, limits=limits)

    def has_t(self, j):
        """The columns of bound j whose level is a variable."""
        if self.shared and self.bounds[j].limit == 0:
            return np.arange(self.bounds[j].shape[2])
        return self.free if j == 0 else np.array([], dtype=int)

    def levels(self, t, limits):
        """The level b of each bound, given t and the limits."""
        b = [np.full(bound.shape[2], limits[bound.limit]) for bound in self.bounds]
        for j, level in enumerate(b):
            if len(columns := self.has_t(j)):
                level[columns] = t
        return b

    def matrices(self, x):
        """G of each bound, from the unknowns x, shape (entries, order)."""
        L = x @ self.basis
        return [bound.F + bound.response(L) for bound in self.bounds]

    def unknowns(self, coefficients):
        """The x of given coefficients, shape (m, m, order)."""
        bound = self.bounds[0]
        return (coefficients[bound.rows, bound.cols] @ self.R.T).astype(float)

    def solution(self, x, multipliers, splits, method, iterations):
        """Solution from the unknowns and, for each bound, the multipliers of G and the split."""
        first = self.bounds[0]
        m = first.T.shape[1]
        C = np.zeros((m, m, x.shape[1]))
        c = x.astype(self.R.dtype)  # back substitution, in the precision of R
        for k in reversed(range(len(self.R))):
            c[:, k] = (c[:, k] - c[:, k + 1 :] @ self.R[k, k + 1 :]) / self.R[k, k]
        C[first.rows, first.cols] = c
        U, V = np.zeros((2, self.basis.shape[1], m, m), dtype=complex)
        cuts = []
        for j, (bound, N) in enumerate(zip(self.bounds, multipliers, strict=True)):
            if bound.plant is not None:
                N = N.T.swapaxes(1, 2)
                cuts.append(Cuts(bound.plant, bound.at, N, splits[j].T))
            elif not bound.gain:
                U[bound.at] = np.moveaxis(N, -1, 0)
            elif len(N) == m:
                V = np.moveaxis(product(bound.T, N), -1, 0)
            else:
                [entry] = bound.entries
                V[:, entry, entry] = (bound.T * N)[0, 0]
        largest = max(
            bound.value(G, split).max()
            for bound, G, split in zip(
                self.bounds, self.matrices(x), splits, strict=True
            )
            if bound.limit == 0
        )
        return Solution(C, U, V, largest, method, iterations, joined(cuts))


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
    at = slice(0, W.shape[-1])
    if whole:
        entries = np.arange(len(rows))
        return [Bound(0 * W, W, entries, rows, cols, at, limit=limit, gain=True)]
    first = np.zeros(1, dtype=int)
    return [
        Bound(
            np.zeros((1, 1, W.shape[-1]), dtype=complex),
            W[entry, entry][None, None],
            np.array([entry]),
            first,
            first,
            at,
            limit=limit,
            gain=True,
        )
        for entry in range(len(rows))
    ]


def formulate(problem: Problem, plant=(), frequency=()) -> Program:
    """State (39), (45) with (46), or the least gain, with cuts of these plants and frequencies."""
    gain = problem.objective == "gain"
    n, m, _ = problem.P.shape
    rows, cols = entries_of(m, problem.structure)
    on_M = {"rows": rows, "cols": cols, "limit": int(gain)}
    nominal = replace(problem, radius=None)
    # sigma_max(M) <= M_max, or, where it is in the sum (39) or the largest (45), a level
    every, some = np.arange(n), np.flatnonzero(problem.in_band)
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
    if gain:
        return Program(
            bounds=tuple(bounds),
            basis=basis,
            R=R,
            entries=len(rows),
            free=np.arange(bounds[0].shape[2]),
            shared=True,
            limits=np.array([GENEROUS, problem.M_max]),
            M_max=GENEROUS,
        )
    program = Program(
        bounds=tuple(bounds),
        basis=basis,
        R=R,
        entries=len(rows),
        free=np.flatnonzero(problem.in_band[bounds[0].at]),
        shared=False,
        limits=np.array([problem.M_max, 1.0]),
        M_max=problem.M_max,
    )
    return program.minimax() if problem.objective == "peak" else program  # (45)
