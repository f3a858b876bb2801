"""Synthesis of ILC learning filters by a structured primal-dual interior-point method.

The problem, (39) or (45) with (46) of the paper: given P_i (m x m) and Q_i (scalar) at the
frequencies omega_i, find the real coefficients C_k of L(z) = sum_k C_k z^k that minimise the sum
over a band, or the largest, of sigma_max(M_i), M_i = Q_i (I - P_i L_i), while
sigma_max(M_i) <= M_max and sigma_max(L_i) <= L_max at all frequencies. With one epigraph variable
t per frequency in the band (or a single one for the largest) every constraint reads

    S = [[b I, G], [G^H, b I]] >= 0,    G = F + T L_i,    b = t, M_max or L_max,

a semidefinite programme with n small blocks and few variables. The multiplier of S is Y >= 0.

Method. The central path Y S = mu I is followed with the HKM direction [1, 2] and Mehrotra's
predictor-corrector [3], in the form of Todd, Toh and Tutuncu [4]. What is particular here:

- The variables t and all blocks are eliminated. What is left is one symmetric system in the
  coefficients; since each L_i depends on them through the same numbers z_i^k, its matrix is a sum
  over i of m^2 x m^2 matrices times products of the rows of the basis (`normal_matrix`).
- The basis z^k is whitened by a QR factorisation, weighted with what the constraints see of L_i.
- b and G always belong to an existing x, so the slacks are exact. Bounds that the start violates
  are relaxed, and are moved to their places with the primal steps; phase one is needed only when
  that fails, and then it is the problem of the smallest M_max [5].
- All arrays have the frequency last. An operation on n small matrices is then a few operations on
  long vectors, faster in NumPy than calling LAPACK n times.

`dual_bound` turns the multipliers into a lower bound by Fenchel duality alone. It shares no code
with the method, so that value and bound together prove what was reached.

[1] C. Helmberg, F. Rendl, R. Vanderbei, H. Wolkowicz, SIAM J. Optim. 6 (1996) 342-361.
[2] M. Kojima, S. Shindoh, S. Hara, SIAM J. Optim. 7 (1997) 86-125;
    R. Monteiro, SIAM J. Optim. 7 (1997) 663-678.
[3] S. Mehrotra, SIAM J. Optim. 2 (1992) 575-601.
[4] M. Todd, K. Toh, R. Tutuncu, SIAM J. Optim. 8 (1998) 769-796. The NT direction is due to
    Yu. Nesterov, M. Todd, Math. Oper. Res. 22 (1997) 1-42.
[5] L. Vandenberghe, S. Boyd, SIAM Review 38 (1996) 49-95.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

GAP = 2e-9  # relative duality gap at which to stop
ACCEPTED = 1e-8  # relative duality gap above which there is no solution to return
VERBOSE = False
EPS = np.finfo(float).eps
PASSES = 2
FROM = 1e-6


class Infeasible(RuntimeError):
    """No filter of this order and structure meets M_max and L_max; carries the smallest M_max."""

    def __init__(self, M_max, smallest_M_max):
        super().__init__(
            f"M_max = {M_max:.10g} cannot be met, the smallest is {smallest_M_max:.10g}"
        )
        self.smallest_M_max = smallest_M_max


@dataclass(frozen=True)
class Cone:
    """The constraint sigma_max(F + T L) <= b at each frequency, L being a q x q part of the filter.

    `entries` of the filter stand at `rows`, `cols` of L; all else in L is zero.
    """

    F: np.ndarray
    T: np.ndarray
    entries: np.ndarray
    rows: np.ndarray
    cols: np.ndarray

    def response(self, L):
        """T L, from the frequency responses of all entries, shape (entries, n)."""
        D = np.zeros(self.T.shape, dtype=complex)
        D[self.rows, self.cols] = L[self.entries]
        return product(self.T, D)

    def gradient(self, W):
        """g such that Re tr(W T L) = Re sum_e g_e L_e."""
        return product(W, self.T)[self.cols, self.rows]


@dataclass(frozen=True)
class Problem:
    """The cones, that of M first; the basis Phi = R^-T z^k; which b of M are variables t."""

    cones: tuple[Cone, ...]
    Phi: np.ndarray
    R: np.ndarray
    entries: int
    free: np.ndarray
    shared: bool
    bounds: np.ndarray

    def levels(self, t, bounds):
        """b of each cone, from the variables t and the bounds on M and L."""
        n = self.Phi.shape[1]
        b = [np.full(n, bounds[0])] + [np.full(n, bounds[1])] * (len(self.cones) - 1)
        b[0][self.free] = t
        return b

    def over_levels(self, v):
        """Sum, last axis, over the frequencies that share a variable t."""
        return v.sum(axis=-1, keepdims=True) if self.shared else v

    def stationarity(self, Y):
        """The derivative of sum <Y, S> with respect to x."""
        g = np.zeros((self.entries, self.Phi.shape[1]), dtype=complex)
        for cone, A in zip(self.cones, Y, strict=True):
            q = len(cone.T)
            g[cone.entries] += cone.gradient(2 * A[q:, :q])
        return (g @ self.Phi.T).real.ravel()


@dataclass(frozen=True)
class Point:
    """An iterate, or a direction: coefficients, epigraph variables, bounds, G, Y, eta.

    eta are the multipliers of t <= M_max.
    """

    x: np.ndarray
    t: np.ndarray
    bounds: np.ndarray
    G: list
    Y: list
    eta: np.ndarray

    def moved(self, d, primal, dual):
        """The point after a step in direction d."""
        return Point(
            self.x + primal * d.x,
            self.t + primal * d.t,
            self.bounds + primal * d.bounds,
            [A + primal * D for A, D in zip(self.G, d.G, strict=True)],
            [A + dual * D for A, D in zip(self.Y, d.Y, strict=True)],
            self.eta + dual * d.eta,
        )


@dataclass(frozen=True)
class Solution:
    coefficients: np.ndarray
    value: float
    lower_bound: float
    iterations: int
    U: np.ndarray
    V: np.ndarray | None
    state: tuple[Problem, Point]


# Small matrices, frequency last


def product(A, B):
    """A B for each frequency."""
    if A.shape[0] * B.shape[1] > 36:  # here BLAS is faster, one call per frequency or not
        return np.matmul(A, B, axes=[(0, 1)] * 3)
    C = A[:, 0, None] * B[0]
    for j in range(1, len(B)):
        C += A[:, j, None] * B[j]
    return C


def adjoint(A):
    return A.conj().swapaxes(0, 1)


def hermitian(A):
    return 0.5 * (A + adjoint(A))


def trace(A):
    return np.einsum("iin->n", A).real


def inverse(A):
    """Inverse of Hermitian positive definite matrices, exactly Hermitian.

    Gaussian elimination turns [A, I] into [R^H, R^-1], where A = R R^H.
    """
    q = len(A)
    floor = 0.01 * EPS * np.abs(trace(A))
    A = np.concatenate([A, np.zeros_like(A)], axis=1)
    A[range(q), range(q, 2 * q)] = 1
    for k in range(q):
        A[k] *= 1 / np.sqrt(np.maximum(A[k, k].real, floor))
        A[k + 1 :] -= A[k, k + 1 : q, None].conj() * A[k]
    return product(adjoint(A[:, q:]), A[:, q:])


def positive_definite(A):
    """Which Hermitian matrices are positive definite. Overwrites them."""
    positive = np.ones(A.shape[-1], dtype=bool)
    for k in range(len(A)):
        pivot = A[k, k].real
        positive &= pivot > 0
        column = A[k + 1 :, k]
        row = column.conj() * (1 / np.where(positive, pivot, 1))
        A[k + 1 :, k + 1 :] -= column[:, None] * row
    return positive


def largest_step(A, accuracy):
    """Largest step <= 1 for which A[0] + step A[1] + step^2 A[2] ... are positive definite.

    Bisection. Each round looks only at the frequencies that failed at the last step that failed.
    """
    low, high, step = 0.0, 1.0, 1.0
    while high - low > accuracy * high and high > 1e-9:
        value = A[-1] * step
        for term in A[-2:0:-1]:
            value += term
            value *= step
        failing = ~positive_definite(value + A[0])
        if failing.any():
            high = step
            A = [term[..., failing] for term in A]
        else:
            low = step
        step = (low + high) / 2
    return low


class Slack:
    """S = [[b I, G], [G^H, b I]] of a cone, and the blocks of its inverse X."""

    def __init__(self, G, b):
        diagonal = np.diag_indices(len(G))
        self.G, self.b = G, b
        self.A = -product(adjoint(G), G)
        self.A[diagonal] += b**2
        self.M = inverse(self.A)  # (b^2 I - G^H G)^-1
        self.X22 = b * self.M
        self.X21 = -product(self.M, adjoint(G))
        self.X11 = -product(G, self.X21) * (1 / b)
        self.X11[diagonal] += 1 / b

    @property
    def X(self):
        upper = np.concatenate([self.X11, adjoint(self.X21)], axis=1)
        return np.concatenate([upper, np.concatenate([self.X21, self.X22], axis=1)])

    def between(self, Y, d, D):
        """The Hermitian part of Y dS X, dS = [[d I, D], [D^H, d I]].

        Near the solution X is large, and dS small in the directions that matter. Multiplying by
        b D - d G and d b I - D^H G first, where these cancel, leaves rounding errors that do not
        spoil the small eigenvalues of Y. Multiplying dS by X first would.
        """
        q = len(D)
        N = np.concatenate([self.b * D - d * self.G, -product(adjoint(D), self.G)])
        N[range(q, 2 * q), range(q)] += self.b * d
        right = product(product(Y, N), self.M)
        left = d * Y[:, :q] + product(Y[:, q:], adjoint(D)) - product(right, adjoint(self.G))
        return hermitian(np.concatenate([left * (1 / self.b), right], axis=1))

    def polynomial(self, d, D):
        """Coefficients of (b + a d)^2 I - (G + a D)^H (G + a D) in a."""
        diagonal = np.diag_indices(len(D))
        GD = product(adjoint(self.G), D)
        A1, A2 = -GD - adjoint(GD), -product(adjoint(D), D)
        A1[diagonal] += 2 * self.b * d
        A2[diagonal] += d**2
        return [self.A, A1, A2]


# The method


def whitened_basis(P, Q, omega, Ts, order, L_max):
    """Phi = R^-T [z; z^2; ...], with columns orthonormal after weighting with what M and L see."""
    z = np.exp(1j * omega * Ts) ** np.arange(1, order + 1)[:, None]
    weight = np.linalg.norm(Q[:, None, None] * P, axis=(1, 2)) / np.abs(Q).max()
    weight = np.hypot(weight, 0 if L_max is None else 1 / L_max)
    weight = np.maximum(weight, 1e-8 * weight.max())
    R = np.linalg.qr((weight * z).view(float).T, mode="r")
    return np.ascontiguousarray(solve_triangular(R, z, trans="T")), R


def formulate(P, Q, omega, Ts, order, M_bound, L_max, free, shared, structure):
    """The problem in the form of `Problem`."""
    n, m, _ = P.shape
    rows, cols = np.indices((m, m)).reshape(2, -1) if structure == "full" else 2 * (np.arange(m),)
    every, one = np.arange(len(rows)), np.zeros(1, dtype=int)

    def identity(q):
        return np.repeat(np.eye(q, dtype=complex)[..., None], n, axis=2)

    T = np.ascontiguousarray(-Q * P.transpose(1, 2, 0))
    cones = [Cone(Q * identity(m), T, every, rows, cols)]
    if L_max is not None and structure == "full":
        cones.append(Cone(0 * identity(m), identity(m), every, rows, cols))
    elif L_max is not None:
        cones.extend(Cone(0 * identity(1), identity(1), every[[e]], one, one) for e in every)

    Phi, R = whitened_basis(P, Q, omega, Ts, order, L_max)
    bounds = np.array([M_bound, 1.0 if L_max is None else L_max])
    return Problem(tuple(cones), Phi, R, len(rows), free, shared, bounds)


def begin(problem, x):
    """A point on no path yet, but with Y S = mu I; bounds are relaxed as far as x requires."""
    L = x @ problem.Phi
    G = [cone.F + cone.response(L) for cone in problem.cones]
    sigma = np.linalg.norm(G[0], 2, axis=(0, 1))
    bounds = problem.bounds.copy()
    if bounds[0] <= sigma.max():
        bounds[0] = 1.5 * sigma.max()
    t = np.array([sigma.max()]) if problem.shared else sigma[problem.free]
    t = (t + bounds[0]) / 2
    b = problem.levels(t, bounds)
    X = [Slack(*a).X for a in zip(G, b, strict=True)]
    mu = 5 * len(t) / trace(X[0])[problem.free].sum()
    return Point(x, t, bounds, G, [mu * A for A in X], mu / (bounds[0] - t))


def normal_matrix(problem, slacks, Y):
    """sum_i tr(dS_j Y dS_k X) for all pairs of coefficients j, k, before t is eliminated.

    With D the off-diagonal block of dS this is, per frequency, the real part of
    tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)): a Hermitian form A and a
    symmetric form B in the entries of L.
    """
    Phi, E = problem.Phi, problem.entries
    order, n = Phi.shape
    basis = Phi.view(float)
    parts = []
    for cone, s, y in zip(problem.cones, slacks, Y, strict=True):
        q, TH = len(cone.T), adjoint(cone.T)
        parts.append(
            [product(TH, product(A, cone.T)) for A in (s.X11, y[:q, :q])]
            + [product(A, cone.T) for A in (s.X21, y[q:, :q])]
            + [s.X22, y[q:, q:]]
        )
    H = np.empty((E, order, E, order))
    for e in range(E):
        A, B = np.zeros((2, E - e, n), dtype=complex)
        for cone, (X11, Y11, X21, Y21, X22, Y22) in zip(problem.cones, parts, strict=True):
            for j in np.flatnonzero(cone.entries == e):
                r, c = cone.rows[j], cone.cols[j]
                rs, cs, es = cone.rows[j:], cone.cols[j:], cone.entries[j:] - e
                A[es] += Y11[r, rs] * X22[cs, c] + X11[r, rs] * Y22[cs, c]
                B[es] += Y21[c, rs] * X21[cs, r] + X21[c, rs] * Y21[cs, r]
        V = A[:, None] * Phi + (B[:, None] * Phi).conj()
        H[e:, :, e] = (V.view(float).reshape(-1, 2 * n) @ basis.T).reshape(E - e, order, order)
        H[e, :, e:] = H[e:, :, e].transpose(2, 0, 1)
    return H.reshape(E * order, -1)


def newton(problem, p, slacks):
    """Factorise the Newton system at p; return the function that solves it."""
    M, free, m = problem.cones[0], problem.free, len(problem.cones[0].T)
    X11, X21, X22 = slacks[0].X11, slacks[0].X21, slacks[0].X22
    Y11, Y21, Y22 = p.Y[0][:m, :m], p.Y[0][m:, :m], p.Y[0][m:, m:]
    s = p.bounds[0] - p.t
    toward = problem.bounds - p.bounds
    # t: Re tr(Y X) for its own curvature, the off-diagonal block of Y X + X Y for the mixed one
    h = (Y11 * X11.conj() + Y22 * X22.conj() + 2 * Y21 * X21.conj()).real.sum(axis=(0, 1))
    h = problem.over_levels(h[free]) + p.eta / s
    W = product(Y21, X11) + product(Y22, X21) + product(X21, Y11) + product(X22, Y21)
    mixed = M.gradient(W)[:, None, free] * problem.Phi[:, free]
    mixed = problem.over_levels(mixed.real.reshape(-1, len(free)))
    H = normal_matrix(problem, slacks, p.Y)
    scale = 1 / np.sqrt(np.diag(H))
    H = scale[:, None] * (H - (mixed / h) @ mixed.T) * scale
    for shift in 10.0 ** np.arange(-15, -1):
        try:
            factor = cho_factor(H + shift * np.eye(len(H)), lower=True)
            break
        except np.linalg.LinAlgError:
            continue
    else:
        return None
    X = [slack.X for slack in slacks]

    def direction(target, second_order, passes=1):
        """The direction to Y S = target I, less the second-order terms C of the predictor."""
        C, c = second_order
        dY = [target * A - B - D for A, B, D in zip(X, p.Y, C, strict=True)]
        deta = (target - c - p.eta * toward[0]) / s - p.eta
        if toward.any():
            moving = problem.levels(0.0, toward)
            dY = [
                A - slack.between(B, d, 0 * slack.G)
                for A, slack, B, d in zip(dY, slacks, p.Y, moving, strict=True)
            ]
        d = Point(0 * p.x, 0 * p.t, toward, [0 * A for A in p.G], dY, deta)
        for k in range(passes):
            Y = [A + D for A, D in zip(p.Y, d.Y, strict=True)]
            rho = problem.over_levels(trace(Y[0])[free]) - (p.eta + d.eta) - 1
            dx = problem.stationarity(Y)
            if VERBOSE and k:
                print(f"[{abs(dx).max():.0e} {abs(rho).max():.0e}]", end=" ")
            dx = dx - mixed @ (rho / h)
            dx = scale * cho_solve(factor, scale * dx)
            dt = (rho - dx @ mixed) / h
            dx = dx.reshape(p.x.shape)
            dL = dx @ problem.Phi
            dG = [cone.response(dL) for cone in problem.cones]
            db = problem.levels(dt, 0 * toward)
            dY = [-slack.between(B, *e) for slack, B, *e in zip(slacks, p.Y, db, dG, strict=True)]
            d = d.moved(Point(dx, dt, 0 * toward, dG, dY, p.eta / s * dt), 1, 1)
        return d

    return direction


def complementarity(problem, p):
    """sum <S, Y> + sum s eta: the duality gap when bounds and stationarity hold."""
    gap = (p.bounds[0] - p.t) @ p.eta
    for b, G, Y in zip(problem.levels(p.t, p.bounds), p.G, p.Y, strict=True):
        gap += b @ trace(Y) + 2 * np.einsum("ijn,jin->", G, Y[len(G) :, : len(G)]).real
    return gap


def step_lengths(problem, p, slacks, d, accuracy):
    """Largest primal and dual steps <= 1."""

    def ratio(v, dv):
        return 1 / max(1, (-dv / v).max())

    primal = [ratio(p.bounds[0] - p.t, d.bounds[0] - d.t)]
    dual = [ratio(p.eta, d.eta)]
    for slack, db, dG, Y, dY in zip(
        slacks, problem.levels(d.t, d.bounds), d.G, p.Y, d.Y, strict=True
    ):
        primal += [ratio(slack.b, db), largest_step(slack.polynomial(db, dG), accuracy)]
        dual.append(largest_step([Y, dY], accuracy))
    return min(primal), min(dual)


def follow(problem, p, enough=0.0, limit=100):
    """Follow the central path from p.

    Parameters
    ----------
    problem : Problem
    p : Point
    enough : float
        Stop as soon as the objective is below.
    limit : int
        Largest number of iterations.

    Returns
    -------
    best : Point or None
        The point with the smallest gap; None if no point met the bounds.
    warm : Point or None
        An early point on the path that met the bounds.
    iterations : int
    """
    degree = len(p.t) + 2 * sum(len(c.T) for c in problem.cones) * problem.Phi.shape[1]
    floor = 1e-9 * len(p.t) * np.abs(problem.cones[0].F).max()
    best, best_gap, warm, gaps = None, np.inf, [], []
    for iteration in range(limit):
        slacks = [Slack(*a) for a in zip(p.G, problem.levels(p.t, p.bounds), strict=True)]
        gap = complementarity(problem, p)
        objective = p.t.sum()
        feasible = bool((p.bounds == problem.bounds).all())
        relative = max(gap, abs(objective - dual_objective(problem, p))) / max(objective, floor)
        if VERBOSE:
            rx = abs(problem.stationarity(p.Y)).max()
            print(
                f"{iteration:3d} {p.t.sum():.12g} comp {gap / objective:.2e} gap {relative:.2e} bounds {abs(problem.bounds - p.bounds).max():.1e} rx {rx:.1e}",
                end=" ",
            )
        if feasible:
            gaps.append(relative)
            if relative < best_gap:
                best, best_gap = p, relative
            if 1e-5 < relative < DROP ** -(1 + len(warm)):
                warm.append(p)
            if relative <= GAP or objective < enough or best_gap < min(gaps[-6:]):
                break
        elif iteration > 40 or (
            dual_objective(problem, p) > 1.01 * len(p.t) * problem.bounds[0]
            and abs(problem.stationarity(p.Y)).max() < 1e-6
        ):
            if VERBOSE:
                print("certificate")
            break
        direction = newton(problem, p, slacks)
        if direction is None:
            break
        d = direction(0.0, ([0.0] * len(p.Y), 0.0))
        primal, dual = step_lengths(problem, p, slacks, d, 0.1)
        left = max(complementarity(problem, p.moved(d, primal, dual)) / gap, 0)
        sigma = min(1, left) ** (1 + 2 * min(primal, dual) ** 2)
        db = problem.levels(d.t, d.bounds)
        C = [slack.between(*a) for slack, *a in zip(slacks, d.Y, db, d.G, strict=True)]
        d = direction(
            sigma * gap / degree, (C, d.eta * (d.bounds[0] - d.t)), PASSES if relative < FROM else 1
        )
        damping = 0.9 + 0.09 * min(primal, dual)
        steps = step_lengths(problem, p, slacks, d, 0.02)
        primal, dual = (1.0 if a == 1 else damping * a for a in steps)
        if VERBOSE:
            print(f"sigma {sigma:.1e} {primal:.3f} {dual:.3f}")
        if max(primal, dual) < 1e-2:
            break
        p = p.moved(d, primal, dual)
        if primal == 1:
            p = replace(p, bounds=problem.bounds)
    return best, warm, iteration


def dual_objective(problem, p):
    """The objective of the dual problem, a lower bound when stationarity holds."""
    value = -problem.bounds[0] * p.eta.sum()
    for b, cone, Y in zip(problem.levels(0.0, problem.bounds), problem.cones, p.Y, strict=True):
        q = len(cone.T)
        value -= b @ trace(Y) + 2 * np.einsum("ijn,jin->", cone.F, Y[q:, :q]).real
    return value


def multipliers(problem, p, m):
    """U of the constraints on M and V of those on L, both (n, m, m)."""
    U, *V = (-2 * A[: len(A) // 2, len(A) // 2 :].transpose(2, 0, 1) for A in p.Y)
    if len(V) == m:  # a diagonal filter, one cone for each entry
        V = [np.concatenate(V, axis=1) * np.eye(m)]
    return U, V[0] if V else None


def dual_bound(P, Q, omega, Ts, U, V, *, order, M_max, L_max, band_mask, structure, objective):
    """Lower bound on the optimum, from multipliers and linear algebra alone.

    For all filters that meet the constraints, and all U_i, V_i with
    sum_i Re tr(U_i^H dM_i) + Re tr(V_i^H dL_i) = 0 for all changes of the coefficients,

        sum_i Re tr(U_i^H Q_i) = sum_i Re tr(U_i^H M_i) + Re tr(V_i^H L_i)
                               <= sum_i |U_i| sigma_max(M_i) + L_max sum_i |V_i|,

    with nuclear norms. What |U_i| exceeds the weight of sigma_max(M_i) in the objective by is
    bounded with M_max. U and V are first projected on those that satisfy the condition, so that the
    bound holds, up to rounding, whatever was passed.
    """
    n, m, _ = P.shape
    basis, _ = whitened_basis(P, Q, omega, Ts, order, L_max)
    scale = 1.0 if V is None else L_max
    N = np.concatenate([U, np.zeros_like(U) if V is None else scale * V], axis=1)
    I = np.broadcast_to(np.eye(m) * (V is not None) / scale, P.shape)
    D = np.concatenate([-Q[:, None, None] * P, I], axis=1)
    for c in [np.arange(m)] if structure == "full" else np.arange(m)[:, None]:
        B = (D[:, :, c, None] * basis.T[:, None, None]).reshape(2 * n * m, -1)
        A = N[:, :, c].reshape(2 * n * m, -1)
        B, A = (np.concatenate([C.real, C.imag]) for C in (B, A))
        B = np.linalg.qr(B)[0]
        A -= B @ (B.T @ A)
        N[:, :, c] = (A[: 2 * n * m] + 1j * A[2 * n * m :]).reshape(n, 2 * m, -1)
    weight, excess = np.linalg.svd(N.reshape(n, 2, m, m), compute_uv=False).sum(axis=-1).T
    bound = (np.trace(N[:, :m].conj(), axis1=1, axis2=2) * Q).real.sum() - excess.sum()
    if objective == "peak":
        return bound / weight.sum()
    return bound - M_max * np.maximum(weight - band_mask, 0).sum()


WARM = 1e-3


BAL = 0.3
DROP = 4.0


def resume(problem, before, points):
    choice = None
    for p in points:
        q = adapted(problem, before, p)
        gap = complementarity(problem, q)
        if VERBOSE:
            print("candidate", gap, q.t.sum() - dual_objective(problem, q))
        if choice is None or gap > BAL * abs(q.t.sum() - dual_objective(problem, q)):
            choice = q
    return choice


def adapted(problem, before, p):
    x = (problem.R @ solve_triangular(before.R, p.x.T)).T
    L = x @ problem.Phi
    G = [cone.F + cone.response(L) for cone in problem.cones]
    t, eta, Y, free = p.t, p.eta, p.Y, problem.free
    if not problem.shared:
        n = problem.Phi.shape[1]
        t, eta = before.levels(p.t, p.bounds)[0], np.zeros(n)
        eta[before.free] = p.eta
        changed = np.setxor1d(free, before.free)
        sigma = np.linalg.norm(G[0][..., changed], 2, axis=(0, 1))
        mu = np.mean((p.bounds[0] - p.t) * p.eta)
        t[changed] = sigma + 1 / (1 / mu + 2 / (p.bounds[0] - sigma))
        eta[changed] = mu / (p.bounds[0] - t[changed])
        t, eta = t[free], eta[free]
        b = problem.levels(t, p.bounds)[0]
        Y = [p.Y[0].copy(), *p.Y[1:]]
        Y[0][..., changed] = mu * Slack(G[0][..., changed], b[changed]).X
    return Point(x, t, p.bounds, G, Y, eta)


def solve(P, Q, omega, Ts, *, order, M_max, L_max, band_mask, structure, objective, start=None):
    n, m, _ = P.shape
    q = np.abs(Q).max()
    settings = dict(order=order, M_max=M_max, L_max=L_max, band_mask=band_mask, structure=structure)
    problem = peak = formulate(P, Q, omega, Ts, order, 3 * q, L_max, np.arange(n), True, structure)
    if objective == "sum":
        problem = replace(
            peak,
            free=np.flatnonzero(band_mask),
            shared=False,
            bounds=np.array([M_max, peak.bounds[1]]),
        )
    zero = np.zeros((peak.entries, order))
    p = None
    iterations = 0
    if start is not None:
        p, warm, iterations = follow(problem, resume(problem, *start.state))
    if p is None:
        p, warm, more = follow(problem, begin(problem, zero))
        iterations += more
    if p is None:
        if VERBOSE:
            print("phase one")
        p, warm, more = follow(peak, begin(peak, zero), enough=M_max)
        iterations += more
        value = evaluate(P, Q, omega, Ts, coefficients(peak, p, m), np.ones(n, bool), "peak")
        if value >= M_max:
            raise Infeasible(M_max, value)
        p, warm, more = follow(problem, begin(problem, p.x))
        iterations += more
    C = coefficients(problem, p, m)
    value = evaluate(P, Q, omega, Ts, C, band_mask, objective)
    U, V = multipliers(problem, p, m)
    bound = dual_bound(P, Q, omega, Ts, U, V, objective=objective, **settings)
    if objective == "peak" and value > M_max:
        raise Infeasible(M_max, value)
    return Solution(C, value, bound, iterations, U, V, (problem, warm or [p]))


def coefficients(problem, p, m):
    C = np.zeros((m, m, p.x.shape[1]))
    C[problem.cones[0].rows, problem.cones[0].cols] = solve_triangular(problem.R, p.x.T).T
    return C


def evaluate(P, Q, omega, Ts, C, band_mask, objective):
    z = np.exp(1j * omega * Ts)[:, None] ** np.arange(1, C.shape[2] + 1)
    L = np.moveaxis(C @ z.T, 2, 0)
    sigma = np.linalg.norm(Q[:, None, None] * (np.eye(len(C)) - P @ L), 2, axis=(1, 2))
    return sigma.max() if objective == "peak" else sigma[band_mask].sum()
