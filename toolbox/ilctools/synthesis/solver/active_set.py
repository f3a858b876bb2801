"""From near an optimum to it: sequential quadratic programming along the active bounds.

There the largest singular value at each frequency is a single one, hence a smooth function of the
coefficients, and of the thousands of bounds about a dozen are active: Newton's method takes a few
steps. Each solves the quadratic program of the second derivatives of the Lagrangian
(`bounds`) and the linearised bounds [1], and so finds the active ones
anew. A step that does not improve the objective plus a penalty for violated bounds is corrected to
second order [1, 18.3]; if that does not help, it is damped, and asked to remove only a part of the
violation.

What this method cannot do, and an interior-point method can, is to start from nothing, to meet
points where singular values coincide, and to show that a problem is infeasible.

[1] J. Nocedal, S. Wright, Numerical Optimization, 2006, chapter 18.
"""

from dataclasses import dataclass

import numpy as np

from ilctools.problem.problem import Solution, largest_singular_values
from ilctools.synthesis.solver.program import Program

try:
    import daqp
except ImportError:  # which not every platform has, as in a browser
    daqp = None
try:
    import piqp
except ImportError:
    piqp = None

NEAR = 0.97  # part of a limit from which on it is in the quadratic program
FLAT = 1e-7  # least curvature of the quadratic program, relative to the mean
HUGE = 1e100  # what no step and no multiplier is
STATIONARY, WITHIN = 1e-8, 1e-10  # of its solution: what a solver must reach
NOISE = 1e-11  # relative change of the objective that is rounding
MOST_DAMPING = 1e4  # at which to give up
CONVERGED = 1e-9  # expected relative gain below which a full step is the last one


class Iterate:
    """A filter, its G and sigma_max of each bound, the objective, the excess over the limits."""

    def __init__(self, program, x, splits=None):
        self.x, self.G, self.splits, self.sigma = x, program.matrices(x), [], []
        level = program.limits[0]
        if program.shared:  # at least the largest M without the radius
            minimised = zip(program.bounds, self.G, strict=True)
            M = [G[: bound.shape[1]] for bound, G in minimised if bound.limit == 0]
            M = np.moveaxis(np.concatenate(M, axis=-1), -1, 0)
            level = largest_singular_values(M).max()
        for j, (bound, G) in enumerate(zip(program.bounds, self.G, strict=True)):
            split = bound.first_split(G) if splits is None else splits[j]
            split, sigma = bound.tighten(G, split, NEAR * level)
            self.splits.append(split)
            self.sigma.append(sigma)
        if program.shared:
            minimised = zip(program.bounds, self.sigma, strict=True)
            self.objective = max(s.max() for bound, s in minimised if bound.limit == 0)
        else:
            self.objective = (program.cost * self.sigma[0][program.free]).sum()
        limits = (self.objective if program.shared else program.limits[0], program.limits[1])
        self.limits = [limits[bound.limit] for bound in program.bounds]
        relative = [s.max() / b - 1 for s, b in zip(self.sigma, self.limits, strict=True)]
        self.excess = np.maximum(relative, 0)


@dataclass(frozen=True)
class Model:
    """What a step d = (dx, dt) adds to the objective, f d + dx H dx / 2, within A d <= room."""

    H: np.ndarray
    f: np.ndarray
    A: np.ndarray
    room: np.ndarray
    near: list  # columns of each bound that A and room are about
    unit: float  # of the objective


def model_at(program, p, multipliers):
    """The model at an iterate, with multipliers of the limits."""
    K, unit = p.x.size, max(p.objective, 1e-6 * program.idle)
    H, f = np.zeros((K, K)), np.append(np.zeros(K), 1 / unit if program.shared else 0.0)
    A, room, near = [], [], []
    for j, (bound, y, limit) in enumerate(zip(program.bounds, multipliers, p.limits, strict=True)):
        close = (p.sigma[j] > NEAR * limit) | (y > 0)
        weight = y + in_sum(program) if j == 0 else y
        at = np.flatnonzero(close | (weight > 0))
        e = bound.expand(p.G[j], p.splits[j], at, program.basis, program.entries)
        rows = (e.curvature * np.sqrt(weight[e.at] / unit)[:, None, None]).reshape(-1, K)
        H += rows.T @ rows
        if j == 0:
            f[:K] = in_sum(program)[e.at] @ e.gradient / unit
        close = close[e.at]
        dt = -1.0 if bound.limit == 0 and program.shared else 0.0
        A.append(np.insert(e.gradient[close], K, dt, axis=1) / limit)
        room.append(1 - e.value[close] / limit)
        near.append(e.at[close])
    return Model(H, f, np.vstack(A), np.concatenate(room), near, unit)


def in_sum(program):
    """The cost in the columns of the first bound that are in the sum, zero elsewhere."""
    weight = np.zeros(program.bounds[0].shape[2])
    if not program.shared:
        weight[program.free] = program.cost
    return weight


def quadratic_program(model, room, damping):
    """The step d that the model finds best, and the multipliers; None if A d <= room has none.

    Or if there is no solver for it: designs then end by the interior-point method alone.
    """
    K = len(model.H)
    H = np.zeros((K + 1, K + 1))
    H[:K, :K] = model.H + (FLAT + damping) * np.trace(model.H) / K * np.eye(K)
    H[K, K] = 1e-9 if model.f[K] else 1.0
    for package, solver in ((daqp, _by_active_set), (piqp, _by_interior_point)):
        if package is None:
            continue
        d, y = solver(H, model.f, model.A, room)
        if not np.abs(np.append(d, y)).max() < HUGE:  # NaN, if it gave up
            continue
        left = np.abs(H @ d + model.f + model.A.T @ y).max()
        if left < STATIONARY and (model.A @ d < room + WITHIN).all():
            return d, y
    return None


