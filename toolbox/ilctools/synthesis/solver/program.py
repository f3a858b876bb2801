"""The program that the solver solves: bounds on singular values, some of which are minimised.

With real unknowns x and basis functions Phi of the frequency, x Phi are the entries (rows, cols) of
L. All other entries of L are zero. The frequencies of all bounds are called columns. The program is

    minimise cost . t   subject to   sigma_max(F_i + T_i L) <= b_i for all columns i,  t <= limit_0,

where b_i is either a fixed limit or one of the variables t. If many columns share a single t, the
largest singular value in these columns is minimised. If each of some columns has its own t, the
weighted sum of their singular values is minimised.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.inequalities import product

GENEROUS = 3.0  # limit on t, in the unit of the objective; this limit is never active


@dataclass(frozen=True)
class Optimum:
    """The result of the solver."""

    x: np.ndarray  # (e, order), the coefficients
    multipliers: list[np.ndarray]  # multipliers of G in each bound
    largest: float  # largest singular value of all bounds by a t or by the first limit


class Infeasible(RuntimeError):
    """No filter meets the bounds."""


@dataclass(frozen=True)
class Program:
    """The objective cost . t and the bounds of a program."""

    bounds: tuple[Bound, ...]
    basis: np.ndarray  # (order, n): Phi
    rows: np.ndarray  # (e,): entries of L that are not zero; x has shape (e, order)
    cols: np.ndarray
    cost: np.ndarray  # cost of each t
    limits: np.ndarray  # limits of the bounds; the first limit bounds each t, too
    most: float  # largest allowed singular value of all bounds by a t or by the first limit

    @property
    def shared(self):
        """Whether all columns with a t share a single t."""
        return len(self.cost) == 1

    def at_columns(self, t, limits):
        """Return the value of t or of the limit that belongs to each column of each bound."""
        numbers = np.append(t, limits)
        return [numbers[bound.level] for bound in self.bounds]

    def at_own_t(self, t):
        """Return the value of t that belongs to each column of each bound.

        If a column has a limit instead of a t, the value is zero.
        """
        return self.at_columns(t, 0 * self.limits)

    def largest(self, values):
        """Find the largest of the bounds' values for each t, and for each limit."""
        largest = np.zeros(len(self.cost) + len(self.limits))
        for bound, value in zip(self.bounds, values, strict=True):
            np.maximum.at(largest, bound.level, value)
        return np.split(largest, [len(self.cost)])

    def without_learning(self):
        """Find the largest values for L = 0, for each t and for each limit."""
        return self.largest([np.abs(bound.F[0, 0]) for bound in self.bounds])

    def minimax(self):
        """Make a program that minimises the largest bounded value.

        Only values with a t or with the first limit count. All other values keep their limits.
        """
        t, (first, *_) = self.without_learning()
        bounds = []
        for bound in self.bounds:  # the one t has number 0, the limits follow
            number = np.maximum(bound.level - len(self.cost), 0)
            bounds.append(replace(bound, level=np.where(number > 0, number + 1, 0)))
        limits = np.append(GENEROUS * max(*t, first), self.limits[1:])
        return replace(self, bounds=tuple(bounds), cost=np.ones(1), limits=limits)

    def linear(self, x):
        """Compute T L of each bound for the coefficients x."""
        m = self.bounds[0].T.shape[1]
        L = np.zeros((m, m, self.basis.shape[1]), dtype=complex)
        L[self.rows, self.cols] = x @ self.basis
        return [product(bound.T, L[..., bound.at]) for bound in self.bounds]

    def matrices(self, x):
        """Compute G = F + T L of each bound for the coefficients x."""
        changes = zip(self.bounds, self.linear(x), strict=True)
        return [bound.F + change for bound, change in changes]

    def values(self, x, shares):
        """Compute the smallest b of each bound with these shares d / b, (c,)."""
        columns = zip(self.bounds, self.matrices(x), shares, strict=True)
        return [bound.value(G, share) for bound, G, share in columns]

    def of_entries(self, bound, W):
        """Compute the g with Re tr(W T L) = Re sum g L over the entries of L, (e, c)."""
        return product(W, bound.T)[self.cols, self.rows]

    @cached_property
    def incidence(self):
        """Matrices (c, n) with a one at the frequency of each column.

        A product with such a matrix sums g by frequency.
        """
        n = self.basis.shape[1]
        columns = [(bound.at, np.arange(len(bound.at) + 1)) for bound in self.bounds]
        return [csr_array((np.ones(len(at)), at, rows), (len(at), n)) for at, rows in columns]

    def onto_x(self, g):
        """Compute the derivative of sum Re g L with respect to x, with one g for each bound."""
        pairs = zip(g, self.incidence, strict=True)
        return (sum(g_j @ incidence for g_j, incidence in pairs) @ self.basis.T).real
