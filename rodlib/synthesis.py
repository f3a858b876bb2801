"""Synthesis of the learning filter: the convex problems (39), (45) and (46).

The frequency response of the learning filter is linear in its coefficients, and so is

    M = P Q (P^-1 - L) = Q (I - P L),                                                       (40)

because Q is scalar. A bound on the largest singular value of either is a linear matrix
inequality, one per frequency, and the problems are semidefinite programs.

Three modules solve them: :mod:`rodlib.interior_point`, which is fast and the default;
:mod:`rodlib.active_set`, which adds digits to its solution, and is faster still from that of a
similar problem; and :mod:`rodlib.semidefinite`, which states the problems in CVXPY as the paper
does, for reading and for comparison. None of them is trusted: what is returned has a certificate.
"""

from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.interpolate import CubicSpline

from rodlib import active_set, arguments, interior_point
from rodlib.certificate import (
    GAP,
    VIOLATION,
    Certificate,
    convergence_model,
    largest_singular_values,
    learning_model,
    lower_bound,
    peak_gain,
    trial_norm,
)
from rodlib.cones import Infeasible, Solution, formulate
from rodlib.feedback import CurrentTrialLoop, frequency_response
from rodlib.filters import LearningFilter, ZeroPhaseButterworth

DENSER = 10  # the bounds are looked at between the samples, on a grid this much denser
HOPELESS = 1 - 1e-6  # from here on a smallest M_max is one, and raising it no remedy
GOOD = 1e-8  # relative duality gap up to which what the active bounds lead to is accepted
SAME = 1e-9  # relative distance up to which two peaks are the same
CVXPY_TOLERANCES = (1e-5, 1e-6)  # Clarabel ends "almost solved" on these problems


