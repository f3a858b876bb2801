"""The solver of the synthesis: a structured primal-dual interior-point method.

The program of `program` has bounds sigma_max(G_i) <= b at each frequency,
where b is a variable t (one for each frequency of the band, or a single one for the largest),
M_max or one. Each is a small linear matrix inequality S >= 0 with a multiplier Y >= 0, and perhaps
a further variable d, see `bounds`.

The method follows the central path Y S = mu I with the HKM direction [1] and Mehrotra's predictor
and corrector [2], as in SDPT3 [3]; see [4] for the theory. What is particular here:

- The variables t and d and all blocks are eliminated. What remains is one symmetric system in the
  coefficients, whose matrix is a sum over i of m^2 x m^2 matrices times products of powers of z_i.
- G is that of an actual filter throughout. If a bound is violated at the start, it is moved out,
  and moved back with the steps. Only if this fails is the smallest M_max computed ("phase one").

[1] C. Helmberg, F. Rendl, R. Vanderbei, H. Wolkowicz, SIAM J. Optim. 6 (1996) 342; M. Kojima,
    S. Shindoh, S. Hara, ibid. 7 (1997) 86; R. Monteiro, ibid. 7 (1997) 663.
[2] S. Mehrotra, SIAM J. Optim. 2 (1992) 575.
[3] K. Toh, M. Todd, R. Tutuncu, Optim. Methods Softw. 11 (1999) 545; Math. Program. 95 (2003) 189.
[4] L. Vandenberghe, S. Boyd, SIAM Review 38 (1996) 49; M. Todd, Acta Numerica 10 (2001) 515.
[5] S. Eisenstat, H. Elman, M. Schultz, SIAM J. Numer. Anal. 20 (1983) 345.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from ilctools.problem.problem import Solution
from ilctools.synthesis.solver.bounds import add_columns
from ilctools.synthesis.solver.inequalities import Slack, longest_step, trace
from ilctools.synthesis.solver.newton import factorise
from ilctools.synthesis.solver.program import Infeasible, Program

GAP = 2e-9  # relative gap at which to stop
# Part of the gap by which rounding may keep the multipliers from being stationary.
STATIONARY = 0.1
# Ways to a step: whether by a square root, slow and accurate, and how often rounding is looked at.
WAYS = ((False, 2), (False, 10), (True, 10))
PATIENCE = 3  # s without a word on progress


@dataclass(frozen=True)
class Point:
    """An iterate, or a direction. The coefficients x refer to the basis, eta to t <= limit."""

    x: np.ndarray
    t: np.ndarray
    limits: np.ndarray
    d: list
    G: list
    Y: list
    eta: np.ndarray

    def moved(self, d, primal, dual):
        """The point after a step in the direction d."""
        return Point(
            self.x + primal * d.x,
            self.t + primal * d.t,
            self.limits + primal * d.limits,
            [A + primal * D for A, D in zip(self.d, d.d, strict=True)],
            [A + primal * D for A, D in zip(self.G, d.G, strict=True)],
            [A + dual * D for A, D in zip(self.Y, d.Y, strict=True)],
            self.eta + dual * d.eta,
        )

    def S(self, program):
        """What S = [[Lambda, G], [G^H, b I]] of each bound consists of: Lambda, b and G."""
        b = program.levels(self.t, self.limits)
        return [
            (bound.diagonal(level, d), level, G)
            for bound, level, d, G in zip(program.bounds, b, self.d, self.G, strict=True)
        ]


def step_lengths(program, p, d, slacks, accuracy):
    """The longest primal and dual steps <= 1 from p in the direction d."""
    primal = 1 / max(1, ((d.t - d.limits[0]) / (p.limits[0] - p.t)).max())
    dual = 1 / max(1, (-d.eta / p.eta).max())
    for slack, Y, dY, dS in zip(slacks, p.Y, d.Y, d.S(program), strict=True):
        primal = min(primal, 1 / max(1, (-dS[1] / slack.b).max()))
        primal = longest_step(slack.along(*dS), primal, accuracy)
        dual = longest_step([Y, dY], dual, accuracy)
    return primal, dual


def stationarity(program, Y):
    """Derivative of sum <S, Y> with respect to the coefficients."""
    g = np.zeros((program.entries, program.basis.shape[1]), dtype=complex)
    for bound, A in zip(program.bounds, Y, strict=True):
        p = len(bound.F)
        add_columns(g, bound.entries, bound.at, bound.gradient(2 * A[p:, :p]))
    return (g @ program.basis.T).real.ravel()


def complementarity(program, p):
    """sum <S, Y> + sum (limit - t) eta."""
    total = (p.limits[0] - p.t) @ p.eta
    for (diagonal, b, G), Y in zip(p.S(program), p.Y, strict=True):
        rows = len(G)
        of_Y = np.einsum("iin->in", Y).real
        total += (diagonal * of_Y[:rows]).sum() + (b * of_Y[rows:]).sum()
        total += 2 * np.einsum("ijn,jin->", G, Y[rows:, :rows]).real
    return total


def dual_value(program, p):
    """The dual objective, a lower bound on the primal one if Y and eta are stationary."""
    nothing = {"t": 0 * p.t, "d": [0 * d for d in p.d], "G": [bound.F for bound in program.bounds]}
    linear = complementarity(program, replace(p, limits=program.limits, **nothing))
    return -linear


def begin(program, x):
    """A point at x with Y S = mu I, and with a bound moved out if x violates it."""
    G = program.matrices(x)
    splits = [bound.first_split(A) for bound, A in zip(program.bounds, G, strict=True)]
    values = [
        bound.value(A, split) for bound, A, split in zip(program.bounds, G, splits, strict=True)
    ]
    peaks = np.zeros(2)
    for bound, value in zip(program.bounds, values, strict=True):
        peaks[bound.limit] = max(peaks[bound.limit], value.max())
    limits = np.where(peaks < program.limits, program.limits, 1.5 * peaks)
    t = peaks[:1] if program.shared else values[0][program.free]
    t = (t + limits[0]) / 2
    levels = program.levels(t, limits)
    d = [b * split for b, split in zip(levels, splits, strict=True)]
    p = Point(x, t, limits, d, G, [], t)
    X = [Slack(G, diagonal, b).X for diagonal, b, G in p.S(program)]
    size = sum(trace(A)[program.has_t(j)].sum() for j, A in enumerate(X))
    mu = 5 * program.cost.sum() / size
    return replace(p, Y=[mu * A for A in X], eta=mu / (limits[0] - t))


def newton(program, p, slacks, total, way=WAYS[0]):
    """A function for the directions from p, in one of the WAYS."""
    root, looks = way
    s, toward = p.limits[0] - p.t, program.limits - p.limits
    solve = factorise(program, slacks, p.Y, p.eta / s, root)

    def change(d):
        """-Y dS X, Hermitian, of a direction."""
        changes = zip(slacks, p.Y, d.S(program), strict=True)
        return [-slack.sandwich(Y, *dS) for slack, Y, dS in changes]

    def residual(d):
        """The multipliers after a step d, and by how much they are not stationary."""
        Y = [A + D for A, D in zip(p.Y, d.Y, strict=True)]
        return Y, stationarity(program, Y)

    def correction(Y, rx, eta):
        """What makes multipliers stationary: changes of x, t, the splits, and of Y with them."""
        dx, dt, dd = solve(rx, Y, eta)
        dL = dx @ program.basis
        dG = [bound.response(dL) for bound in program.bounds]
        c = Point(dx, dt, 0 * toward, dd, dG, [], p.eta / s * dt)
        return replace(c, Y=change(c))

    def direction(mu, predictor=None):
        """The direction to Y S = mu I, to second order; None if rounding spoils it."""
        dY = [mu * a.X - B for a, B in zip(slacks, p.Y, strict=True)]
        deta = (mu - p.eta * toward[0]) / s - p.eta
        zeros = [0 * A for A in p.d], [0 * A for A in p.G]
        still = Point(0 * p.x, 0 * p.t, toward, *zeros, dY, deta)
        if toward.any():
            dY = [A + D for A, D in zip(dY, change(still), strict=True)]
        if predictor is not None:
            second = zip(dY, slacks, predictor.Y, predictor.S(program), strict=True)
            dY = [A - slack.sandwich(Y, *dS) for A, slack, Y, dS in second]
            deta = deta - predictor.eta * (predictor.limits[0] - predictor.t) / s
        d = replace(still, Y=dY, eta=deta)
        d = d.moved(correction(*residual(d), p.eta + d.eta), 1, 1)
        if predictor is None:
            return d
        done = []  # what rounding has left is removed by conjugate residuals [5]
        for _ in range(looks):
            Y, left = residual(d)
            if np.linalg.norm(left) * np.linalg.norm(p.x) <= STATIONARY * total:
                return d
            c = correction(Y, left, p.eta + d.eta)
            effect = -stationarity(program, c.Y)
            for before, known in done:
                share = known @ effect / (known @ known)
                c, effect = c.moved(before, -share, -share), effect - share * known
            share = effect @ left / (effect @ effect)
            d = d.moved(c, share, share)
            done.append((c, effect))
        return d if root else None

    return direction


def degree(p):
    """The number that complementarity is mu times, on the central path."""
    return len(p.t) + sum(Y.shape[0] * Y.shape[2] for Y in p.Y)


def step(program, p, slacks, total, way):
    """The direction of Mehrotra's method from p; None if it is not accurate enough."""
    direction = newton(program, p, slacks, total, way)
    predictor = direction(0.0)
    primal, dual = step_lengths(program, p, predictor, slacks, 0.1)
    left = complementarity(program, p.moved(predictor, primal, dual)) / total
    sigma = min(1, max(left, 0)) ** (1 + 2 * min(primal, dual) ** 2)
    return direction(sigma * total / degree(p), predictor)


