"""The solver of the synthesis: a primal-dual interior-point method that uses the structure of M.

The module `program` states the program that is solved: minimise cost . t, where the t are upper
bounds on singular values. Each bound is a small linear matrix inequality at each of its
frequencies, which are called columns here,

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = F + T L(x),    Lambda and b linear in t and d,    (1)

see `bounds`. The unknowns are the coefficients x of L and the numbers t and d. The inequalities
have multipliers Y >= 0, and t <= limit has multipliers eta >= 0. <S, Y> is tr(S Y). At the optimum,
the Lagrangian cost . t - sum <S, Y> - (limit - t) . eta is stationary:

    sum <dS/dx, Y> = 0,    sum <dS/dd, Y> = 0,    sum <dS/dt, Y> - eta = cost.    (2)

If (2) holds, the Lagrangian is a lower bound on the optimum, for any Y and eta. At x = t = d = 0,
the Lagrangian is the dual value

    -sum <S(0), Y> - limit . eta.    (3)

The gap is the difference between the objective and the dual value. If (2) holds, the gap equals the
complementarity, which is defined as sum <S, Y> + (limit - t) . eta. At the optimum, the gap is
zero. The method follows the central path

    Y S = mu I,    (limit - t) eta = mu,    (4)

as mu decreases to zero. For each step, the method linearises (4) and takes the Hermitian part,
which gives the HKM direction [1]. With X = S^-1, the direction is

    dY = mu X - Y - herm(Y dS X),    deta = (mu - eta (dlimit - dt)) / (limit - t) - eta.    (5)

Mehrotra's corrector [2] subtracts the product of dY and dS of a first direction, the predictor, as
in SDPT3 [3]. See [4] for the theory. Two points are particular to this solver:

- The changes of t, d and Y are eliminated, see `newton`. One symmetric system in the coefficients
  remains. Its matrix is a sum over the frequencies i of m^2 x m^2 matrices times products of powers
  of z_i.
- G is always F + T L for an actual filter L. If L violates a bound at the start, the limit of this
  bound is raised, and lowered again with the steps. Only if this fails, the smallest feasible limit
  is computed first ("phase one").

[1] C. Helmberg, F. Rendl, R. Vanderbei, H. Wolkowicz, SIAM J. Optim. 6 (1996) 342; M. Kojima,
    S. Shindoh, S. Hara, ibid. 7 (1997) 86; R. Monteiro, ibid. 7 (1997) 663.
[2] S. Mehrotra, SIAM J. Optim. 2 (1992) 575.
[3] K. Toh, M. Todd, R. Tutuncu, Optim. Methods Softw. 11 (1999) 545; Math. Program. 95 (2003) 189.
[4] L. Vandenberghe, S. Boyd, SIAM Review 38 (1996) 49; M. Todd, Acta Numerica 10 (2001) 515.
[5] S. Eisenstat, H. Elman, M. Schultz, SIAM J. Numer. Anal. 20 (1983) 345.
"""

from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ilctools.synthesis.solver.inequalities import hermitian, inner, inverse, longest_step, product
from ilctools.synthesis.solver.newton import NewtonSystem
from ilctools.synthesis.solver.program import Infeasible, Optimum, Program

RELATIVE_GAP = 2e-9  # the method stops at a smaller gap, relative to the objective
SHARE_OF_GAP = 0.1  # largest effect of the residual of (2), relative to the gap
MOST_CORRECTIONS = 10  # corrections of a direction that reduce the residual of (2)
MOST_STEPS = 100
MOST_STAGNANT = 8  # the method stops after so many steps without a smaller gap
LEAST_OBJECTIVE = 1e-4  # relative to the objective for L = 0: a smaller objective is as good as 0
NEARLY_PROVEN = 1e-6  # relative accuracy of the proof that a limit is infeasible
SHORTEST_STEP = 0.01  # a shorter step makes no progress
LEAST_DAMPING, MORE_DAMPING = 0.9, 0.09  # share of a step to the boundary that is taken [3]
MOVED_OUT = 1.5  # factor: a violated limit is first raised to so many times the violating value
CENTRED = 5.0  # factor on the mu for which (2) holds on average, to start farther inside
LARGEST_X = 5.0  # bound on |x|^2 per frequency and channel for feasible x: 2^2 from M, 1 from L


