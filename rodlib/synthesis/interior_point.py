"""The solver of the synthesis: a structured primal-dual interior-point method.

The program of :mod:`rodlib.synthesis.program` has bounds sigma_max(G_i) <= b at each frequency,
where b is a variable t (one for each frequency of the band, or a single one for the largest),
M_max or one. Each is a small linear matrix inequality with a multiplier Y:

    S = [[b I, G], [G^H, b I]] >= 0,    G = F + T L_i,    Y >= 0.

The method follows the central path Y S = mu I with the HKM direction [1] and Mehrotra's predictor
and corrector [2], as in SDPT3 [3]; see [4] for the theory. What is particular here:

- The variables t and all blocks are eliminated. What remains is one symmetric system in the
  coefficients, whose matrix is a sum over i of m^2 x m^2 matrices times products of powers of z_i.
- G is that of an actual filter throughout. If a bound is violated at the start, it is moved out,
  and moved back with the steps. Only if this fails is the smallest M_max computed ("phase one").

The method need not be trusted: :mod:`rodlib.evidence` proves what it returns.

[1] C. Helmberg, F. Rendl, R. Vanderbei, H. Wolkowicz, SIAM J. Optim. 6 (1996) 342; M. Kojima,
    S. Shindoh, S. Hara, ibid. 7 (1997) 86; R. Monteiro, ibid. 7 (1997) 663.
[2] S. Mehrotra, SIAM J. Optim. 2 (1992) 575.
[3] K. Toh, M. Todd, R. Tutuncu, Optim. Methods Softw. 11 (1999) 545; Math. Program. 95 (2003) 189.
[4] L. Vandenberghe, S. Boyd, SIAM Review 38 (1996) 49; M. Todd, Acta Numerica 10 (2001) 515.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rodlib.problem import Solution
from rodlib.synthesis.bounds import adjoint, product
from rodlib.synthesis.program import Infeasible, Program

GAP = 2e-9  # relative gap at which to stop
EPS = np.finfo(float).eps
STATIONARY = (
    1e-2  # part of the gap by which rounding may keep the multipliers from being stationary
)
REFINEMENTS = 2


@dataclass(frozen=True)
class Point:
    """An iterate, or a direction. The coefficients x refer to the basis, eta to t <= M_max."""

    x: np.ndarray
    t: np.ndarray
    limits: np.ndarray
    G: list
    Y: list
    eta: np.ndarray

    def moved(self, d, primal, dual):
        """The point after a step in the direction d."""
        return Point(
            self.x + primal * d.x,
            self.t + primal * d.t,
            self.limits + primal * d.limits,
            [A + primal * D for A, D in zip(self.G, d.G, strict=True)],
            [A + dual * D for A, D in zip(self.Y, d.Y, strict=True)],
            self.eta + dual * d.eta,
        )


class Slack:
    """S = [[b I, G], [G^H, b I]] at each frequency, and its inverse X."""

    def __init__(self, G, b):
        q = len(G)
        diagonal = np.diag_indices(q)
        self.G, self.b = G, b
        self.A = -product(adjoint(G), G)
        self.A[diagonal] += b**2
        _, inverse = cholesky(self.A, 0.01 * EPS * b**2)
        self.F = adjoint(inverse)
        self.M = product(self.F, inverse)  # (b^2 I - G^H G)^-1
        self.X = np.empty((2 * q, 2 * q, len(b)), dtype=complex)
        self.X[q:, q:] = b * self.M
        self.X[q:, :q] = -product(self.M, adjoint(G))
        self.X[:q, q:] = adjoint(self.X[q:, :q])
        self.X[:q, :q] = -product(G, self.X[q:, :q]) * (1 / b)
        self.X[diagonal] += 1 / b

    def sandwich(self, Y, d, D):
        """Hermitian part of Y dS X, where dS = [[d I, D], [D^H, d I]].

        Near the solution X is very large where dS nearly vanishes. The products b D - d G and
        d b I - D^H G take care of that cancellation first. Their rounding errors then leave the
        small eigenvalues of Y alone, and the steps long. Those of dS X would not.
        """
        q = len(D)
        N = np.concatenate([self.b * D - d * self.G, -product(adjoint(D), self.G)])
        N[range(q, 2 * q), range(q)] += self.b * d
        right = product(product(Y, N), self.M)
        left = d * Y[:, :q] + product(Y[:, q:], adjoint(D)) - product(right, adjoint(self.G))
        return hermitian(np.concatenate([left * (1 / self.b), right], axis=1))

    def along(self, d, D):
        """Coefficients of (b + a d)^2 I - (G + a D)^H (G + a D) as a polynomial in a."""
        diagonal = np.diag_indices(len(D))
        A1, A2 = -2 * hermitian(product(adjoint(self.G), D)), -product(adjoint(D), D)
        A1[diagonal] += 2 * self.b * d
        A2[diagonal] += d**2
        return [self.A, A1, A2]


def hermitian(A):
    return 0.5 * (A + adjoint(A))


def trace(A):
    return np.einsum("iin->n", A).real


def cholesky(A, floor):
    """R^H and R^-1 of Hermitian positive definite matrices A = R R^H, by Gaussian elimination.

    It turns [A, I] into [R^H, R^-1]. No pivot of A is smaller than the floor, unless by rounding.
    """
    q = len(A)
    A = np.concatenate([A, np.zeros_like(A)], axis=1)
    A[range(q), range(q, 2 * q)] = 1
    for k in range(q):
        A[k] *= 1 / np.sqrt(np.maximum(A[k, k].real, floor))
        A[k + 1 :] -= A[k, k + 1 : q, None].conj() * A[k]
    return A[:, :q], A[:, q:]


def positive_definite(A):
    """Which of the Hermitian matrices are positive definite. They are overwritten."""
    positive = np.ones(A.shape[-1], dtype=bool)
    for k in range(len(A)):
        pivot = A[k, k].real
        positive &= pivot > 0
        column = A[k + 1 :, k]
        row = column.conj() * (1 / np.where(positive, pivot, 1))
        A[k + 1 :, k + 1 :] -= column[:, None] * row
    return positive


def factorised(H):
    """Cholesky factor of a matrix with ones on the diagonal, shifted if it must be."""
    shift = 1e-15
    while True:
        try:
            return cho_factor(H + shift * np.eye(len(H)))
        except np.linalg.LinAlgError:
            shift *= 10


def longest_step(A, limit, accuracy):
    """The largest a <= limit with A[0] + a A[1] + a^2 A[2] ... positive definite, by bisection.

    Each round looks only at the frequencies that failed in the last round that failed.
    """
    low, high, a = 0.0, limit, limit
    while high - low > accuracy * high and high > 1e-9:
        value = A[-1] * a
        for term in A[-2:0:-1]:
            value += term
            value *= a
        value += A[0]
        failing = ~positive_definite(value)
        if failing.any():
            high = a
            A = [term[..., failing] for term in A]
        else:
            low = a
        a = (low + high) / 2
    return low


def step_lengths(program, p, d, slacks, accuracy):
    """The longest primal and dual steps <= 1 from p in the direction d."""
    db = program.levels(d.t, d.limits)
    primal = 1 / max(1, ((d.t - d.limits[0]) / (p.limits[0] - p.t)).max())
    dual = 1 / max(1, (-d.eta / p.eta).max())
    for slack, Y, dY, *e in zip(slacks, p.Y, d.Y, db, d.G, strict=True):
        primal = min(primal, 1 / max(1, (-e[0] / slack.b).max()))
        primal = longest_step(slack.along(*e), primal, accuracy)
        dual = longest_step([Y, dY], dual, accuracy)
    return primal, dual


def collect(program, v):
    """Sum over the frequencies that share a variable t; frequencies in the last axis."""
    v = v[..., program.free]
    return v.sum(axis=-1, keepdims=True) if program.shared else v


def stationarity(program, Y):
    """Derivative of sum <S, Y> with respect to the coefficients."""
    g = np.zeros((program.entries, program.basis.shape[1]), dtype=complex)
    for bound, A in zip(program.bounds, Y, strict=True):
        q = len(bound.T)
        g[bound.entries] += bound.gradient(2 * A[q:, :q])
    return (g @ program.basis.T).real.ravel()


def complementarity(program, p):
    """sum <S, Y> + sum (M_max - t) eta."""
    total = (p.limits[0] - p.t) @ p.eta
    for b, G, Y in zip(program.levels(p.t, p.limits), p.G, p.Y, strict=True):
        total += b @ trace(Y) + 2 * np.einsum("ijn,jin->", G, Y[len(G) :, : len(G)]).real
    return total


def dual_value(program, p):
    """The dual objective, a lower bound on the primal one if Y and eta are stationary."""
    zero = replace(p, t=0 * p.t, limits=program.limits, G=[bound.F for bound in program.bounds])
    return -complementarity(program, zero)


def begin(program, x):
    """A point at x with Y S = mu I, and with a bound moved out if x violates it."""
    G = program.matrices(x)
    sigma, *others = (np.linalg.norm(A, 2, axis=(0, 1)) for A in G)
    peaks = np.array([sigma.max(), np.max(others)])
    limits = np.where(peaks < program.limits, program.limits, 1.5 * peaks)
    t = (sigma[program.free] + limits[0]) / 2
    t = t.max(keepdims=True) if program.shared else t
    X = [Slack(*a).X for a in zip(G, program.levels(t, limits), strict=True)]
    mu = 5 * len(t) / collect(program, trace(X[0])).sum()
    return Point(x, t, limits, G, [mu * A for A in X], mu / (limits[0] - t))


def normal_matrix(program, slacks, Y):
    """sum <dS_j, Y dS_k X> for all pairs of coefficients.

    In terms of D, the off-diagonal block of dS, this is the real part of
    tr(D^H (Y11 D' X22 + X11 D' Y22)) + tr(D (Y21 D' X21 + X21 D' Y21)), that is, a Hermitian form A
    and a symmetric form B in the entries of L at each frequency.
    """
    basis, E = program.basis, program.entries
    order, n = basis.shape
    blocks = []
    for bound, slack, Yc in zip(program.bounds, slacks, Y, strict=True):
        q, T = len(bound.T), bound.T
        blocks.append(
            [product(adjoint(T), product(A[:q, :q], T)) for A in (slack.X, Yc)]
            + [product(A[q:, :q], T) for A in (slack.X, Yc)]
            + [A[q:, q:] for A in (slack.X, Yc)]
        )
    H = np.empty((E, order, E, order))
    for e in range(E):
        A, B = np.zeros((2, E - e, n), dtype=complex)
        for bound, (X11, Y11, X21, Y21, X22, Y22) in zip(program.bounds, blocks, strict=True):
            for j in np.flatnonzero(bound.entries == e):
                r, c = bound.rows[j], bound.cols[j]
                rs, cs, es = bound.rows[j:], bound.cols[j:], bound.entries[j:] - e
                A[es] += Y11[r, rs] * X22[cs, c] + X11[r, rs] * Y22[cs, c]
                B[es] += Y21[c, rs] * X21[cs, r] + X21[c, rs] * Y21[cs, r]
        V = A[:, None] * basis + (B[:, None] * basis).conj()
        V = V.view(float).reshape(-1, 2 * n) @ basis.view(float).T
        H[e:, :, e] = V.reshape(E - e, order, order)
        H[e, :, e:] = H[e:, :, e].transpose(2, 0, 1)
    return H.reshape(E * order, -1)


def square_root(program, p, slacks, s):
    """Triangular R with R'R the matrix of the Newton system, without forming that matrix.

    It has the square root of its condition number. <dS_j, Y dS_k X> is the scalar product of
    C^H dS_j D and C^H dS_k D, where Y = C C^H and X = D D^H with

        D = [[I, -G F], [0, b F]] / sqrt(b),    F F^H = (b^2 I - G^H G)^-1.

    Real and imaginary parts of the entries of L, after t, are the columns of one small matrix per
    frequency. Its triangular factor eliminates t, unless that is shared.
    """
    basis, E = program.basis, program.entries
    n = basis.shape[1]
    rows = []
    for j, (bound, a, Y) in enumerate(zip(program.bounds, slacks, p.Y, strict=True)):
        q = len(bound.T)
        Ch, _ = cholesky(Y, 0.01 * EPS * trace(Y))
        block = np.zeros((2 * q, 2 * q, 1 + 2 * E, n), dtype=complex)

        def image(d, D, a=a, Ch=Ch, q=q):
            """C^H dS D, where dS = [[d I, D], [D^H, d I]]."""
            N = np.concatenate([a.b * D - d * a.G, -product(adjoint(D), a.G)])
            N[range(q, 2 * q), range(q)] += a.b * d
            first = np.concatenate([0 * D, adjoint(D)])
            first[range(q), range(q)] += d
            whole = np.concatenate([first, product(N, a.F)], axis=1)
            return product(Ch, whole) * (1 / np.sqrt(a.b))

        if j == 0:
            block[:, :, 0, program.free] = image(1.0, np.zeros_like(a.G))[..., program.free]
        for e, r, c in zip(bound.entries, bound.rows, bound.cols, strict=True):
            D = np.zeros_like(a.G)
            D[:, c] = bound.T[:, r]
            block[:, :, 1 + 2 * e] = image(0.0, D)
            block[:, :, 2 + 2 * e] = image(0.0, 1j * D)
        block = np.moveaxis(block.reshape(4 * q * q, 1 + 2 * E, n), -1, 0)
        rows += [block.real, block.imag]
    barrier = np.zeros((n, 1, 1 + 2 * E))
    barrier[:, 0, 0] = 1  # where there is no t, something that its elimination leaves alone
    barrier[program.free, 0, 0] = np.sqrt(p.eta / s * len(p.t) / len(program.free))
    small = np.linalg.qr(np.concatenate([*rows, barrier], axis=1), mode="r")
    first, small = (
        (small[:, :, :1], small[:, :, 1:]) if program.shared else (None, small[:, 1:, 1:])
    )
    parts = np.stack([basis.real, basis.imag])
    tall = np.einsum("nrep,pkn->nrek", small.reshape(n, -1, E, 2), parts)
    tall = tall.reshape(-1, E * len(basis))
    if program.shared:
        tall = np.hstack([first.reshape(-1, 1), tall])
    return np.linalg.qr(tall, mode="r")[int(program.shared) :, int(program.shared) :]


def newton(program, p, slacks, total, root):
    """Factorise the Newton system at p, and return the function that solves it.

    `total` is the complementarity at p. `root`: by :func:`square_root`, slower and more accurate.
    """
    m = len(p.G[0])
    s, toward = p.limits[0] - p.t, program.limits - p.limits
    X, Y = slacks[0].X, p.Y[0]
    # <I, Y X> and <dS_j, Y X + X Y> / 2: the second derivatives with respect to t, and t and x
    tt = collect(program, (Y * X.conj()).real.sum(axis=(0, 1))) + p.eta / s
    W = product(Y[m:], X[:, :m]) + product(X[m:], Y[:, :m])
    g = program.bounds[0].gradient(W)
    xt = collect(program, (g[:, None] * program.basis).real).reshape(-1, len(p.t))
    if root:
        R = square_root(program, p, slacks, s)
        scale = 1 / np.linalg.norm(R, axis=0)
        # a shift of 1e-30 in the squares
        R = np.linalg.qr(np.vstack([R * scale, 1e-15 * np.eye(len(R))]), mode="r")
        factor = (R, False)
    else:
        H = normal_matrix(program, slacks, p.Y)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), EPS * np.diag(H).max()))
        factor = factorised(scale[:, None] * (H - (xt / tt) @ xt.T) * scale)

    def correct(d):
        """d, with coefficients and t changed such that all multipliers become stationary."""
        Y = [A + D for A, D in zip(p.Y, d.Y, strict=True)]
        rt = collect(program, trace(Y[0])) - (p.eta + d.eta) - 1
        dx = scale * cho_solve(factor, scale * (stationarity(program, Y) - xt @ (rt / tt)))
        dt = (rt - dx @ xt) / tt
        dx = dx.reshape(p.x.shape)
        dL = dx @ program.basis
        dG = [bound.response(dL) for bound in program.bounds]
        db = program.levels(dt, 0 * toward)
        dY = [-a.sandwich(*e) for a, *e in zip(slacks, p.Y, db, dG, strict=True)]
        return d.moved(Point(dx, dt, 0 * toward, dG, dY, p.eta / s * dt), 1, 1)

    def direction(mu, predictor=None):
        """The direction to Y S = mu I, with the second-order terms of the predictor.

        None if rounding leaves the multipliers too far from stationary.
        """
        dY = [mu * a.X - B for a, B in zip(slacks, p.Y, strict=True)]
        deta = (mu - p.eta * toward[0]) / s - p.eta
        still = [0 * A for A in p.G]
        if toward.any():
            db = program.levels(0.0, toward)
            dY = [A - a.sandwich(*e) for A, a, *e in zip(dY, slacks, p.Y, db, still, strict=True)]
        if predictor is not None:
            db = program.levels(predictor.t, predictor.limits)
            second = zip(dY, slacks, predictor.Y, db, predictor.G, strict=True)
            dY = [A - a.sandwich(*e) for A, a, *e in second]
            deta -= predictor.eta * (predictor.limits[0] - predictor.t) / s
        d = correct(Point(0 * p.x, 0 * p.t, toward, still, dY, deta))
        if predictor is None:
            return d
        for _ in range(REFINEMENTS):
            Y = [A + D for A, D in zip(p.Y, d.Y, strict=True)]
            left = np.linalg.norm(stationarity(program, Y)) * np.linalg.norm(p.x)
            if left <= STATIONARY * total:
                return d
            d = correct(d)
        return d if root else None

    return direction


def degree(p):
    """The number that complementarity is mu times, on the central path."""
    return len(p.t) + sum(Y.shape[0] * Y.shape[2] for Y in p.Y)


def step(program, p, slacks, total, root):
    """The direction of Mehrotra's method from p; None if it is not accurate enough."""
    direction = newton(program, p, slacks, total, root)
    predictor = direction(0.0)
    primal, dual = step_lengths(program, p, predictor, slacks, 0.1)
    left = complementarity(program, p.moved(predictor, primal, dual)) / total
    sigma = min(1, max(left, 0)) ** (1 + 2 * min(primal, dual) ** 2)
    return direction(sigma * total / degree(p), predictor)


