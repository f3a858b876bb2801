"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

The frequency response of the learning filter is linear in its coefficients, and so is

    M = P Q (P^-1 - L) = Q (I - P L),                                                       (40)

because Q is scalar. A bound on the largest singular value of either is a linear matrix
inequality, one per frequency, and the problems are semidefinite programs.
"""

import warnings
from dataclasses import dataclass
from numbers import Real

import control
import cvxpy as cp
import numpy as np
from scipy.interpolate import CubicSpline

from rodlib import interior_point
from rodlib.certificate import (
    VIOLATION,
    Certificate,
    convergence_model,
    learning_model,
    lower_bound,
    peak_gain,
)
from rodlib.feedback import CurrentTrialLoop, frequency_response
from rodlib.filters import LearningFilter, ZeroPhaseButterworth

DENSER = 10  # the bounds are looked at between the samples, on a grid this much denser
CVXPY_TOLERANCES = (1e-5, 1e-6)  # Clarabel ends "almost solved" on these problems


class InfeasibleError(ValueError):
    """No learning filter of the given order and structure meets the bounds."""


class SolverError(RuntimeError):
    """The solver returned no filter, or one whose certificate fails."""


@dataclass(frozen=True)
class Synthesis:
    """A learning filter and what was checked about it, from singular values.

    Attributes
    ----------
    filter : LearningFilter
    value : float
        The objective: the sum of the largest singular values of M over the band, or their peak.
    certificate : Certificate
        Optimality and bounds, by code independent of the solver.
    omega, sigma_M, sigma_L : ndarray, shape (n,)
        Largest singular values of M and of L at the design frequencies (rad/s).
    status : str
        What the solver said. It is not relied on.
    warm : object
        Where the solver may start for a similar problem: ``synthesise(..., start=design)``.
    """

    filter: LearningFilter
    value: float
    certificate: Certificate
    omega: np.ndarray
    sigma_M: np.ndarray
    sigma_L: np.ndarray
    status: str
    warm: object = None

    def __repr__(self):
        return f"{self.status}\n{self.certificate}"


def largest_singular_values(matrices) -> np.ndarray:
    """Largest singular value of each matrix, shape (n, m, m) to (n,)."""
    return np.linalg.norm(matrices, 2, axis=(1, 2))


def convergence_matrix(P, Q, L) -> np.ndarray:
    """Evaluate M = Q (I - P L) of (40) from frequency responses.

    Parameters
    ----------
    P, L : ndarray, shape (n, m, m)
    Q : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, m, m), complex
    """
    return Q[:, None, None] * (np.eye(P.shape[1]) - P @ L)


def synthesise(
    P,
    Q,
    omega,
    Ts,
    *,
    order=10,
    M_max=0.9,
    L_max=50.0,
    band=(1e-4, 0.02),
    structure="diagonal",
    objective="sum",
    solver="structured",
    start=None,
    check=True,
) -> Synthesis:
    """Design the learning filter by convex optimisation, (39) or (45) with (46).

    Parameters
    ----------
    P : array_like, shape (n, m, m), or control.StateSpace, or CurrentTrialLoop
        Frequency response of the closed loop on `omega`, measured or computed, for any m; or a
        discrete-time model of it.
    Q : array_like, shape (n,), or ZeroPhaseButterworth
        Frequency response of the Q-filter on `omega`, or the filter.
    omega : array_like, shape (n,)
        Design frequencies, rad/s, increasing, up to the Nyquist frequency pi / Ts.
    Ts : float
        Sampling period, s.
    order : int
        Number of samples n_L that the learning filter looks ahead (44).
    M_max : float
        Bound on sigma_max(M), in (0, 1): the slowest convergence tolerated.
    L_max : float or None
        Bound on sigma_max(L), unit of w per unit of y; None leaves it out.
    band : (float, float)
        Lowest and highest frequency of the sum in (39), rad/s.
    structure : {"diagonal", "full"}
    objective : {"sum", "peak"}
        "sum" is (39); "peak" is (45), with (46) unless `L_max` is None.
    solver : {"structured", "cvxpy"}
        :mod:`rodlib.interior_point`, or the problem as the paper states it, in CVXPY.
    start : Synthesis, optional
        A design for other bounds or another band, to start from; same plant, order and structure.
    check : bool
        Whether a filter whose certificate fails raises.

    Returns
    -------
    Synthesis
        With its certificate. What it says about the frequencies between the samples is proven if P
        and Q are models; from arrays it is read off splines, on a grid ten times denser.

    Raises
    ------
    ValueError
        If an argument has the wrong shape or is out of range, P is unstable, or singular at a
        frequency. The message names the argument and the value.
    InfeasibleError
        If no filter meets the bounds; the message says which of them is too tight, and the
        smallest `M_max` that is feasible.
    SolverError
        If the solver fails, or the certificate of its result does.
    """
    model = (P, Q)
    P, Q, omega = _frequency_responses(P, Q, omega, Ts)
    in_band = _check_design(P, omega, order, M_max, L_max, band, structure, objective)
    if solver not in ("structured", "cvxpy"):
        raise ValueError(f"solver = {solver!r} must be 'structured' or 'cvxpy'")
    problem = {"order": order, "L_max": L_max, "structure": structure, "in_band": in_band}
    solve = _solve_structured if solver == "structured" else _solve_in_cvxpy
    margin = 0.0
    while True:
        bounds = {"M_max": M_max * (1 - margin), "L_max": L_max and L_max * (1 - margin)}
        try:
            C, U, V, status, warm = solve(
                P, Q, omega * Ts, objective=objective, start=start, **problem | bounds
            )
        except interior_point.Infeasible as error:
            raise InfeasibleError(
                _advice(P, Q, omega * Ts, M_max, error.smallest_M_max, solve, problem)
            ) from None
        L = LearningFilter(C, Ts)
        sigma_M, sigma_L = _sigmas(P, Q, L, omega)
        excess = max(sigma_M.max() / M_max, sigma_L.max() / (L_max or np.inf)) - 1
        # Rounding, where the coefficients are huge: once more, with as much to spare.
        if margin or not VIOLATION < excess < CVXPY_TOLERANCES[1] or solver == "cvxpy":
            break
        margin = 3 * excess
    value = sigma_M[in_band].sum() if objective == "sum" else sigma_M.max()
    basis = learning_basis(omega * Ts, len(C), order, structure)
    all_M, proven = _peak_of_M(*model, L, (P, Q), omega)
    certificate = Certificate(
        value=value,
        lower_bound=lower_bound(P, Q, basis, U, V, in_band, M_max, L_max, objective),
        idle=np.abs(Q)[in_band].sum() if objective == "sum" else np.abs(Q).max(),
        M_max=M_max,
        L_max=L_max,
        grid_M=sigma_M.max(),
        grid_L=sigma_L.max(),
        all_M=all_M,
        proven=proven,
        all_L=peak_gain(learning_model(L))[0],
        **{} if solver == "structured" else {"tolerances": CVXPY_TOLERANCES},
    )
    if check and certificate.failures:
        raise SolverError(f"{solver}: {status}; " + "; ".join(certificate.failures))
    return Synthesis(L, value, certificate, omega, sigma_M, sigma_L, status, warm)


def learning_basis(angles, m, order, structure) -> np.ndarray:
    """Derivatives of L with respect to its coefficients, (42), (44).

    Parameters
    ----------
    angles : ndarray, shape (n,)
        omega Ts.
    m, order : int
    structure : {"diagonal", "full"}

    Returns
    -------
    ndarray, shape (n, m, m, unknowns), complex
        The coefficients of one entry of L after those of the other, row by row.
    """
    shifts = np.exp(1j * np.outer(angles, np.arange(1, order + 1)))
    entries = [(i, j) for i in range(m) for j in range(m) if structure == "full" or i == j]
    basis = np.zeros((len(angles), m, m, len(entries), order), dtype=complex)
    for position, (i, j) in enumerate(entries):
        basis[:, i, j, position] = shifts
    return basis.reshape(len(angles), m, m, -1)


def _sigmas(P, Q, L, omega):
    response = L.frequency_response(omega)
    M = convergence_matrix(P, Q, response)
    return largest_singular_values(M), largest_singular_values(response)


def _peak_of_M(P, Q, L, samples, omega):
    """Peak of sigma_max(M) over all frequencies, and whether it is proven."""
    P = P.P if isinstance(P, CurrentTrialLoop) else P
    if isinstance(P, control.StateSpace) and isinstance(Q, ZeroPhaseButterworth):
        return peak_gain(convergence_model(P, Q, L))[0], True
    steps = np.linspace(0, 1, DENSER, endpoint=False)
    dense = np.append((omega[:-1, None] + np.diff(omega)[:, None] * steps).ravel(), omega[-1])
    P, Q = (CubicSpline(omega, values)(dense) for values in samples)
    return _sigmas(P, Q, L, dense)[0].max(), False


def _solve_structured(
    P, Q, angles, *, order, M_max, L_max, structure, in_band, objective, start=None
):
    try:
        solution = interior_point.solve(
            P, Q, angles, 1.0, order=order, M_max=M_max, L_max=L_max, band_mask=in_band,
            structure=structure, objective=objective, start=start and start.warm,
        )  # fmt: skip
    except interior_point.Infeasible:
        raise
    except RuntimeError as error:
        raise SolverError(f"structured interior point: {error}") from None
    status = f"structured interior point, {solution.iterations} iterations"
    return solution.coefficients, solution.U, solution.V, status, solution


def _solve_in_cvxpy(
    P, Q, angles, *, order, M_max, L_max, structure, in_band, objective, start=None
):
    """State the problem in CVXPY as the paper does and solve it with Clarabel."""
    n, m, _ = P.shape
    basis = learning_basis(angles, m, order, structure)
    gain = Q[:, None, None, None] * np.einsum("nij,njkc->nikc", P, basis)  # -dM / d coefficients

    # Whitened unknowns x = R c: their columns of M and L are orthonormal.
    stacked = np.concatenate([gain, basis / L_max]) if L_max else gain
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

    L = affine(np.zeros((n, m, m)), basis)
    M = affine(Q[:, None, None] * np.eye(m), -gain)  # (40)

    if objective == "sum":
        t = cp.Variable(int(in_band.sum()))  # sigma_max(M) at the frequencies of the band
        select = np.zeros((n, len(in_band.nonzero()[0])))
        select[in_band] = np.eye(select.shape[1])
        bound = select @ t + M_max * ~in_band
        minimise = cp.sum(t)
    else:
        t = cp.Variable()
        bound = t * np.ones(n)
        minimise = t
    subject_to = [_sigma_max_at_most(M, bound), t <= M_max]  # (39), (45)
    if L_max and structure == "diagonal":
        moduli = [cp.norm(cp.vstack([part[:, i, i] for part in L]), axis=0) for i in range(m)]
        subject_to += [modulus <= L_max for modulus in moduli]  # (39), (46)
    elif L_max:
        subject_to += [_sigma_max_at_most([part / L_max for part in L], np.ones(n))]

    problem = cp.Problem(cp.Minimize(minimise), subject_to)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": the caller checks the result
            problem.solve(
                solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND,
                chordal_decomposition_enable=False,
            )  # fmt: skip
    except cp.SolverError as error:
        raise SolverError(f"Clarabel failed: {error}") from None
    if x.value is None or problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        if objective == "sum":
            peak = {"order": order, "L_max": L_max, "structure": structure, "in_band": in_band}
            C, *_ = _solve_in_cvxpy(P, Q, angles, M_max=np.inf, objective="peak", **peak)
            smallest = _sigmas(P, Q, LearningFilter(C, 1.0), angles)[0].max()
            if smallest > M_max:
                raise interior_point.Infeasible(M_max, smallest)
        raise SolverError(f"Clarabel ended with status {problem.status!r} and returned no filter")
    coefficients = np.zeros((m, m, order))
    entries = np.ones((m, m), dtype=bool) if structure == "full" else np.eye(m, dtype=bool)
    coefficients[entries] = np.linalg.solve(R, x.value).reshape(-1, order)

    U, V = _multiplier(subject_to[0]), None
    if L_max and structure == "full":
        V = _multiplier(subject_to[2]) / L_max
    elif L_max:
        V = LearningFilter(coefficients, 1.0).frequency_response(angles)
        for i in range(m):
            V[:, i, i] *= subject_to[2 + i].dual_value / np.abs(V[:, i, i])
    return coefficients, U, V, f"CVXPY with Clarabel: {problem.status}", None


def _multiplier(constraint):
    """Multiplier of sigma_max(X_i) <= b_i from that of its linear matrix inequality."""
    Z = constraint.dual_value
    m = Z.shape[-1] // 4
    Z = Z.reshape(len(Z), 4, m, 4, m)
    return -2 * (Z[:, 0, :, 2] + Z[:, 1, :, 3] + 1j * (Z[:, 1, :, 2] - Z[:, 0, :, 3]))


def _sigma_max_at_most(parts, bound):
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


def _advice(P, Q, angles, M_max, smallest, solve, problem):
    """Which bound is too tight, and what would be feasible."""
    remedy = f"the smallest feasible M_max is {smallest:.6g}"
    if problem["L_max"] is not None:
        C, *_ = solve(P, Q, angles, M_max=np.inf, objective="peak", **problem | {"L_max": None})
        without = _sigmas(P, Q, LearningFilter(C, 1.0), angles)[0].max()
        if without <= M_max:
            return (
                f"infeasible: L_max = {problem['L_max']} is too tight for M_max = {M_max}. With "
                f"this L_max {remedy}; raise L_max or M_max"
            )
        remedy += f" with L_max = {problem['L_max']}, and {without:.6g} without a bound on L"
    return (
        f"infeasible: M_max = {M_max} is too tight for a {problem['structure']} filter of order = "
        f"{problem['order']}; {remedy}. Raise M_max or the order, or lower the cut-off of Q"
    )


def _frequency_responses(P, Q, omega, Ts):
    """Samples of P and Q on omega, checked."""
    if not (isinstance(Ts, Real) and 0 < Ts < np.inf):
        raise ValueError(f"Ts = {Ts!r} must be a positive sampling period in seconds")
    omega = np.asarray(omega, dtype=float)
    if omega.ndim != 1 or len(omega) < 2 or not np.all(np.diff(omega) > 0):
        raise ValueError(f"omega, of shape {omega.shape}, must be a row of increasing frequencies")
    nyquist = np.pi / Ts
    if omega[0] < 0 or omega[-1] > nyquist * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega[0]:.6g}, {omega[-1]:.6g}] rad/s, but must lie in "
            f"[0, {nyquist:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    P = P.P if isinstance(P, CurrentTrialLoop) else P
    if isinstance(P, control.StateSpace):
        if P.dt != Ts:
            raise ValueError(f"P.dt = {P.dt!r} differs from Ts = {Ts!r}: sample the model at Ts")
        radius = np.abs(P.poles()).max(initial=0)
        if radius >= 1:
            raise ValueError(f"P is unstable: it has a pole of modulus {radius:.6g}, 1 or more")
        P = frequency_response(P, omega)
    P = np.asarray(P, dtype=complex)
    if P.shape[:1] != omega.shape or P.ndim != 3 or P.shape[1] != P.shape[2]:
        raise ValueError(f"P has shape {P.shape}, but must be ({len(omega)}, m, m) to fit omega")
    if isinstance(Q, ZeroPhaseButterworth):
        if Q.Ts != Ts:
            raise ValueError(f"Q.Ts = {Q.Ts!r} differs from Ts = {Ts!r}")
        Q = Q.frequency_response(omega)
    Q = np.asarray(Q)
    if Q.shape != omega.shape:
        raise ValueError(f"Q has shape {Q.shape}, but must be {omega.shape} to fit omega")
    for name, response in (("P", P), ("Q", Q)):
        bad = np.flatnonzero(~np.isfinite(response).reshape(len(omega), -1).all(axis=1))
        if bad.size:
            raise ValueError(f"{name} is not finite at omega = {omega[bad[0]]:.6g} rad/s")
    singular_values = np.linalg.svd(P, compute_uv=False)
    singular = np.flatnonzero(singular_values[:, -1] <= 1e-12 * singular_values[:, 0])
    if singular.size:
        raise ValueError(
            f"P is singular at omega = {omega[singular[0]]:.6g} rad/s (smallest singular value "
            f"{singular_values[singular[0], -1]:.3g}): P^-1 in (40) does not exist there"
        )
    return P, Q, omega


def _check_design(P, omega, order, M_max, L_max, band, structure, objective):
    if structure not in ("diagonal", "full"):
        raise ValueError(f"structure = {structure!r} must be 'diagonal' or 'full'")
    if objective not in ("sum", "peak"):
        raise ValueError(f"objective = {objective!r} must be 'sum' or 'peak'")
    if not (isinstance(order, int | np.integer) and 1 <= order <= len(omega)):
        raise ValueError(
            f"order = {order!r} must be a whole number from 1 to len(omega) = {len(omega)}"
        )
    if not (isinstance(M_max, Real) and 0 < M_max < 1):
        raise ValueError(f"M_max = {M_max!r} must be in (0, 1), or the trials do not converge")
    if L_max is not None and not (isinstance(L_max, Real) and 0 < L_max < np.inf):
        raise ValueError(f"L_max = {L_max!r} must be a positive number, or None for no bound")
    low, high = band
    slack = 1e-9 * omega[-1]
    if not omega[0] - slack <= low < high <= omega[-1] + slack:
        raise ValueError(
            f"band = {band!r} must be two increasing frequencies within omega, "
            f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
        )
    in_band = (omega >= low) & (omega <= high)
    if not in_band.any():
        raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    return in_band