def follow(program, p, enough=0.0, is_good=None):
    """The best point on the central path, or None if no bounds were met, and the iterations."""
    n, m = program.basis.shape[1], p.G[0].shape[1]
    best, smallest, gaps, way = None, np.inf, [], 0
    steps = range(100)
    for iteration in tqdm(steps, "interior point", leave=False, delay=PATIENCE, disable=None):
        objective, dual = (program.cost * p.t).sum(), dual_value(program, p)
        total = complementarity(program, p)
        gap = max(total, abs(objective - dual))
        if (p.limits == program.limits).all():
            gaps.append(gap)
            if gap < smallest:
                best, smallest = p, gap
            closed = gap < GAP * max(objective, 1e-4 * program.idle)
            if closed or objective < enough or min(gaps[-8:]) > smallest:
                break
        else:  # by more than the first term, no filter that meets the bounds has a larger |x|
            x_max = np.sqrt(5 * n * m) * np.linalg.norm(stationarity(program, p.Y))
            if iteration > 40 or dual - x_max > program.cost.sum() * program.limits[0]:
                break
        slacks = [Slack(G, diagonal, b) for diagonal, b, G in p.S(program)]
        while (d := step(program, p, slacks, total, WAYS[way])) is None:
            # rounding ends the quick way: is more of a slower one needed?
            if best is p and is_good is not None and is_good(_solution(program, p, iteration)):
                return best, iteration
            way += 1
        primal, dual = step_lengths(program, p, d, slacks, 0.02)
        damping = 0.9 + 0.09 * min(primal, dual)
        primal, dual = (1.0 if a == 1 else damping * a for a in (primal, dual))
        if max(primal, dual) < 0.01:
            break
        p = p.moved(d, primal, dual)
        if primal == 1:
            p = replace(p, limits=program.limits)  # without rounding
    return best, iteration