@dataclass(frozen=True)
class Point:
    """A point of the iteration with all unknowns and multipliers, or a direction."""

    program: Program
    x: np.ndarray
    t: np.ndarray
    limits: np.ndarray
    d: list
    G: list
    Y: list
    eta: np.ndarray

    def moved(self, direction, primal, dual):
        """Return the point after a step in a direction, with primal and dual step lengths."""
        return Point(
            self.program,
            self.x + primal * direction.x,
            self.t + primal * direction.t,
            self.limits + primal * direction.limits,
            sums(self.d, direction.d, primal),
            sums(self.G, direction.G, primal),
            sums(self.Y, direction.Y, dual),
            self.eta + dual * direction.eta,
        )

    @cached_property
    def S(self):
        """S of each bound in (1), or the change of S if this is a direction."""
        levels = self.program.at_columns(self.t, self.limits)
        columns = zip(self.program.bounds, levels, self.d, self.G, strict=True)
        return [bound.inequality(b, d, G) for bound, b, d, G in columns]

    @property
    def room(self):
        """The distance limit - t of each t from its limit."""
        return self.limits[0] - self.t

    @property
    def objective(self):
        """The objective cost . t."""
        return self.program.cost @ self.t

    @property
    def within_limits(self):
        """Whether all limits have their final values, so that none is raised."""
        return (self.limits == self.program.limits).all()

    @cached_property
    def complementarity(self):
        """The complementarity, which is defined as sum <S, Y> + (limit - t) . eta."""
        return sum(map(inner, self.S, self.Y)) + self.room @ self.eta

    @property
    def dual_value(self):
        """The dual objective (3), a lower bound on the optimum if (2) holds."""
        F, d = [bound.F for bound in self.program.bounds], [0 * d for d in self.d]
        at_zero = replace(self, t=0 * self.t, d=d, G=F, limits=self.program.limits)
        return -at_zero.complementarity

    @cached_property
    def gap(self):
        """The objective minus the dual value; it is a valid gap if (2) holds up to rounding."""
        return max(self.complementarity, abs(self.objective - self.dual_value))

    @cached_property
    def stationarity(self):
        """The residual sum <dS/dx, Y> of (2), which is zero if (2) holds."""
        program, of_L = self.program, []
        for bound, Y in zip(program.bounds, self.Y, strict=True):
            p = len(bound.F)
            of_L.append(program.of_entries(bound, 2 * Y[p:, :p]))
        return program.onto_x(of_L)

    @property
    def degree(self):
        """The ratio of complementarity to mu on the central path."""
        return len(self.t) + sum(Y.shape[0] * Y.shape[2] for Y in self.Y)


def sums(parts, changes, length):
    """Return each part plus `length` times its change."""
    pairs = zip(parts, changes, strict=True)
    return [part + length * change for part, change in pairs] if length else parts


def begin(program, x):
    """Make a point at x that fulfils (4).

    If x violates a bound, the limit of this bound is raised.
    """
    G = program.matrices(x)
    shares = [bound.first_share(G_j) for bound, G_j in zip(program.bounds, G, strict=True)]
    t, peaks = program.largest(program.values(x, shares))
    peaks[0] = max(*t, peaks[0])
    limits = np.where(peaks < program.limits, program.limits, MOVED_OUT * peaks)
    t = (t + limits[0]) / 2
    d = [b * share for b, share in zip(program.at_columns(t, limits), shares, strict=True)]
    p = Point(program, x, t, limits, d, G, [], t)
    X = [inverse(S) for S in p.S]
    has_t = program.at_own_t(np.ones(len(t)))
    size = sum(np.einsum("iin,n->", X_j, at).real for X_j, at in zip(X, has_t, strict=True))
    mu = CENTRED * program.cost.sum() / size
    return replace(p, Y=[mu * X_j for X_j in X], eta=mu / p.room)