def _by_active_set(H, f, A, room):
    """Quick; what it gives is not the solution where bounds of neighbours are nearly parallel."""
    below, kind = np.full(len(room), -1e30), np.zeros(len(room), dtype=np.int32)
    d, _, flag, result = daqp.solve(H, f, A, room, below, kind, primal_tol=1e-11, dual_tol=1e-12)
    return d if flag == 1 else np.full_like(d, np.nan), np.maximum(result["lam"], 0)


def _by_interior_point(H, f, A, room):
    """Slower, and does not mind that."""
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 1e-12
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0
    solver.settings.max_iter = 30
    solver.setup(H, f, None, None, A, None, room)
    solver.solve()
    return np.array(solver.result.x), np.maximum(solver.result.z_u, 0)


def improve(program, p, model, penalty, damping, most=MOST_DAMPING):
    """The next iterate, if any, with its multipliers, penalty, expected gain and damping."""
    splits = np.cumsum([len(at) for at in model.near])[:-1]
    part = 1.0  # of the violation of the bounds that the step must remove
    while damping < most:
        room = np.where(model.room < 0, part * model.room, model.room)
        for attempt in ("first", "corrected"):
            found = quadratic_program(model, room, damping)
            if found is None:
                break
            d, y = found
            dx = d[:-1]
            if attempt == "first":
                penalty = np.maximum(penalty, [1.5 * z.sum() for z in np.split(y, splits)])
                expected = part * penalty @ p.excess - model.f @ d - dx @ model.H @ dx / 2
            new = Iterate(program, p.x + dx.reshape(p.x.shape), p.splits)
            gain = (p.objective - new.objective) / model.unit + penalty @ (p.excess - new.excess)
            if gain + NOISE > 0.1 * (expected + NOISE):
                if part == 1 and gain + NOISE > 0.75 * (expected + NOISE):
                    damping = 0.1 * damping if damping > 1e-4 else 0.0
                return new, np.split(y, splits), penalty, expected, damping
            reached = zip(new.sigma, model.near, p.limits, strict=True)
            reached = np.concatenate([s[at] / b - 1 for s, at, b in reached])
            room = room + (model.A @ d - model.room) - reached
        damping, part = max(10 * damping, 1e-4), part / 2
    return None


def resolve(
    program: Program, start: Solution, steps: int, most: float = MOST_DAMPING
) -> Solution | None:
    """Solve a program from the solution of a similar one, if few steps and little damping do."""
    p, y = (
        Iterate(program, program.unknowns(start.coefficients)),
        first_multipliers(program, start),
    )
    penalty, damping = np.zeros(len(y)), 0.0
    for iteration in range(1, steps + 1):
        model = model_at(program, p, y)
        step = improve(program, p, model, penalty, damping, most)
        if step is None:
            return None
        p, near, penalty, expected, damping = step
        y = [np.zeros_like(s) for s in p.sigma]
        for j, at in enumerate(model.near):
            y[j][at] = near[j] * model.unit / p.limits[j]
        if expected < CONVERGED and p.excess.max() < NOISE:
            multipliers = last_multipliers(program, p, y)
            return program.solution(p.x, multipliers, p.splits, "active set", iteration)
    return None


def first_multipliers(program, start):
    """Multipliers of the limits of each bound, from those of an earlier solution."""
    multipliers = []
    for j, bound in enumerate(program.bounds):
        if bound.plant is not None:
            y = of_cuts(bound, start)
        else:
            N = start.U[bound.at]
            if bound.gain:
                whole = len(bound.T) == start.V.shape[1]
                V = start.V if whole else start.V[:, bound.entries, bound.entries, None]
                N = np.linalg.solve(np.moveaxis(bound.T, -1, 0), V)
            y = np.linalg.norm(N, "nuc", axis=(1, 2))
        if j == 0:
            y = np.maximum(y - in_sum(program), 0)
        multipliers.append(np.where(y > 1e-6 * y.max(initial=0), y, 0))
    return multipliers


def of_cuts(bound, start):
    """Multipliers of the cuts that are those of an earlier solution, and zero for the others."""
    y, cuts = np.zeros(bound.shape[2]), start.cuts
    if cuts is None or cuts.N.shape[1] != len(bound.F):
        return y
    size = bound.dual(np.moveaxis(cuts.N, 0, -1), cuts.split.T)
    known = dict(zip(zip(cuts.plant, cuts.frequency, strict=True), size, strict=True))
    pairs = zip(bound.plant, bound.at, strict=True)
    return np.array([known.get(pair, 0.0) for pair in pairs])


def last_multipliers(program, p, y):
    """Multipliers of G from those of the limits, and those of the sum."""
    multipliers = []
    for j, (bound, G) in enumerate(zip(program.bounds, p.G, strict=True)):
        weight = y[j] + in_sum(program) if j == 0 else y[j]
        at = np.flatnonzero(weight)
        N = np.zeros_like(G)
        e = bound.expand(G, p.splits[j], at, program.basis, program.entries)
        N[..., at] = e.N * weight[at]
        multipliers.append(N)
    return multipliers