def solve(
    program: Program,
    is_good: Callable[[Solution], bool] | None = None,  # asked where more digits are expensive
    enough: float = 0.0,  # below this objective a filter need not be optimal
) -> Solution:
    """Solve a program from nothing; Infeasible if M_max cannot be met."""
    zero = np.zeros((program.entries, len(program.R)))
    best, iterations = follow(program, begin(program, zero), enough, is_good)
    if best is None:  # phase one
        minimax = program.minimax()
        best, more = follow(minimax, begin(minimax, zero), enough=program.M_max)
        iterations += more
        if best.t[0] >= program.M_max:
            raise Infeasible(program.M_max, _solution(minimax, best, iterations))
        best, more = follow(program, begin(program, best.x), enough, is_good)
        iterations += more
    if best is None:
        raise RuntimeError(f"no filter met the bounds after {iterations} iterations")
    solution = _solution(program, best, iterations)
    if program.shared and best.t[0] > program.M_max:
        raise Infeasible(program.M_max, solution)
    return solution


def _solution(program, p, iterations):
    multipliers = [-2 * Y[: len(G), len(G) :] for G, Y in zip(p.G, p.Y, strict=True)]
    splits = [d / b for d, b in zip(p.d, program.levels(p.t, p.limits), strict=True)]
    return program.solution(p.x, multipliers, splits, "interior point", iterations)
