"""The solver of the synthesis: a structured primal-dual interior-point method.

For the program of `program` each bound is a small linear matrix inequality at each column,

    S = [[Lambda, G], [G^H, b I]] >= 0,    G = F + T L(x),    Lambda and b linear in t and d,    (1)

see `bounds`. With multipliers Y >= 0 of these, and eta >= 0 of t <= limit, the Lagrangian
cost . t - sum <S, Y> - (limit - t) . eta is stationary:

    sum <dS/dx, Y> = 0,    sum <dS/dd, Y> = 0,    sum <dS/dt, Y> - eta = cost.    (2)

Then it is at most the optimum, whatever Y and eta, and at x = t = d = 0 it is the dual value

    -sum <S(0), Y> - limit . eta.    (3)

Their difference, the gap, is the complementarity sum <S, Y> + (limit - t) . eta. The method
follows the central path

    Y S = mu I,    (limit - t) eta = mu,    (4)

to mu = 0. Of (4), linearised, the Hermitian part is taken (the HKM direction [1]): with X = S^-1,

    dY = mu X - Y - herm(Y dS X),    deta = (mu - eta (dlimit - dt)) / (limit - t) - eta.    (5)

Mehrotra's corrector [2] subtracts the product of the predictor's dY and dS, as in SDPT3 [3]; see
[4] for the theory. What is particular here:

- t, d and all blocks are eliminated, see `newton`. What remains is one symmetric system in the
  coefficients, whose matrix is a sum over i of m^2 x m^2 matrices times products of powers of z_i.
- G is that of an actual L throughout. If a bound is violated at the start, its limit is moved out,
  and moved back with the steps. Only if this fails is the smallest possible one computed ("phase
  one").

[1] C. Helmberg, F. Rendl, R. Vanderbei, H. Wolkowicz, SIAM J. Optim. 6 (1996) 342; M. Kojima,
    S. Shindoh, S. Hara, ibid. 7 (1997) 86; R. Monteiro, ibid. 7 (1997) 663.
[2] S. Mehrotra, SIAM J. Optim. 2 (1992) 575.
[3] K. Toh, M. Todd, R. Tutuncu, Optim. Methods Softw. 11 (1999) 545; Math. Program. 95 (2003) 189.
[4] L. Vandenberghe, S. Boyd, SIAM Review 38 (1996) 49; M. Todd, Acta Numerica 10 (2001) 515.
[5] S. Eisenstat, H. Elman, M. Schultz, SIAM J. Numer. Anal. 20 (1983) 345.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ilctools.synthesis.solver.inequalities import (
    Slack,
    inner,
    is_inside,
    longest_step,
    positive_definite,
)
from ilctools.synthesis.solver.newton import NewtonSystem
from ilctools.synthesis.solver.program import Infeasible, Optimum, Program

GAP = 2e-9  # relative gap at which to stop
STATIONARY = 0.1  # part of the gap by which rounding may keep (2) from holding
CORRECTIONS = 10  # of a direction for that
MOST_STEPS, MOST_MOVING = 100, 40  # at most, and with limits that are moved
MOST_STAGNANT = 8  # steps without a smaller gap after which to stop
UNIT = 1e-4  # of the cost without learning: a smaller objective is as good as zero
CLOSE = 1e-6  # part of a bound by which one below it may miss the proof that none can be met
SHORTEST = 0.01  # step below which there is no progress
ACCURACY = 0.02  # of a step's length, relative


@dataclass(frozen=True)
class Point:
    """An iterate, or a direction."""

    program: Program
    x: np.ndarray
    t: np.ndarray
    limits: np.ndarray
    d: list
    G: list
    Y: list
    eta: np.ndarray

    def moved(self, direction, primal, dual):
        """The point after a step in a direction."""

        def sums(parts, changes, length):
            pairs = zip(parts, changes, strict=True)
            return [part + length * change for part, change in pairs] if length else parts

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

    @property
    def S(self):
        """Lambda, b and G of each S in (1); of each change, if this is a direction."""
        levels = self.program.at_columns(self.t, self.limits)
        columns = zip(self.program.bounds, levels, self.d, self.G, strict=True)
        return [(bound.diagonal(b, d), b, G) for bound, b, d, G in columns]

    @property
    def room(self):
        """How far t is from its limit."""
        return self.limits[0] - self.t

    @property
    def objective(self):
        return self.program.cost @ self.t

    @property
    def within_limits(self):
        """Whether no limit is moved out."""
        return (self.limits == self.program.limits).all()

    @cached_property
    def complementarity(self):
        """sum <S, Y> + (limit - t) . eta."""
        pairs = zip(self.S, self.Y, strict=True)
        return sum(inner(*S, Y) for S, Y in pairs) + self.room @ self.eta

    @property
    def dual_value(self):
        """The dual objective (3), a lower bound on the optimum where (2) holds."""
        F = [bound.F for bound in self.program.bounds]
        zeros = {"x": 0 * self.x, "t": 0 * self.t, "d": [0 * d for d in self.d], "G": F}
        return -replace(self, **zeros, limits=self.program.limits).complementarity

    @property
    def stationarity(self):
        """sum <dS/dx, Y> of (2)."""
        program, of_L = self.program, []
        for bound, Y in zip(program.bounds, self.Y, strict=True):
            p = len(bound.F)
            of_L.append(program.of_entries(bound, 2 * Y[p:, :p]))
        return program.onto_x(of_L)

    @property
    def degree(self):
        """The number that complementarity is mu times, on the central path."""
        return len(self.t) + sum(Y.shape[0] * Y.shape[2] for Y in self.Y)


def begin(program, x):
    """A point at x that fulfils (4), where the limit of a bound that x violates is moved out."""
    G = program.matrices(x)
    shares = [bound.first_share(G_j) for bound, G_j in zip(program.bounds, G, strict=True)]
    t, peaks = program.largest(program.values(x, shares))
    peaks[0] = max(*t, peaks[0])
    limits = np.where(peaks < program.limits, program.limits, 1.5 * peaks)
    t = (t + limits[0]) / 2
    d = [b * share for b, share in zip(program.at_columns(t, limits), shares, strict=True)]
    p = Point(program, x, t, limits, d, G, [], t)
    X = [Slack(*S).X for S in p.S]
    has_t = program.at_own_t(np.ones(len(t)))
    size = sum(np.einsum("iin,n->", X_j, at).real for X_j, at in zip(X, has_t, strict=True))
    mu = 5 * program.cost.sum() / size
    return replace(p, Y=[mu * X_j for X_j in X], eta=mu / p.room)


class Newton:
    """Directions from a point, by (5) and (2)."""

    def __init__(self, p):
        self.p, self.slacks = p, [Slack(*S) for S in p.S]
        self.system = NewtonSystem(p.program, self.slacks, p.Y, p.eta / p.room)

    def less_product(self, d, Y, dS):
        """A direction, from whose dY herm(Y dS X) is subtracted."""
        columns = zip(d.Y, self.slacks, Y, dS, strict=True)
        return replace(d, Y=[dY - slack.sandwich(Y_j, *dS_j) for dY, slack, Y_j, dS_j in columns])

    def without_unknowns(self, mu, predictor):
        """(5) for dx = dt = dd = 0: dY, deta, and the way of the limits."""
        p = self.p
        toward = p.program.limits - p.limits
        dY = [mu * slack.X - Y for slack, Y in zip(self.slacks, p.Y, strict=True)]
        eta = (mu - p.eta * toward[0]) / p.room - p.eta
        zeros = [0 * d for d in p.d], [0 * G for G in p.G]
        d = Point(p.program, 0 * p.x, 0 * p.t, toward, *zeros, dY, eta)
        if toward.any():
            d = self.less_product(d, p.Y, d.S)
        if predictor is not None:
            d = self.less_product(d, predictor.Y, predictor.S)
            d = replace(d, eta=d.eta - predictor.eta * predictor.room / p.room)
        return d

    def correction(self, multipliers):
        """The direction that makes multipliers stationary, (2), as far as rounding lets it."""
        p = self.p
        dx, dt, dd = self.system.solve(multipliers.stationarity, multipliers.Y, multipliers.eta)
        dG, deta = p.program.linear(dx), p.eta / p.room * dt
        dY = [0 * Y for Y in p.Y]
        change = Point(p.program, dx, dt, 0 * p.limits, dd, dG, dY, deta)
        return self.less_product(change, p.Y, change.S)

    def direction(self, mu, predictor=None, tolerance=None):
        """The direction to (4); None if rounding keeps (2) from holding within a tolerance.

        What rounding has left of the residual of (2) is removed by conjugate residuals [5]: each
        correction is made orthogonal, in its effect, to those before.
        """
        d = self.without_unknowns(mu, predictor)
        d = d.moved(self.correction(self.p.moved(d, 0, 1)), 1, 1)
        if tolerance is None:
            return d
        earlier = []
        for _ in range(CORRECTIONS):
            multipliers = self.p.moved(d, 0, 1)
            residual = multipliers.stationarity
            if np.linalg.norm(residual) <= tolerance:
                return d
            c = self.correction(multipliers)
            effect = -c.stationarity
            for other, of_other in earlier:
                share = (of_other * effect).sum() / (of_other**2).sum()
                c, effect = c.moved(other, -share, -share), effect - share * of_other
            power = (effect**2).sum()
            if power == 0:
                break
            share = (effect * residual).sum() / power
            d = d.moved(c, share, share)
            earlier.append((c, effect))
        return None


def step_lengths(p, direction):
    """The longest primal and dual steps <= 1 from p that keep S, Y, limit - t and eta positive."""
    primal = 1 / max(1, (-direction.room / p.room).max())
    dual = 1 / max(1, (-direction.eta / p.eta).max())
    for S, dS, Y, dY in zip(p.S, direction.S, p.Y, direction.Y, strict=True):
        primal = longest_step(is_inside, S, dS, primal, ACCURACY)
        dual = longest_step(positive_definite, [Y], [dY], dual, ACCURACY)
    return primal, dual


def mehrotra(p):
    """The direction of Mehrotra's method from p; None if it is not accurate enough."""
    try:
        newton = Newton(p)
    except np.linalg.LinAlgError:
        return None
    total, predictor = p.complementarity, newton.direction(0.0)
    primal, dual = step_lengths(p, predictor)
    remaining = p.moved(predictor, primal, dual).complementarity / total
    sigma = min(1, max(remaining, 0)) ** (1 + 2 * min(primal, dual) ** 2)
    size = np.linalg.norm(p.x)
    tolerance = STATIONARY * total / size if size else np.inf
    return newton.direction(sigma * total / p.degree, predictor, tolerance)


