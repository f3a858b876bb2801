"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

The frequency response of the learning filter is linear in its coefficients, and so is

    M = P Q (P^-1 - L) = Q (I - P L),                                                       (40)

because Q is scalar. A bound on the largest singular value of either is a linear matrix
inequality, one per frequency, and the problems are semidefinite programs.
"""

import warnings
from dataclasses import dataclass
from functools import partial
from numbers import Real

import control
import cvxpy as cp
import numpy as np
from scipy.interpolate import CubicSpline

from rodlib.feedback import CurrentTrialLoop, frequency_response
from rodlib.filters import LearningFilter, ZeroPhaseButterworth

VIOLATION = 1e-6  # relative; a solution further outside its bounds is not returned
DENSER = 10  # the bounds are looked at between the samples, on a grid this much denser


class InfeasibleError(ValueError):
    """No learning filter of the given order and structure meets the bounds."""


class SolverError(RuntimeError):
    """The solver returned no filter, or one that did not pass the check."""


@dataclass(frozen=True)
class Synthesis:
    """A learning filter and what was checked about it, from singular values.

    Attributes
    ----------
    filter : LearningFilter
    value : float
        The objective: the sum of the largest singular values of M over the band, or their peak.
    omega, sigma_M, sigma_L : ndarray, shape (n,)
        Largest singular values of M and of L at the design frequencies (rad/s).
    omega_dense, sigma_M_dense, sigma_L_dense : ndarray
        The same on a grid ten times denser.
    status : str
        What the solver said. It is not relied on.
    """

    filter: LearningFilter
    value: float
    omega: np.ndarray
    sigma_M: np.ndarray
    sigma_L: np.ndarray
    omega_dense: np.ndarray
    sigma_M_dense: np.ndarray
    sigma_L_dense: np.ndarray
    status: str

    def __repr__(self):
        rows = [
            ("", "sigma_max(M)", "sigma_max(L)"),
            ("on the design grid", f"{self.sigma_M.max():.7f}", f"{self.sigma_L.max():.6f}"),
            (
                f"{DENSER} times denser",
                f"{self.sigma_M_dense.max():.7f}",
                f"{self.sigma_L_dense.max():.6f}",
            ),
        ]
        head = f"objective {self.value:.6f}; solver: {self.status}"
        return "\n".join([head] + ["{:<20}{:>14}{:>16}".format(*row) for row in rows])


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

    Returns
    -------
    Synthesis
        Its bounds have been checked with singular values; between the samples of `omega` exactly
        if P and Q are models, with splines through the samples if they are arrays.

    Raises
    ------
    ValueError
        If an argument has the wrong shape or is out of range, P is unstable, or singular at a
        frequency. The message names the argument and the value.
    InfeasibleError
        If no filter meets the bounds; the message says which of them is too tight, and the
        smallest `M_max` that is feasible.
    SolverError
        If the solver fails, or its result does not pass the check.
    """
    P, Q, omega, between = _frequency_responses(P, Q, omega, Ts)
    in_band = _check_design(P, omega, order, M_max, L_max, band, structure, objective)
    bounds = (order, M_max, L_max, structure)

    coefficients, status = _solve(P, Q, omega * Ts, in_band, *bounds, objective)
    result = None
    if coefficients is not None:
        result = _examine(coefficients, status, P, Q, omega, Ts, in_band, objective, between)
        excess = max(result.sigma_M.max() / M_max - 1, result.sigma_L.max() / (L_max or np.inf) - 1)
        if excess <= VIOLATION:
            return result
    smallest = _smallest_M_max(P, Q, omega * Ts, in_band, order, L_max, structure)
    if smallest > M_max * (1 + VIOLATION):
        raise InfeasibleError(_advice(P, Q, omega * Ts, in_band, *bounds, smallest))
    if result is None:
        raise SolverError(f"Clarabel ended with status {status!r} and returned no filter")
    raise SolverError(
        f"Clarabel ended with status {status!r}; its filter exceeds a bound by {excess:.1e} "
        f"relative: sigma_max(M) = {result.sigma_M.max():.9g} (M_max = {M_max}), "
        f"sigma_max(L) = {result.sigma_L.max():.9g} (L_max = {L_max})"
    )


