"""The program that the solver solves: bounds on singular values, some of which are minimised.

With real unknowns x and functions Phi of the frequency, L = x Phi has the entries `rows`, `cols`.
All other entries are zero. The program is

    minimise cost . t   subject to   sigma_max(F_i + T_i L) <= b_i for all columns i,  t <= limit_0,

where b_i is one of the limits or one of the variables t. If there is a single t for many columns,
the largest value of these columns is minimised. If each of some columns has a t of its own, the
weighted sum of these t is minimised.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.inequalities import product

GENEROUS = 3.0  # bound on what is minimised, in its unit, which is never active


@dataclass(frozen=True)
class Optimum:
    """What the solver returns."""

    x: np.ndarray
    multipliers: list[np.ndarray]  # multipliers of G in each bound
    largest: float  # largest value of all bounds with a t or the first limit


class Infeasible(RuntimeError):
    """The bounds cannot be met."""


@dataclass(frozen=True)
class Program:
    """What to minimise, and within which bounds."""

    bounds: tuple[Bound, ...]
    basis: np.ndarray  # (order, n): Phi
    rows: np.ndarray  # (e,): entries of L that are not zero; x has shape (e, order)
    cols: np.ndarray
    cost: np.ndarray  # cost of each t
    limits: np.ndarray  # limits of the bounds; the first limit bounds each t, too
    most: float  # upper bound on the largest value with a t or the first limit

    @property
    def shared(self):
        """Whether there is a single t."""
        return len(self.cost) == 1

    def at_columns(self, t, limits):
        """Distribute numbers for each t and limit to the columns of each bound, like levels b."""
        numbers = np.append(t, limits)
        return [numbers[bound.level] for bound in self.bounds]

    def at_own_t(self, t):
        """Distribute numbers for each t to the columns of each bound; zero for a limit."""
        return self.at_columns(t, 0 * self.limits)

    def largest(self, values):
        """Find the largest of the values by bound, for each t and for each limit."""
        largest = np.zeros(len(self.cost) + len(self.limits))
        for bound, value in zip(self.bounds, values, strict=True):
            np.maximum.at(largest, bound.level, value)
        return np.split(largest, [len(self.cost)])

    def without_learning(self):
        """Find the largest values for L = 0, where G is a multiple of I."""
        return self.largest([np.abs(bound.F[0, 0]) for bound in self.bounds])

    def minimax(self):
        """Make the program that minimises the largest value with a t or the first limit."""
        t, (first, *_) = self.without_learning()
        bounds = []
        for bound in self.bounds:  # the one t has number 0, the limits follow
            number = np.maximum(bound.level - len(self.cost), 0)
            bounds.append(replace(bound, level=np.where(number > 0, number + 1, 0)))
        limits = np.append(GENEROUS * max(*t, first), self.limits[1:])
        return replace(self, bounds=tuple(bounds), cost=np.ones(1), limits=limits)

    def linear(self, x):
        """Compute T L of each bound."""
        m = self.bounds[0].T.shape[1]
        L = np.zeros((m, m, self.basis.shape[1]), dtype=complex)
        L[self.rows, self.cols] = x @ self.basis
        return [product(bound.T, L[..., bound.at]) for bound in self.bounds]

    def matrices(self, x):
        """Compute G = F + T L of each bound."""
        changes = zip(self.bounds, self.linear(x), strict=True)
        return [bound.F + change for bound, change in changes]

    def values(self, x, shares):
        """Compute the smallest b of each bound, shape (c,), with a share d / b."""
        columns = zip(self.bounds, self.matrices(x), shares, strict=True)
        return [bound.value(G, share) for bound, G, share in columns]

    def of_entries(self, bound, W):
        """Compute g with Re tr(W T L) = Re sum g L, for the entries of L in a bound, (e, c)."""
        return product(W, bound.T)[self.cols, self.rows]

    @cached_property
    def incidence(self):
        """The frequency of each column of each bound, (c, n): g @ incidence adds up g."""
        n = self.basis.shape[1]
        columns = [(bound.at, np.arange(len(bound.at) + 1)) for bound in self.bounds]
        return [csr_array((np.ones(len(at)), at, rows), (len(at), n)) for at, rows in columns]

    def onto_x(self, g):
        """Compute the derivative of sum Re g L over x, with g for each bound's entries."""
        pairs = zip(g, self.incidence, strict=True)
        return (sum(g_j @ incidence for g_j, incidence in pairs) @ self.basis.T).real
