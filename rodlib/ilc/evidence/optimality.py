"""Is the filter optimal? A bound on the objective that no other filter can beat.

It follows from the solver's multipliers, whatever their quality, by linear algebra alone.
"""

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.evidence.robustness import affine, layout
from rodlib.ilc.problem import Cuts, Problem

STEPS = 200  # of Newton's method; 50 are usual
FASTER = 10.0  # factor from one weight of the objective against the barrier to the next
CLOSE = 1e-10  # relative accuracy of all dual norms together
FAINT = 1e-9  # least eigenvalue of X, relative


def lower_bound(problem: Problem, U, V, cuts: Cuts | None = None, L=None) -> float:
    """Lower bound on the optimum of (39) or (45), from multipliers and linear algebra alone.

    For all filters that meet the bounds, and all U_i, V_i, N_c with sum_i Re tr(U_i^H dM_i) +
    Re tr(V_i^H dL_i) + sum_c Re tr(N_c^H dG_c) = 0 for every change of the coefficients,

        sum_i Re tr(U_i^H Q_i) + sum_c Re tr(N_c^H F_c)
            = sum_i Re tr(U_i^H M_i) + Re tr(V_i^H L_i) + sum_c Re tr(N_c^H G_c)
            <= sum_i |U_i| sigma_max(M_i) + sum_i |W^-1 V_i| + sum_c nu(N_c) b_c

    with nuclear norms |.|, W of :attr:`rodlib.ilc.problem.Problem.weight`, the matrices G = F + T L
    of :class:`rodlib.ilc.problem.Cuts`, and nu of :func:`dual_norm`, dual to their bound b. Where
    |U_i| exceeds the weight of sigma_max(M_i) in the objective, the excess is bounded with M_max,
    and so are the b_c. For the peak, they are no larger than the objective itself. The cost of
    noise is the square sum |G|^2 of weighted entries G of Q P L, and |G|^2 >= Re tr(N^H G) - |N|^2
    / 4 for every N: one more such term, which N = 2 G makes as large as it can be. The multipliers
    are first projected on those that fulfil the condition, so the bound holds, up to rounding,
    whatever was passed. A coefficient of L_jk acts on column k of M, L and G only, so the columns
    are projected one by one.

    Parameters
    ----------
    problem : Problem
    U, V : ndarray, shape (n, m, m); V may be None
        Multipliers of the bounds on M and on L. With V None, no bound on L is used at all.
    cuts : Cuts, optional
        Multipliers of the bounds on other plants, and for a radius. Without them, these bounds are
        not used.
    L : ndarray, shape (n, m, m), optional
        Frequency response of the filter at which the cost of noise is linearised, in units of
        `scale`. Without it the cost is taken to be zero.

    Returns
    -------
    float
        For radii of the entries, no filter for which the sufficient condition of
        :func:`rodlib.ilc.evidence.worst_case` holds does better.

    Raises
    ------
    ValueError
        If an argument is something else, has another shape or is not finite.
    """
    arguments.instance("problem", problem, Problem)
    P, Q, angles = problem.P, problem.Q, problem.angles
    n, m, _ = P.shape
    U = arguments.array("U", U, P.shape, complex)
    V = V if V is None else arguments.array("V", V, P.shape, complex)
    L = L if L is None else arguments.array("L", L, P.shape, complex)
    if cuts is not None:
        arguments.instance("cuts", cuts, Cuts)

    T, N, turns = [-Q[:, None, None] * P], [U], [angles]
    if V is not None:  # in units of the bound, so that both parts have the size of the objective
        W = problem.weight
        T, N = [*T, np.broadcast_to(W, (n, m, m))], [*N, np.linalg.solve(W, V)]
        turns.append(angles)
    F = np.empty((0, layout(problem).size, m))
    if cuts is not None:
        F, slope = affine(problem, cuts.plant, cuts.frequency)
        felt = np.abs(slope).max(axis=2, keepdims=True) > 0  # a row of G that is not zero
        T, N = [*T, slope], [*N, cuts.N * felt]
        turns.append(angles[cuts.frequency])
    noisy = problem.noise is not None and L is not None
    if noisy:
        weight = np.sqrt(problem.noise)
        slope = Q[:, None, None] * P
        T, N, turns = [*T, slope], [*N, 2 * weight[:, None] * (slope @ L)], [*turns, angles]
    angles = np.concatenate([np.repeat(t, X.shape[1]) for t, X in zip(turns, T, strict=True)])
    T, N = (np.concatenate([X.reshape(-1, m) for X in parts]).astype(complex) for parts in (T, N))
    for rows, columns in _groups(problem, noisy):
        part = T[:, rows]
        if noisy:  # the last rows, in the weight of this column
            part[-n * m :] *= np.repeat(weight[:, columns[0]], m)[:, None]
        changes = _changes(part, angles, problem.order)
        part = _rows(N[:, columns])
        for _ in range(2):
            part -= (part @ changes.T) @ changes
        N[:, columns] = part.view(complex).T
    noise = 0.0
    if noisy:
        N, noise = N[: -n * m], (np.abs(N[-n * m :]) ** 2).sum() / 4
    plain = 2 * n if V is not None else n
    N, beyond = N[: plain * m].reshape(-1, m, m), N[plain * m :].reshape(F.shape)
    norms = np.linalg.svd(N, compute_uv=False).sum(axis=1)
    bound = (np.trace(N[:n].conj(), axis1=1, axis2=2) * Q).real.sum() - norms[n:].sum()
    bound += (beyond.conj() * F).real.sum()
    others = dual_norm(beyond[:, layout(problem)]).sum()
    if problem.objective == "peak":
        total = norms[:n].sum() + others
        if not noise:
            return max(0.0, float(bound / total))  # as it could not be less
        # s times the multipliers: for s total > 1 the excess is bounded with M_max, as it is below
        low = min(max(bound, 0) / (2 * noise), 1 / total)
        high = max((bound - total * problem.M_max) / (2 * noise), 1 / total)
        over = (high * total - 1) * problem.M_max
        return float(max(0, low * bound - low**2 * noise, high * bound - high**2 * noise - over))
    excess = np.maximum(norms[:n] - problem.in_band, 0).sum() + others
    return max(0.0, float(bound - problem.M_max * excess - noise))