def _solve(P, Q, angles, in_band, order, M_max, L_max, structure, objective):
    """State the problem in CVXPY as the paper does and solve it; None if that fails."""
    n, m, _ = P.shape
    basis = _basis(angles, m, order, structure)  # dL / d coefficients, (n, m, m, unknowns)
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
        return None, str(error)
    if x.value is None or problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        return None, problem.status
    unknowns = np.linalg.solve(R, x.value)
    coefficients = np.zeros((m, m, order))
    entries = np.ones((m, m), dtype=bool) if structure == "full" else np.eye(m, dtype=bool)
    coefficients[entries] = unknowns.reshape(-1, order)
    return coefficients, problem.status


def _basis(angles, m, order, structure):
    shifts = np.exp(1j * np.outer(angles, np.arange(1, order + 1)))
    entries = [(i, j) for i in range(m) for j in range(m) if structure == "full" or i == j]
    basis = np.zeros((len(angles), m, m, len(entries), order), dtype=complex)
    for position, (i, j) in enumerate(entries):
        basis[:, i, j, position] = shifts
    return basis.reshape(len(angles), m, m, -1)


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


def _smallest_M_max(P, Q, angles, in_band, order, L_max, structure):
    coefficients, status = _solve(P, Q, angles, in_band, order, np.inf, L_max, structure, "peak")
    if coefficients is None:
        raise SolverError(f"Clarabel ended with status {status!r} in search of a feasible M_max")
    L = LearningFilter(coefficients, 1.0).frequency_response(angles)
    return largest_singular_values(convergence_matrix(P, Q, L)).max()


def _advice(P, Q, angles, in_band, order, M_max, L_max, structure, smallest):
    remedy = f"the smallest feasible M_max is {smallest:.6g}"
    if L_max is not None:
        without = _smallest_M_max(P, Q, angles, in_band, order, None, structure)
        if without <= M_max:
            return (
                f"infeasible: L_max = {L_max} is too tight for M_max = {M_max}. With this L_max "
                f"{remedy}; raise L_max or M_max"
            )
        remedy += f" with L_max = {L_max}, and {without:.6g} without a bound on L"
    return (
        f"infeasible: M_max = {M_max} is too tight for a {structure} filter of order = {order}; "
        f"{remedy}. Raise M_max or the order, or lower the cut-off frequency of Q"
    )


def _examine(coefficients, status, P, Q, omega, Ts, in_band, objective, between):
    L = LearningFilter(coefficients, Ts)

    def sigmas(P, Q, omega):
        response = L.frequency_response(omega)
        M = convergence_matrix(P, Q, response)
        return largest_singular_values(M), largest_singular_values(response)

    sigma_M, sigma_L = sigmas(P, Q, omega)
    steps = np.linspace(0, 1, DENSER, endpoint=False)
    dense = np.append((omega[:-1, None] + np.diff(omega)[:, None] * steps).ravel(), omega[-1])
    return Synthesis(
        L,
        sigma_M[in_band].sum() if objective == "sum" else sigma_M.max(),
        omega,
        sigma_M,
        sigma_L,
        dense,
        *sigmas(*between(dense), dense),
        status,
    )


def _frequency_responses(P, Q, omega, Ts):
    """Samples of P and Q on omega, and a function that gives them anywhere in between."""
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
        P_between = partial(frequency_response, P)
        P = P_between(omega)
    else:
        P = np.asarray(P, dtype=complex)
        P_between = _spline(omega, P)
    if P.shape[:1] != omega.shape or P.ndim != 3 or P.shape[1] != P.shape[2]:
        raise ValueError(f"P has shape {P.shape}, but must be ({len(omega)}, m, m) to fit omega")
    if isinstance(Q, ZeroPhaseButterworth):
        if Q.Ts != Ts:
            raise ValueError(f"Q.Ts = {Q.Ts!r} differs from Ts = {Ts!r}")
        Q, Q_between = Q.frequency_response(omega), Q.frequency_response
    else:
        Q = np.asarray(Q)
        if Q.shape != omega.shape:
            raise ValueError(f"Q has shape {Q.shape}, but must be {omega.shape} to fit omega")
        Q_between = _spline(omega, Q)
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
    return P, Q, omega, lambda w: (P_between(w), Q_between(w))


def _spline(omega, samples):
    return lambda w: CubicSpline(omega, samples)(w)


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
