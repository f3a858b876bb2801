"""What the solvers solve: bounds on largest singular values, of which some are minimised.

The unknowns x are real, the coefficients of L in a basis. Each bound holds for G = F + T L at its
columns; the weighted sum of the levels of the first one, or the largest level of several, is
minimised.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ilctools.problem.problem import Cuts, Solution, joined
from ilctools.synthesis.solver.bounds import product

GENEROUS = 3.0  # bound on what is minimised, in its unit: never active


class Infeasible(RuntimeError):
    """No filter meets the bounds; `nearest` has the smallest possible M_max, its `largest`."""

    def __init__(self, M_max, nearest):
        super().__init__(f"M_max = {M_max:.10g} is too small, {nearest.largest:.10g} is possible")
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
    cost: np.ndarray  # of each t in what is minimised; one, if it is shared
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
        return size.max() if self.shared else (self.cost * size).sum()

    def minimax(self):
        """The program of the smallest possible bound on M."""
        size = max(np.abs(bound.F[0, 0]).max() for bound in self.bounds if bound.limit == 0)
        limits = np.array([GENEROUS * size, self.limits[1]])
        free, cost = np.arange(self.bounds[0].shape[2]), np.ones(1)
        return replace(self, free=free, cost=cost, shared=True, limits=limits)

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
            for bound, G, split in zip(self.bounds, self.matrices(x), splits, strict=True)
            if bound.limit == 0
        )
        return Solution(C, U, V, largest, method, iterations, joined(cuts))