class Newton:
    """Directions from a point p, by (5) and (2).

    If rounding makes a direction too inaccurate, a LinAlgError is raised.
    """

    def __init__(self, p):
        if not np.all(p.room > 0):
            raise np.linalg.LinAlgError("rounding has moved t to its limit")
        self.p, self.X = p, [inverse(S) for S in p.S]
        self.zero = p.moved(p, -1, -1)
        self.system = NewtonSystem(p.program, self.X, p.Y, p.eta / p.room)

    def less_product(self, d, Y, dS):
        """Subtract herm(Y dS X) from dY of a direction."""
        columns = zip(d.Y, Y, dS, self.X, strict=True)
        dY = [dY_j - hermitian(product(product(Y_j, dS_j), X)) for dY_j, Y_j, dS_j, X in columns]
        return replace(d, Y=dY)

    def without_unknowns(self, mu, predictor):
        """Compute dY and deta by (5) for dx = dt = dd = 0, and the change of raised limits."""
        p = self.p
        toward = p.program.limits - p.limits
        dY = [mu * X - Y for X, Y in zip(self.X, p.Y, strict=True)]
        eta = (mu - p.eta * toward[0]) / p.room - p.eta
        d = replace(self.zero, limits=toward, Y=dY, eta=eta)
        if toward.any():
            d = self.less_product(d, p.Y, d.S)
        if predictor is not None:
            d = self.less_product(d, predictor.Y, predictor.S)
            d = replace(d, eta=d.eta - predictor.eta * predictor.room / p.room)
        return d

    def correction(self, multipliers):
        """Compute the change of all unknowns after which the multipliers fulfil (2)."""
        p = self.p
        dx, dt, dd = self.system.solve(multipliers.stationarity, multipliers.Y, multipliers.eta)
        dG, deta = p.program.linear(dx), p.eta / p.room * dt
        change = replace(self.zero, x=dx, t=dt, d=dd, G=dG, eta=deta)
        return self.less_product(change, p.Y, change.S)

    def direction(self, mu, predictor=None):
        """Compute the direction to the point with this mu on the central path (4)."""
        d = self.without_unknowns(mu, predictor)
        return d.moved(self.correction(self.p.moved(d, 0, 1)), 1, 1)

    def refined(self, d):
        """Correct a direction until the residual of (2), which rounding has caused, is small.

        This is the method of conjugate residuals [5]: the effect of each correction is made
        orthogonal to the effects of all earlier corrections.
        """
        p, earlier = self.p, []
        for _ in range(MOST_CORRECTIONS):
            multipliers = p.moved(d, 0, 1)
            residual = multipliers.stationarity
            missed = np.linalg.norm(residual) * np.linalg.norm(p.x)
            if missed <= SHARE_OF_GAP * p.complementarity:
                return d
            correction = self.correction(multipliers)
            for other in earlier:
                correction = moved_best(correction, other, correction.stationarity)
            if not correction.stationarity.any():
                break
            d = moved_best(d, correction, residual)
            earlier.append(correction)
        raise np.linalg.LinAlgError("rounding keeps (2) from holding")


def moved_best(d, change, residual):
    """Add a multiple of `change` to a direction, such that the residual of (2) is least."""
    effect = change.stationarity
    length = -(effect * residual).sum() / (effect**2).sum()
    return d.moved(change, length, length)


def step_lengths(p, direction):
    """Find the longest primal and dual steps <= 1 that keep S, Y, limit - t and eta positive."""
    primal = 1 / max(1, (-direction.room / p.room).max())
    dual = 1 / max(1, (-direction.eta / p.eta).max())
    for S, dS, Y, dY in zip(p.S, direction.S, p.Y, direction.Y, strict=True):
        primal, dual = longest_step(S, dS, primal), longest_step(Y, dY, dual)
    return primal, dual


def mehrotra(p):
    """Compute the direction of Mehrotra's predictor-corrector method at p."""
    newton, total = Newton(p), p.complementarity
    predictor = newton.direction(mu=0.0)
    primal, dual = step_lengths(p, predictor)
    remaining = p.moved(predictor, primal, dual).complementarity / total
    sigma = min(1, max(remaining, 0)) ** (1 + 2 * min(primal, dual) ** 2)
    return newton.refined(newton.direction(sigma * total / p.degree, predictor))


def advanced(p, direction):
    """Take a step after which all inequalities are still strict.

    If this step is too short, return None.
    """
    lengths = step_lengths(p, direction)
    damping = LEAST_DAMPING + MORE_DAMPING * min(lengths)
    primal, dual = (1.0 if length == 1 else damping * length for length in lengths)
    if max(primal, dual) < SHORTEST_STEP:
        return None
    after = p.moved(direction, primal, dual)
    # after a full step, the limits are exactly the final ones
    return replace(after, limits=p.program.limits) if primal == 1 else after