class InfeasibleError(ValueError):
    """No learning filter of the given order and structure meets the bounds.

    Attributes
    ----------
    smallest_M_max : float
        What is feasible with the other arguments; from one on, nothing that converges.
    """

    def __init__(self, message: str, smallest_M_max: float):
        super().__init__(message)
        self.smallest_M_max = smallest_M_max


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
    solution : Solution
        What the solver said. It is not relied on. ``synthesise(..., start=design)`` begins there.
    """

    filter: LearningFilter
    value: float
    certificate: Certificate
    omega: np.ndarray
    sigma_M: np.ndarray
    sigma_L: np.ndarray
    solution: Solution

    def __repr__(self):
        return f"{self.solution.method}, {self.solution.iterations} iterations\n{self.certificate}"


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
    samples=None,
    rest=0,
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
        Bound on sigma_max(L), unit of w per unit of y. None leaves it out: filters then compete up
        to the gain that coefficients in doubles can hold, :func:`rodlib.certificate.weight_of_L`.
    band : (float, float)
        Lowest and highest frequency of the sum in (39), rad/s.
    structure : {"diagonal", "full"}
    objective : {"sum", "peak"}
        "sum" is (39); "peak" is (45), with (46) unless `L_max` is None.
    solver : {"structured", "cvxpy"}
        :mod:`rodlib.interior_point`, or the problem as the paper states it, in CVXPY.
    start : Synthesis, optional
        A design for other bounds, another band or a similar plant to start from, of the same order
        and size. It makes the synthesis faster, not different.
    samples : int, optional
        Length of a trial. The certificate then says what one trial does to the ILC signal, by
        :func:`rodlib.certificate.trial_norm`; P and Q must be models.
    rest : int
        Number of samples at the end of that trial in which v is held at zero.
    check : bool
        Whether a filter whose certificate fails raises.

    Returns
    -------
    Synthesis
        With its certificate. What it says about all frequencies is proven if P and Q are models.
        From arrays it is read off splines between the first and the last frequency, on a grid ten
        times denser; the certificate warns if the samples are too coarse for that.

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
    model = (P.P if isinstance(P, CurrentTrialLoop) else P, Q)
    if not (
        isinstance(model[0], control.StateSpace) and isinstance(model[1], ZeroPhaseButterworth)
    ):
        model = None
    Ts = arguments.sampling_period("Ts", Ts)
    P, Q, omega = _frequency_responses(P, Q, omega, Ts)
    order = arguments.whole("order", order, 1, len(omega))
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", M_max, what, 0, 1)
    if L_max is not None:
        L_max = arguments.positive("L_max", L_max, "a positive number, or None for no bound")
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    arguments.choice("solver", solver, ["structured", "cvxpy"])
    arguments.flag("check", check)
    in_band = _check_band(Q, omega, band, objective)
    if start is not None:
        _check_start(start, P, order, structure)
    if samples is not None:
        samples = arguments.whole("samples", samples, 2)
        if model is None:
            raise ValueError(
                f"samples = {samples} asks for the norm of a trial, which needs P and Q as models"
            )
    rest = arguments.whole("rest", rest, 0, (samples or 1) - 1)
    statement = {
        "order": order, "M_max": M_max, "L_max": L_max, "band_mask": in_band,
        "structure": structure, "objective": objective,
    }  # fmt: skip

    data = (P, Q, omega, Ts)
    tolerances = CVXPY_TOLERANCES if solver == "cvxpy" else (GAP, VIOLATION)

    def solve(**changes):
        return _solve(solver, data, statement | changes)

    def judged(solution):
        return _judged(solution, data, statement, model, (samples, rest), tolerances)

    def along_bounds(solution, steps):
        """The design to which the active bounds lead from a solution, if it is a good one."""
        found = active_set.resolve(formulate(*data, **statement), solution, steps)
        if found is not None:
            design = judged(found)
            if design.certificate.gap < GOOD and not design.certificate.failures:
                return design
        return None

    structured = solver == "structured"
    if structured and start is not None and (design := along_bounds(start.solution, steps=12)):
        return design
    try:
        solution = solve()
        if structured and (design := along_bounds(solution, steps=3)):  # more digits
            found = design.solution
            iterations = solution.iterations + found.iterations
            finished = replace(found, method=solution.method, iterations=iterations)
            return replace(design, solution=finished)
    except Infeasible as error:
        smallest = error.smallest_M_max
        raise InfeasibleError(_advice(statement, smallest, solve), smallest) from None
    design = judged(solution)
    if check and design.certificate.failures:
        failures = "; ".join(design.certificate.failures)
        raise SolverError(f"{solution.method}: {failures}")
    return design


def least_gain(P, Q, omega, Ts, **choices) -> Synthesis:
    """Design the one filter of (45) that has a rule: of least gain among those of least peak.

    Without (46) the least peak of sigma_max(M) may be reached by many filters, whose gains differ
    by orders of magnitude; which of them a solver returns is its own affair. This is the one with
    the least max sigma_max(L) that keeps the least peak to a relative 1e-9.

    Parameters
    ----------
    P, Q, omega, Ts, **choices
        As for :func:`synthesise`, apart from `objective`, `L_max` and `start`.

    Returns
    -------
    Synthesis
        Of (45) with (46), where `certificate.L_max` is that gain.

    Raises
    ------
    ValueError, InfeasibleError, SolverError
        As :func:`synthesise`.
    """
    without_trial = choices | {"samples": None, "rest": 0}
    free = synthesise(P, Q, omega, Ts, objective="peak", L_max=None, **without_trial)
    known, unit = free.certificate, free.sigma_L.max()  # a gain that is enough
    statement = {
        "order": known.order, "structure": known.structure, "objective": "gain", "L_max": unit,
        "M_max": free.value * (1 + SAME), "band_mask": None,
    }  # fmt: skip
    data = (*_frequency_responses(P, Q, omega, Ts), Ts)
    L_max = unit * _solve("structured", data, statement).peak
    return synthesise(P, Q, omega, Ts, objective="peak", L_max=L_max, **choices)


def _judged(solution, data, statement, model, trial, tolerances):
    """What the solver found, with its certificate."""
    P, Q, omega, Ts = data
    samples, rest = trial
    in_band = statement["band_mask"]
    L = LearningFilter(solution.coefficients, Ts)
    sigma_M, sigma_L = _sigmas(P, Q, L, omega)
    if statement["objective"] == "sum":
        value, idle = sigma_M[in_band].sum(), np.abs(Q)[in_band].sum()
    else:
        value, idle = sigma_M.max(), np.abs(Q).max()
    if model:
        all_M, place = peak_gain(convergence_model(*model, L))
        missed = np.nan
    else:
        all_M, place, missed = _peak_between(*data, L)
    certificate = Certificate(
        structure=statement["structure"],
        order=statement["order"],
        value=value,
        lower_bound=lower_bound(P, Q, omega * Ts, solution.U, solution.V, **statement),
        idle=idle,
        M_max=statement["M_max"],
        L_max=statement["L_max"],
        grid_M=sigma_M.max(),
        grid_L=sigma_L.max(),
        all_M=all_M,
        all_L=peak_gain(learning_model(L))[0],
        place=place,
        sampled=(omega[0], omega[-1]),
        nyquist=np.pi / Ts,
        proven=model is not None,
        missed=missed,
        tolerances=tolerances,
        trial=np.nan if samples is None else trial_norm(*model, L, samples, rest=rest)[0],
        samples=samples,
        rest=rest,
    )
    return Synthesis(L, value, certificate, omega, sigma_M, sigma_L, solution)


def _solve(solver, samples, statement):
    try:
        if solver == "structured":
            return interior_point.solve(formulate(*samples, **statement))
        from rodlib import semidefinite  # here, because CVXPY takes long to import

        return semidefinite.solve(*samples, **statement)
    except Infeasible:
        raise
    except RuntimeError as error:
        raise SolverError(f"{solver}: {error}") from None


def _sigmas(P, Q, L, omega):
    response = L.frequency_response(omega)
    M = convergence_matrix(P, Q, response)
    return largest_singular_values(M), largest_singular_values(response)


def _peak_between(P, Q, omega, Ts, L):
    """Peak of sigma_max(M) estimated between samples, its frequency, and what the splines miss.

    Measured grids are linear or logarithmic, plants smooth over one or the other. So the splines
    run over omega or log omega, whichever foretells samples that are left out better.
    """
    steps = np.linspace(0, 1, DENSER, endpoint=False)
    dense = np.append((omega[:-1, None] + np.diff(omega)[:, None] * steps).ravel(), omega[-1])
    response = L.frequency_response(omega)
    M = convergence_matrix(P, Q, response)
    missed = {}
    for scale in (np.asarray, np.log) if omega[0] > 0 else (np.asarray,):
        missed[scale] = 0.0 if len(omega) > 3 else np.inf
        for first in (1, 2):  # every other sample between the two at the ends
            out = np.arange(first, len(omega) - 1, 2)
            rest = np.delete(np.arange(len(omega)), out)
            foretold = _splined(P[rest], Q[rest], omega[rest], response[out], omega[out], scale)
            miss = largest_singular_values(foretold - M[out]).max(initial=0)
            missed[scale] = max(missed[scale], miss)
    scale = min(missed, key=missed.get)
    sigma = largest_singular_values(
        _splined(P, Q, omega, L.frequency_response(dense), dense, scale)
    )
    return sigma.max(), dense[sigma.argmax()], missed[scale]


def _splined(P, Q, omega, response, places, scale):
    """M of (40) at other frequencies than those of P and Q, where L has this response."""
    P, Q = (CubicSpline(scale(omega), samples)(scale(places)) for samples in (P, Q))
    return convergence_matrix(P, Q, response)


def _advice(statement, smallest, solve):
    """Which bound is too tight, and what would be feasible."""
    M_max, L_max = statement["M_max"], statement["L_max"]
    structure, order = statement["structure"], statement["order"]
    remedy = f"the smallest feasible M_max is {smallest:.6g}"
    raised = "raise M_max" if smallest < HOPELESS else "no M_max below 1 will do, so"
    if L_max is not None:
        without = solve(L_max=None, M_max=np.inf, objective="peak").peak
        if without <= M_max:
            return (
                f"infeasible: L_max = {L_max} is too tight for M_max = {M_max}. With this L_max "
                f"{remedy}: {raised}{' or' if smallest < HOPELESS else ''} raise L_max"
            )
        remedy += f" with L_max = {L_max}, and {without:.6g} without a bound on L"
    longer = "a longer filter" + ("" if structure == "full" else ", or a full one")
    return (
        f"infeasible: M_max = {M_max} is too tight for a {structure} filter of order = {order}; "
        f"{remedy}: {raised}{',' if smallest < HOPELESS else ''} take {longer}, lower the cut-off "
        "of Q, or design a faster loop"
    )


def _frequency_responses(P, Q, omega, Ts):
    """Samples of P and Q on omega, checked."""
    omega = arguments.array("omega", omega, ("frequency",))
    if len(omega) < 2 or not np.all(np.diff(omega) > 0):
        raise ValueError(f"omega, of shape {omega.shape}, must be a row of increasing frequencies")
    nyquist = np.pi / Ts
    if omega[0] < 0 or omega[-1] > nyquist * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega[0]:.6g}, {omega[-1]:.6g}] rad/s, but must lie in "
            f"[0, {nyquist:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    P = P.P if isinstance(P, CurrentTrialLoop) else P
    if isinstance(P, control.StateSpace):
        arguments.state_space("P", P)
        if P.dt != Ts:
            raise ValueError(f"P.dt = {P.dt!r} differs from Ts = {Ts!r}: sample the model at Ts")
        radius = np.abs(P.poles()).max(initial=0)
        if radius >= 1:
            raise ValueError(f"P is unstable: it has a pole of modulus {radius:.6g}, 1 or more")
        P = frequency_response(P, omega)
    P = arguments.array("P", P, (len(omega), "m", "m"), complex)
    if isinstance(Q, ZeroPhaseButterworth):
        arguments.one_period(P=Ts, Q=Q.Ts)
        Q = Q.frequency_response(omega)
    Q = arguments.array("Q", Q, (len(omega),), complex)
    Q = Q if Q.imag.any() else Q.real
    singular_values = np.linalg.svd(P, compute_uv=False)
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if singular.size:
        raise ValueError(
            f"P is singular at omega = {omega[singular[0]]:.6g} rad/s (smallest singular value "
            f"{singular_values[singular[0], -1]:.3g}): P^-1 in (40) does not exist there"
        )
    return P, Q, omega


def _check_band(Q, omega, band, objective):
    """Which frequencies lie in the band; there must be some, and something to learn."""
    low, high = arguments.array("band", band, (2,))
    slack = 1e-9 * omega[-1]
    if not omega[0] - slack <= low < high <= omega[-1] + slack:
        raise ValueError(
            f"band = {band!r} must be two increasing frequencies within omega, "
            f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
        )
    in_band = (omega >= low) & (omega <= high)
    if not in_band.any():
        raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    learned = np.abs(Q[in_band] if objective == "sum" else Q).max()
    if learned < 1e-6:  # of an error, which the certificate could not tell from nothing
        raise ValueError(
            f"Q has a gain of {learned:.3g} at most where the objective counts: it learns nothing"
        )
    return in_band


def _check_start(start, P, order, structure):
    arguments.instance("start", start, Synthesis)
    n, m, _ = P.shape
    expected, found = (m, m, order), start.solution.coefficients.shape
    if found != expected or len(start.solution.U) != n:
        raise ValueError(
            f"start is a design with coefficients of shape {found} on {len(start.solution.U)} "
            f"frequencies, but must have {expected} on {n}: leave start out"
        )
    if structure == "diagonal" and np.any(start.solution.coefficients[~np.eye(m, dtype=bool)]):
        raise ValueError("start is a full filter, but structure = 'diagonal': leave start out")
