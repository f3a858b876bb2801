"""What the solver solves: bounds on largest singular values, of which some are minimised.

With real unknowns x and functions Phi of the frequency, L = x Phi has the entries `rows`, `cols`;
the others are zero. The program is

    minimise cost . t   subject to   sigma_max(F_i + T_i L) <= b_i for all columns i,  t <= limit_0,

where b_i is one of the limits or one of the variables t. Either there is a single t for many
columns, whose largest is minimised, or a t for each of some columns, whose weighted sum is
minimised.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ilctools.synthesis.solver.bounds import Bound
from ilctools.synthesis.solver.inequalities import product

GENEROUS = 3.0  # bound on what is minimised, in its unit: never active


@dataclass(frozen=True)
class Optimum:
    """What the solver returns."""

    x: np.ndarray
    multipliers: list[np.ndarray]  # of G in each bound
    largest: float  # of all bounds with the first limit


class Infeasible(RuntimeError):
    """The bounds cannot be met."""


@dataclass(frozen=True)
class Program:
    """What to minimise, and within which bounds."""

    bounds: tuple[Bound, ...]
    basis: np.ndarray  # (order, n): Phi
    rows: np.ndarray  # (e,): entries of L that are not zero; x has shape (e, order)
    cols: np.ndarray
    cost: np.ndarray  # of each t
    limits: np.ndarray  # of the bounds; the first one bounds each t, too
    most: float  # what the largest with a t or the first limit must not exceed

    @property
    def shared(self):
        """Whether there is a single t."""
        return len(self.cost) == 1

    def at_columns(self, t, limits):
        """Numbers for each t and each limit at the columns of each bound, such as its levels b."""
        numbers = np.append(t, limits)
        return [numbers[bound.level] for bound in self.bounds]

    def at_own_t(self, t):
        """Numbers for each t at the columns of each bound; zero at the columns of a limit."""
        return self.at_columns(t, 0 * self.limits)

    def largest(self, values):
        """The largest value at the columns of each t, and of each limit, of values by bound."""
        largest = np.zeros(len(self.cost) + len(self.limits))
        for bound, value in zip(self.bounds, values, strict=True):
            np.maximum.at(largest, bound.level, value)
        return np.split(largest, [len(self.cost)])

    def without_learning(self):
        """The same for L = 0, where G is a multiple of I."""
        return self.largest([np.abs(bound.F[0, 0]) for bound in self.bounds])

    def minimax(self):
        """The program of the least possible largest value of what has a t or the first limit."""
        t, (first, *_) = self.without_learning()
        bounds = []
        for bound in self.bounds:  # the one t has number 0, the limits follow
            number = np.maximum(bound.level - len(self.cost), 0)
            bounds.append(replace(bound, level=np.where(number > 0, number + 1, 0)))
        limits = np.append(GENEROUS * max(*t, first), self.limits[1:])
        return replace(self, bounds=tuple(bounds), cost=np.ones(1), limits=limits)

    def linear(self, x):
        """T L of each bound."""
        m = self.bounds[0].T.shape[1]
        L = np.zeros((m, m, self.basis.shape[1]), dtype=complex)
        L[self.rows, self.cols] = x @ self.basis
        return [product(bound.T, L[..., bound.at]) for bound in self.bounds]

    def matrices(self, x):
        """G = F + T L of each bound."""
        changes = zip(self.bounds, self.linear(x), strict=True)
        return [bound.F + change for bound, change in changes]

    def values(self, x, shares):
        """The smallest b of each bound, shape (c,), with a share d / b."""
        columns = zip(self.bounds, self.matrices(x), shares, strict=True)
        return [bound.value(G, share) for bound, G, share in columns]

    def of_entries(self, bound, W):
        """The g with Re tr(W T L) = Re sum g L, for the entries of L in a bound, (e, c)."""
        return product(W, bound.T)[self.cols, self.rows]

    @cached_property
    def incidence(self):
        """Of each bound, which column is at which frequency, (c, n): g @ incidence adds them up."""
        n = self.basis.shape[1]
        columns = [(bound.at, np.arange(len(bound.at) + 1)) for bound in self.bounds]
        return [csr_array((np.ones(len(at)), at, rows), (len(at), n)) for at, rows in columns]

    def onto_x(self, g):
        """The derivative of sum Re g L with respect to x, of numbers for each bound's entries."""
        pairs = zip(g, self.incidence, strict=True)
        return (sum(g_j @ incidence for g_j, incidence in pairs) @ self.basis.T).real