def follow(program, p, enough=0.0):
    """Follow the central path from p until the gap is closed or the objective small enough.

    Returns the best point, or None if the bounds were never met, and the number of iterations.
    """
    n, m = program.basis.shape[1], len(p.G[0])
    best, smallest, gaps, root = None, np.inf, [], False
    for iteration in range(100):
        objective, dual = p.t.sum(), dual_value(program, p)
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
            if iteration > 40 or dual - x_max > len(p.t) * program.limits[0]:
                break
        slacks = [Slack(*a) for a in zip(p.G, program.levels(p.t, p.limits), strict=True)]
        d = step(program, p, slacks, total, root)
        if d is None:
            root = True
            d = step(program, p, slacks, total, root)
        primal, dual = step_lengths(program, p, d, slacks, 0.02)
        damping = 0.9 + 0.09 * min(primal, dual)
        primal, dual = (1.0 if a == 1 else damping * a for a in (primal, dual))
        if max(primal, dual) < 0.01:
            break
        p = p.moved(d, primal, dual)
        if primal == 1:
            p = replace(p, limits=program.limits)  # without rounding
    return best, iteration


def solve(program: Program) -> Solution:
    """Solve a synthesis program from nothing.

    Parameters
    ----------
    program : Program
        From :func:`rodlib.synthesis.program.formulate`.

    Returns
    -------
    Solution

    Raises
    ------
    Infeasible
        If M_max cannot be met.
    RuntimeError
        If no filter met the bounds although one exists.
    """
    zero = np.zeros((program.entries, len(program.R)))
    best, iterations = follow(program, begin(program, zero))
    if best is None:  # phase one
        peak = program.peak()
        best, more = follow(peak, begin(peak, zero), enough=program.M_max)
        iterations += more
        if best.t[0] >= program.M_max:
            raise Infeasible(program.M_max, best.t[0])
        best, more = follow(program, begin(program, best.x))
        iterations += more
    if best is None:
        raise RuntimeError(f"no filter met the bounds after {iterations} iterations")
    if program.shared and best.t[0] > program.M_max:
        raise Infeasible(program.M_max, best.t[0])
    multipliers = [-2 * Y[: len(Y) // 2, len(Y) // 2 :] for Y in best.Y]
    return program.solution(best.x, multipliers, "interior point", iterations)