def _groups(problem, noisy):
    """Rows and columns of L whose coefficients change the same rows of T L in the same way."""
    every = list(range(problem.channels))
    if problem.structure == "diagonal":
        return [([k], [k]) for k in every]
    return [(every, [k]) for k in every] if noisy else [(every, every)]


def dual_norm(N) -> np.ndarray:
    """Upper bounds of nu(N): the largest Re tr(N^H G) with all G that are bounded by one.

    Parameters
    ----------
    N : ndarray, shape (c, g, k, l, m)
        Rows of multipliers, in g groups of k blocks of l rows, :func:`rodlib.ilc.evidence.layout`.

    Returns
    -------
    ndarray, shape (c,)

    Notes
    -----
    G is bounded by one if shares d > 0 of its blocks exist that add up to one in each group, with
    sum G_k^H G_k / d_k <= I. So for all X > 0, and c_k = tr(N_k X^-1 N_k^H),

        Re tr(N^H G) <= sum_k sqrt(c_k tr(G_k X G_k^H))
                     <= sqrt(sum_k c_k d_k) sqrt(sum_k tr(G_k X G_k^H) / d_k)
                     <= sqrt(sum over groups of max c_k) sqrt(tr X),

    by Cauchy and Schwarz, twice. The least of these bounds is the largest nuclear norm of N with
    rows weighted by square roots of weights w_k > 0 that add up to one in each group, and belongs
    to X = (sum_k w_k N_k^H N_k)^(1/2). The weights are found by Newton's method with a barrier,
    and any of them give a bound that holds. Without a radius nu is the nuclear norm.
    """
    count, groups, blocks, rows, m = N.shape
    if blocks == 1:
        return np.linalg.svd(N.reshape(count, rows, m), compute_uv=False).sum(axis=1)
    N = N.reshape(count, groups * blocks, rows, m)
    size = np.sqrt((np.abs(N) ** 2).sum(axis=(1, 2, 3)))
    N = N / np.where(size > 0, size, 1)[:, None, None, None]
    member = np.kron(np.eye(groups), np.ones(blocks))
    w = np.full(N.shape[:2], 1 / blocks)
    weight, todo = np.ones(count), np.arange(count)
    for _ in range(STEPS):
        step, decrement = _newton_step(N[todo], w[todo], weight[todo], member)
        w[todo] *= 1 + step / np.where(decrement < 0.25, 1, 1 + 2 * decrement)[:, None]
        weight[todo] *= np.where(decrement < 0.25, FASTER, 1)
        todo = todo[weight[todo] * CLOSE * size.sum() < size[todo]]  # little ones need less
        if not todo.size:
            break
    s, C = _costs(N, w)
    c = np.einsum("ckaa->ck", C).real.reshape(count, groups, blocks)
    return size * np.sqrt(c.max(axis=2).sum(axis=1) * s.sum(axis=1))