def advanced(p, direction):
    """The point after a step that stays inside; None if that is short."""
    lengths = step_lengths(p, direction)
    damping = 0.9 + 0.09 * min(lengths)
    primal, dual = (1.0 if length == 1 else damping * length for length in lengths)
    if max(primal, dual) < SHORTEST:
        return None
    after = p.moved(direction, primal, dual)
    # without rounding
    return replace(after, limits=p.program.limits) if primal == 1 else after


def ruled_out(p, objective):
    """Whether no x that meets the bounds reaches an objective, by the dual value (3)."""
    # By more than the first term, no filter that meets the bounds has a larger |x|.
    program = p.program
    n, m = program.basis.shape[1], program.bounds[0].F.shape[1]
    x_max = np.sqrt(5 * n * m) * np.linalg.norm(p.stationarity)
    return p.dual_value - x_max > objective


class Path(NamedTuple):
    """What came of following the central path."""

    best: Point | None  # the point of the smallest gap within the limits
    end: str  # why it was left


def follow(p, enough=0.0) -> Path:
    """Follow the central path from p to an optimum, or to an objective that is low enough."""
    program, (idle, _) = p.program, p.program.without_learning()
    unit, largest = UNIT * program.cost @ idle, program.cost.sum() * program.limits[0]
    best, smallest_gap, stagnant = None, np.inf, 0
    for step in range(MOST_STEPS):
        if p.within_limits:
            gap = max(p.complementarity, abs(p.objective - p.dual_value))
            stagnant += 1
            if gap < smallest_gap:
                best, smallest_gap, stagnant = p, gap, 0
            if gap < GAP * max(p.objective, unit):
                return Path(best, "the gap is closed")
            if p.objective < enough:
                return Path(best, "the objective is low enough")
            if stagnant == MOST_STAGNANT:
                return Path(best, "the gap does not get smaller")
        elif step > MOST_MOVING:
            return Path(best, "the bounds were not met in time")
        elif ruled_out(p, largest):
            return Path(best, "no filter meets the bounds")
        direction = mehrotra(p)
        if direction is None:
            return Path(best, "rounding spoils the direction")
        p = advanced(p, direction)
        if p is None:
            return Path(best, "the steps became too short")
    return Path(best, "too many steps")