def ruled_out(p, objective):
    """Check if the dual value (3) proves that no feasible x reaches this objective."""
    # `missed` bounds the error of the dual value: the residual of (2) times the largest feasible
    # |x|.
    program = p.program
    n, m = program.basis.shape[1], program.bounds[0].F.shape[1]
    missed = np.sqrt(LARGEST_X * n * m) * np.linalg.norm(p.stationarity)
    return p.dual_value - missed > objective


class Outcome(Enum):
    """Reasons why the iteration along the central path ended."""

    OPTIMAL = "the duality gap is closed"
    ENOUGH = "the objective is low enough"
    STAGNANT = "the duality gap does not get smaller"
    INFEASIBLE = "no filter meets the bounds"
    ROUNDING = "rounding spoils the search direction"
    SHORT = "the steps became too short"
    MANY = "too many steps"


class Path(NamedTuple):
    """The result of following the central path."""

    best: Point | None  # the point with the smallest gap among those within the final limits
    outcome: Outcome


def follow(p, enough=0.0) -> Path:
    """Follow the central path from p to an optimum, or to an objective that is low enough."""
    best, improved = None, 0
    for step in range(MOST_STEPS):
        if p.within_limits and (best is None or p.gap < best.gap):
            best, improved = p, step
        outcome = outcome_at(p, enough, stagnant=step - improved)
        if outcome is not None:
            return Path(best, outcome)
        try:
            direction = mehrotra(p)
        except np.linalg.LinAlgError:
            return Path(best, Outcome.ROUNDING)
        p = advanced(p, direction)
        if p is None:
            return Path(best, Outcome.SHORT)
    return Path(best, Outcome.MANY)


def outcome_at(p, enough, stagnant) -> Outcome | None:
    """Return the reason why the path ends at p, or None if the path goes on.

    The best point of the path was found `stagnant` steps before p.
    """
    program = p.program
    if not p.within_limits:
        largest = program.cost.sum() * program.limits[0]
        return Outcome.INFEASIBLE if ruled_out(p, largest) else None
    idle, _ = program.without_learning()
    if p.gap < RELATIVE_GAP * max(p.objective, LEAST_OBJECTIVE * program.cost @ idle):
        return Outcome.OPTIMAL
    if p.objective < enough:
        return Outcome.ENOUGH
    return Outcome.STAGNANT if stagnant == MOST_STAGNANT else None


def minimise(program: Program) -> Optimum:
    """Solve a program.

    If the bounds cannot be met, Infeasible is raised. If the method fails, a RuntimeError is
    raised. The path begins at x = 0. If this path does not reach the final limits, another path
    begins at the x of phase one.
    """
    zero = np.zeros((len(program.rows), len(program.basis)))
    best, outcome = follow(begin(program, zero))
    if best is None:
        best, outcome = follow(begin(program, phase_one(program, zero).x))
    if best is None:
        raise RuntimeError(f"the solver found no filter that meets the bounds: {outcome.value}")
    if program.shared and best.t[0] > program.most:
        raise Infeasible("the bounds cannot be met")
    return optimum(best)


def phase_one(program, x) -> Point:
    """Find a point that meets the bounds, by minimising the largest bounded singular value."""
    nearest, outcome = follow(begin(program.minimax(), x), enough=program.most)
    if nearest is None:
        raise RuntimeError(f"the solver found no filter to begin with: {outcome.value}")
    if nearest.t[0] < program.most:
        return nearest
    if ruled_out(nearest, (1 - NEARLY_PROVEN) * program.most):
        raise Infeasible("the bounds cannot be met")
    raise RuntimeError(
        f"the solver could neither meet the bounds nor rule them out: {outcome.value}"
    )


def optimum(p):
    """Convert the final point into the Optimum that the solver returns."""
    program = p.program
    levels = program.at_columns(p.t, p.limits)
    shares = [d / b for d, b in zip(p.d, levels, strict=True)]
    multipliers = [-2 * Y[: len(G), len(G) :] for Y, G in zip(p.Y, p.G, strict=True)]
    t, limits = program.largest(program.values(p.x, shares))
    return Optimum(p.x, multipliers, max(*t, limits[0]))
