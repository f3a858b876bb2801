"""The synthesis problem in CVXPY, as the paper states it: to read, and to compare with.

For one plant P_i (m x m) and Q_i at frequencies omega_i, with z_i = exp(j omega_i Ts), find the
real coefficients C_k of

    L_i = sum_k C_k z_i^k,    M_i = Q_i (I - P_i L_i),    (44), (40)

that minimise the sum of sigma_max(M_i) in a band, (39), or the largest, (45), subject to

    sigma_max(M_i) <= M_max,    sigma_max(L_i) <= L_max    (46)

at all frequencies. That sigma_max(G) <= b is one matrix inequality, [[b I, G], [G^H, b I]] >= 0,
here for all frequencies at once, with [[Re G, -Im G], [Im G, Re G]] in the place of G.
"""

import warnings

import cvxpy as cp
import numpy as np


def statement(
    P, Q, omega, Ts, *, order, band=None, M_max=0.9, L_max=None, structure="full", objective="sum"
):
    """State the problem, and let Clarabel solve it.

    Arguments as for :func:`ilctools.synthesise`, P and Q as arrays. The powers of z are nearly
    dependent at low frequencies, where Clarabel would fail: C consists of multiples of R^-T, of
    which L is a combination of orthonormal functions.

    Returns
    -------
    coefficients : ndarray, shape (m, m, order)
        C_k; NaN if the bounds cannot be met.
    value : float
        The objective; infinite if the bounds cannot be met. Clarabel's accuracy is about 1e-6.
    """
    n, m, _ = P.shape
    z = np.exp(1j * omega * Ts)[:, None] ** np.arange(1, order + 1)
    inverse = np.linalg.inv(np.linalg.qr(np.vstack([z.real, z.imag]), mode="r")) * np.sqrt(n)
    taps, t = cp.Variable((order, m * m)), cp.Variable(n)
    L = cp.reshape((z @ inverse) @ taps, (n, m, m), order="C")  # (44)
    M = Q[:, None, None] * np.eye(m) - (Q[:, None, None] * P) @ L  # (40)
    bounds = [sigma_max_at_most(M, t), t <= M_max]
    if L_max is not None:
        bounds.append(sigma_max_at_most(L, np.full(n, L_max)))  # (46)
    if structure == "diagonal":
        bounds.append(taps[:, ~np.eye(m, dtype=bool).ravel()] == 0)
    in_band = t if band is None else t[(omega >= band[0]) & (omega <= band[1])]
    cost = cp.sum(in_band) if objective == "sum" else cp.max(t)  # (39), (45)
    value = least(cost, bounds)
    C = np.full((order, m * m), np.nan) if taps.value is None else inverse @ taps.value
    return C.T.reshape(m, m, order), value


def least(cost, bounds) -> float:
    """The least cost within the bounds, by Clarabel."""
    problem = cp.Problem(cp.Minimize(cost), bounds)
    options = {"canon_backend": cp.SCIPY_CANON_BACKEND, "chordal_decomposition_enable": False}
    with warnings.catch_warnings(action="ignore"):  # "may be inaccurate": about 1e-6
        return problem.solve(solver=cp.CLARABEL, **options)


def sigma_max_at_most(G, b):
    """sigma_max(G_i) <= b_i."""
    n, m, _ = G.shape
    G = blocks(cp.real(G), -cp.imag(G), cp.imag(G), cp.real(G))
    corner = cp.multiply(cp.reshape(b, (n, 1, 1), order="C"), np.tile(np.eye(2 * m), (n, 1, 1)))
    return blocks(corner, G, cp.swapaxes(G, 1, 2), corner) >> 0


def blocks(upper_left, upper_right, lower_left, lower_right):
    """A block matrix for each frequency."""
    upper = cp.concatenate([upper_left, upper_right], axis=2)
    return cp.concatenate([upper, cp.concatenate([lower_left, lower_right], axis=2)], axis=1)
