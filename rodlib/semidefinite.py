"""The synthesis problems in CVXPY, as the paper states them: one matrix inequality per frequency.

This is the statement to read, and to compare with. :mod:`rodlib.interior_point` solves the same
problems about twenty times faster, and more accurately.
"""

import warnings

import cvxpy as cp
import numpy as np

from rodlib.certificate import weight_of_L
from rodlib.cones import Infeasible, Solution
from rodlib.filters import time_shifts


def solve(P, Q, omega, Ts, *, order, M_max, L_max, band_mask, structure, objective) -> Solution:
    """State the problem in CVXPY and solve it with Clarabel.

    Parameters as for :func:`rodlib.cones.formulate`.

    Returns
    -------
    Solution

    Raises
    ------
    ValueError
        If the frequencies do not determine that many coefficients.
    Infeasible
        If M_max cannot be met.
    RuntimeError
        If Clarabel fails.
    """
    n, m, _ = P.shape
    shifts = time_shifts(omega * Ts, order).astype(complex)
    entries = np.ones((m, m), dtype=bool) if structure == "full" else np.eye(m, dtype=bool)
    basis = np.zeros((n, m, m, entries.sum(), order), dtype=complex)  # dL / d coefficients
    for position, (i, j) in enumerate(np.argwhere(entries)):
        basis[:, i, j, position] = shifts
    basis = basis.reshape(n, m, m, -1)
    gain = Q[:, None, None, None] * np.einsum("nij,njkc->nikc", P, basis)  # -dM / d coefficients

    # Whitened unknowns x = R c: their columns of M and L are orthonormal.
    W = weight_of_L(P, Q, L_max)
    weighted = np.einsum("ij,njkc->nikc", W, basis)
    stacked = np.concatenate([gain, weighted])
    stacked = stacked.reshape(-1, stacked.shape[-1])
    R = np.linalg.qr(np.vstack([stacked.real, stacked.imag]), mode="r")
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-14 * diagonal.max():
        raise ValueError(f"order = {order}: the frequencies omega do not determine so many taps")
    x = cp.Variable(len(R))

    def affine(constant, linear):  # real and imaginary part of constant + linear c
        linear = np.linalg.solve(R.T, linear.reshape(n * m * m, -1).T).T
        constant = constant.ravel()
        parts = (constant.real + linear.real @ x, constant.imag + linear.imag @ x)
        return [cp.reshape(part, (n, m, m), order="C") for part in parts]

    WL = affine(np.zeros((n, m, m)), weighted)
    M = affine(Q[:, None, None] * np.eye(m), -gain)  # (40)

    if objective == "sum":
        t = cp.Variable(int(band_mask.sum()))  # sigma_max(M) at the frequencies of the band
        select = np.zeros((n, len(band_mask.nonzero()[0])))
        select[band_mask] = np.eye(select.shape[1])
        bound = select @ t + M_max * ~band_mask
        minimise = cp.sum(t)
    else:
        t = cp.Variable()
        bound = t * np.ones(n)
        minimise = t
    subject_to = [sigma_max_at_most(M, bound), t <= M_max]  # (39), (45)
    if structure == "diagonal":
        moduli = [cp.norm(cp.vstack([part[:, i, i] for part in WL]), axis=0) for i in range(m)]
        subject_to += [modulus <= 1 for modulus in moduli]  # (39), (46)
    else:
        subject_to += [sigma_max_at_most(WL, np.ones(n))]

    problem = cp.Problem(cp.Minimize(minimise), subject_to)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": the caller checks the result
            problem.solve(
                solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND,
                chordal_decomposition_enable=False,
            )  # fmt: skip
    except cp.SolverError as error:
        raise RuntimeError(f"Clarabel failed: {error}") from None
    if x.value is None or problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        if objective == "sum":
            arguments = {"order": order, "L_max": L_max, "structure": structure}
            best = solve(
                P, Q, omega, Ts, M_max=np.inf, band_mask=band_mask, objective="peak", **arguments
            )
            if best.peak > M_max:
                raise Infeasible(M_max, best.peak)
        raise RuntimeError(f"Clarabel ended with status {problem.status!r} and returned no filter")
    coefficients = np.zeros((m, m, order))
    coefficients[entries] = np.linalg.solve(R, x.value).reshape(-1, order)
    response = np.einsum("ijk,nk->nij", coefficients, shifts)
    peak = np.linalg.norm(Q[:, None, None] * (np.eye(m) - P @ response), 2, axis=(1, 2)).max()

    U = multiplier(subject_to[0])
    if structure == "full":
        V = W @ multiplier(subject_to[2])
    else:
        V = W @ (response / np.maximum(np.abs(response), 1e-300))
        for i in range(m):
            V[:, i, i] *= subject_to[2 + i].dual_value
    method = f"CVXPY with Clarabel ({problem.status})"
    return Solution(coefficients, U, V, peak, method, problem.solver_stats.num_iters)


def multiplier(constraint):
    """Multiplier of sigma_max(X_i) <= b_i from that of its linear matrix inequality."""
    Z = constraint.dual_value
    m = Z.shape[-1] // 4
    Z = Z.reshape(len(Z), 4, m, 4, m)
    return -2 * (Z[:, 0, :, 2] + Z[:, 1, :, 3] + 1j * (Z[:, 1, :, 2] - Z[:, 0, :, 3]))


def sigma_max_at_most(parts, bound):
    """sigma_max(X_i) <= b_i as [[b I, X], [X^H, b I]] >= 0, written in real numbers."""
    real, imag = parts
    n, m, _ = real.shape
    b = cp.multiply(cp.reshape(bound, (n, 1, 1), order="C"), np.tile(np.eye(m), (n, 1, 1)))
    zero = np.zeros((n, m, m))
    real_t, imag_t = (cp.swapaxes(part, 1, 2) for part in parts)
    rows = [
        [b, zero, real, -imag],
        [zero, b, imag, real],
        [real_t, imag_t, b, zero],
        [-imag_t, real_t, zero, b],
    ]
    return cp.concatenate([cp.concatenate(row, axis=2) for row in rows], axis=1) >> 0