def minimise(program: Program, nearby=None) -> Optimum:
    """Solve a program; Infeasible if the bounds cannot be met, RuntimeError if the method fails.

    The path begins at zero; where it does not lead within the limits, at an x `nearby`, if there is
    one, which keeps them; else at the x of phase one.
    """
    zero = np.zeros((len(program.rows), len(program.basis)))
    path = follow(begin(program, zero))
    if path.best is None and nearby is not None:
        path = follow(begin(program, nearby))
    if path.best is None:
        path = follow(begin(program, phase_one(program, zero).x))
    if path.best is None:
        raise RuntimeError(f"no filter met the bounds: {path.end}")
    if program.shared and path.best.t[0] > program.most:
        raise Infeasible("the bounds cannot be met")
    return optimum(path.best)


def phase_one(program, zero) -> Point:
    """A point that meets the bounds, from the least largest value."""
    nearest, end = follow(begin(program.minimax(), zero), enough=program.most)
    if nearest is None:
        raise RuntimeError(f"no point to start from: {end}")
    if nearest.t[0] < program.most:
        return nearest
    if ruled_out(nearest, (1 - CLOSE) * program.most):
        raise Infeasible("the bounds cannot be met")
    raise RuntimeError(f"the bounds were neither met nor ruled out: {end}")


def optimum(p):
    """What is returned of a point."""
    program = p.program
    shares = [d / b for d, (_, b, _) in zip(p.d, p.S, strict=True)]
    multipliers = [-2 * Y[: len(G), len(G) :] for Y, (_, _, G) in zip(p.Y, p.S, strict=True)]
    t, limits = program.largest(program.values(p.x, shares))
    return Optimum(p.x, multipliers, max(*t, limits[0]))