def _costs(N, w):
    """Eigenvalues s of X, and X^(-1/2) N_k^H N_k X^(-1/2) in the basis of its eigenvectors."""
    count, blocks, rows, m = N.shape
    weighted = (np.sqrt(w)[..., None, None] * N).reshape(count, blocks * rows, m)
    floor = np.broadcast_to(FAINT * np.eye(m), (count, m, m))
    _, s, B = np.linalg.svd(np.concatenate([weighted, floor], axis=1), full_matrices=False)
    inner = N @ B.conj().swapaxes(1, 2)[:, None] / np.sqrt(s)[:, None, None]
    return s, inner.conj().swapaxes(2, 3) @ inner


def _newton_step(N, w, weight, member):
    """Relative step of w towards the largest weight tr X + sum log w, and its decrement."""
    (s, C), (groups, blocks) = _costs(N, w), member.shape
    C = w[..., None, None] * C
    c = np.einsum("ckaa->ck", C).real
    scaled = C / (s[:, :, None] + s[:, None])[:, None]
    system = np.zeros((len(w), blocks + groups, blocks + groups))
    curvature = np.einsum("ckab,clab->ckl", scaled, C.conj(), optimize=True).real / 2
    system[:, :blocks, :blocks] = weight[:, None, None] * curvature + np.eye(blocks)
    system[:, blocks:, :blocks] = member * w[:, None]
    system[:, :blocks, blocks:] = system[:, blocks:, :blocks].swapaxes(1, 2)
    right = np.zeros((len(w), blocks + groups, 1))
    right[:, :blocks, 0] = weight[:, None] * c / 2 + 1
    step = np.linalg.solve(system, right)[:, :blocks, 0]
    metric = system[:, :blocks, :blocks]
    return step, np.sqrt(np.einsum("ck,ckl,cl->c", step, metric, step))


def _changes(T, angles, order):
    """Orthonormal rows that span what the coefficients can do to T L, from the rows of T.

    The powers of z are nearly dependent at low frequencies. Arnoldi's process never forms them: it
    multiplies the last rows by z - 1 and makes the result orthogonal to all before, which spans
    the same space and needs no more than doubles.
    """
    rows = _rows(T * np.exp(1j * angles)[:, None])
    step = np.expm1(1j * angles)
    done = np.empty((0, rows.shape[1]))
    for _ in range(order):
        for _ in range(2):  # once leaves what rounding has put back
            rows = np.linalg.qr((rows - (rows @ done.T) @ done).T)[0].T
        done = np.vstack([done, rows])
        rows = (np.ascontiguousarray(rows).view(complex) * step).view(float)
    return done


def _rows(X):
    """Each column of X as one real row, real and imaginary parts in turn."""
    return np.ascontiguousarray(X.T, dtype=complex).view(float)
