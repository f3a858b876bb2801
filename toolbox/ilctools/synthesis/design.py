"""From the problem to a filter with its certificate: the way through the synthesis."""

from dataclasses import replace

import numpy as np

from ilctools import arguments
from ilctools.base import in_units
from ilctools.errors import InfeasibleError, SolverError
from ilctools.evidence.certificate import Certificate, certify, check
from ilctools.evidence.finite import trial_norm
from ilctools.filters import ZeroPhaseButterworth
from ilctools.findings import Finding
from ilctools.problem.defaults import CHOOSE
from ilctools.problem.pose import checked_M_max, pose, refuse_singular
from ilctools.problem.problem import Problem, Solution
from ilctools.response.door import LOWEST, response_of
from ilctools.singular_values import largest_singular_values, tied
from ilctools.synthesis.cutoff import ORDER, reached
from ilctools.synthesis.everywhere import solve_everywhere
from ilctools.synthesis.result import Synthesis
from ilctools.synthesis.solver.program import Infeasible
from ilctools.threads import on_one_thread
from ilctools.warn import warn

LONGEST_REST = 0.1  # of a trial: what may be given up at its end so that it does not grow
EQUAL = 1e-3  # relative distance of multipliers that are the same for the solver


@on_one_thread
def synthesise(
    P,
    Q=None,
    omega=None,
    Ts=None,
    *,
    order=None,
    M_max=0.9,
    L_max: float | str | None = CHOOSE,
    L_high: tuple[float, float] | None = None,
    band=None,
    reference=None,
    structure="full",
    objective="sum",
    scale=None,
    uncertainty=None,
    everywhere=False,
    base: float | str | None = CHOOSE,
    reach=None,
) -> Synthesis:
    """Design a learning filter for a plant, with a certificate of how fast trials converge.

    Of the law v_{k+1} = Q (v_k + L e_k) this is L: it minimises what a trial leaves of the error
    before, sigma_max(M) with M = Q (I - P L), within bounds on that and on the gain of L. By a
    formula, where that keeps the bounds, else by convex optimisation, (39) or (45) with (46) of
    the paper. Such laws are explained in D. A. Bristow, M. Tharayil and A. G. Alleyne, A survey
    of iterative learning control, IEEE Control Systems Magazine 26 (2006) 96-114.

    Defaults are for a plant that one does not know, and the certificate says what they are for this
    one. Above Q's cut-off L only has to keep its bounds; how much noise it adds to v there,
    trials with noise say (:func:`run_trials`).

    Parameters
    ----------
    P : array_like, shape (n, m, m), a model, CurrentTrialLoop, or a list of these; or measured
        Frequency response of the closed loop on `omega`, for any m: gain * exp(1j * phase), the
        gain not in dB, the phase in rad; also as python-control's frequency response data, of exp(j
        omega t): one of exp(-j omega t), whose phase leads, is to be conjugated first; or a
        discrete-time model of it, state space or transfer function; of more than some four poles
        sample the state space, ``control.sample_system(control.ss(plant), Ts)``, as coefficients
        lose digits. Of a list the first is the
        nominal plant, whose convergence is made fast; the bounds hold for all of them. What
        :func:`measured_response` returns has its radius, in which the truth lies with a probability
        of 0.99; for another, pass both of ``P.on(omega, confidence)`` as P and `uncertainty`.
        A DataArray with the dimensions frequency, output and input is matched by name, as are
        labelled Q, `uncertainty`, `scale` and `reference`, see :mod:`ilctools.labels`.
        Samples are of what is sampled, with the hold, which python-control's data of a continuous
        model lack, half a sample of delay: sample that first. Above the last frequency of samples,
        P is taken for zero with a radius, its size there.
    Q : array_like, shape (n,), or ZeroPhaseButterworth, optional
        Frequency response of the Q-filter on `omega`, or the filter. Default: one of order 2 up to
        where P reaches: the least singular value of all plants is a tenth of what it is at rest
        there, or the plants differ as much as M_max allows, see :mod:`.synthesis.cutoff`. If a
        narrow range of frequencies decides, the certificate names it, and the cut-off without it.
        If the norm of a trial of ten times the settling time, or of 1000 samples over all channels,
        is one or more, half of that cut-off; the certificate then says by how many samples of rest
        at the end of a trial, ``law(rest=...)``, the full cut-off can be had.
    omega : array_like, shape (n,), optional
        Design frequencies, rad/s, increasing, up to the Nyquist frequency pi / Ts. Default: those
        of python-control's frequency response data, or the labels of P, Q or `uncertainty`; of
        models and measured responses 1000 of them, from a thousandth of Q's cut-off on. Of an
        estimate from records they begin where one period fits into the longest record.
    Ts : float, optional
        Sampling period, s; for arrays, of which none knows it.
    order : int, optional
        Number of samples n_L that the learning filter looks ahead (44); or of K, see `base`.
        Default: the samples by
        which P lags beyond the least phase that its gain admits, and 4 / (cutoff Ts); at least 10,
        and at most 60 or 20 beyond that lag. 300 at most: the time grows as its cube.
    M_max : float
        Bound on sigma_max(M), in (0, 1): the slowest convergence tolerated.
    L_max : float, None or "auto"
        Bound on sigma_max(L), unit of w per unit of y. Default: eight times the largest gain that
        inverts P up to Q's cut-off, 1 / sigma_min(P), and at most 20 times the largest that inverts
        P up to a thirtieth of the cut-off, unless that left more than two thirds of M_max of the
        error. If `base` is a number or None, it is four times the gain that inverts P up to Q's
        cut-off, rounded up to one digit. It holds between the frequencies of a coarse grid, and up
        to the Nyquist frequency, too. None leaves it out: filters then compete up to the gain that
        coefficients in doubles can hold, :attr:`.Problem.L_bound`, and where they look beyond the
        ends of a trial, trials often diverge: ask :func:`trial_norm`.
    L_high : (float, float), optional
        A frequency, rad/s, and a further bound on sigma_max(L) from there on: L then learns less
        noise there, without a lower cut-off of Q.
    band : (float, float), optional
        Lowest and highest frequency of the sum in (39), rad/s. A peak has none. Default: from the
        lowest of `omega` to Q's cut-off.
    reference : array_like, shape (time, m), optional
        In the place of the band: the reference of a trial, in the outputs' units, labelled ones
        matched by name. The sum is then weighted by the spectrum of the first trial's error,
        |(I - P) r| of the channels divided by `scale`, and the certificate predicts the RMS of the
        error of this reference, far from the ends of a trial: what it asks for in the first
        samples, before P answers, is never learned, and not counted.
    structure : {"full", "diagonal"}
        Whether each error acts on all channels, or on its own only.
    objective : {"sum", "peak"}
        "sum" is (39), for the nominal plant; "peak" is (45), with (46) unless `L_max` is None: the
        largest over all plants.
    scale : array_like, shape (m,), optional
        What counts as equally large in each channel. Singular values, `L_max` and the certificate
        are then those of the channels divided by it, so that units do not matter. Default: ones;
        pass it where one unit of a channel is much less than one of another, or the filter is made
        for the largest number alone.
    uncertainty : array_like, shape (n,), or float, optional
        Radius at each frequency: the bounds hold for each P + Delta with ||Delta|| <= radius, of
        the channels in units of `scale`, by a condition that is exact. One number is relative to
        sigma_max(P) of the first plant at each frequency: 0.05 is 5 %. Between them it runs
        straight: pass `omega` that resolves narrow resonances. Without it samples count as
        exact, noise and all: what is promised holds for them, not for the plant.
    everywhere : bool
        Whether the bounds hold at every frequency, not on `omega` only, for all plants: of models
        without a radius by a grid that proves it, on which they are lower by 1e-5; else from the
        first to the last of `omega`, on a dense grid, on which they are lower by 3e-4, where cubic
        splines run through samples, within what they may miss, and straight lines through the
        radius, both over omega or log omega, whichever predicts every other sample better. The sum
        is that over `omega`. It takes three times as long in the median, at worst a hundred times.
    base : float, None or "auto"
        L = B K with B = (P* P + b^2)^-1 P*, the operator of :class:`NormOptimal`. It undoes poles
        and zeros of P next to the unit circle, for which a finite filter is too short. None is the
        paper's L, and the default if `order` is given. A number in (0, 1) is b in units of the
        largest sigma_max(P) up to Q's cut-off; of a list, B is then that of the first plant. The
        default is b = 1 / (2 L_max), with which sigma_max(B) is L_max at most, of all plants of a
        list, see :mod:`ilctools.base`: L = B itself, where all bounds hold for it, without a
        search. Else, and for a `reference` or the objective "peak", the convex problem decides K,
        of `order` samples, 21 if that is not given, as many back as ahead, with a sigma_max(K) of
        four at most. Of a diagonal filter B is that of P_ii.
    reach : int, optional
        B as a finite filter, of so many samples at most each way, as C, a PLC and trials without
        reset need it; without B, as if `order` is given, it does not count. Default: of a model, B
        with the ends of a trial; of samples, as many as change sigma_max(M) by less than 1e-4.

    Returns
    -------
    Synthesis
        With its certificate. What it says about all frequencies is proven if P and Q are models
        without a radius. Else it is read off splines and a radius that is interpolated, between
        the first and the last frequency, see `everywhere`.

    Warns
    -----
    UserWarning
        For each of the certificate's `warnings`: bounds passed between the frequencies by a quarter
        of 1 - M_max, or samples that admit a sigma_max(M) larger by a quarter of what is left to
        one there, a filter that leaves nearly all of the error, a Q that no filter can make up for
        where P is not known. Of a Q that is left out: a narrow range of frequencies that lowers its
        cut-off to a half or less; a cut-off that is halved for the ends of a trial. Samples that
        scatter as noise does are not noticed: without `uncertainty` they count as exact. A table
        also warns if it ends where one in Hz does, just below 1 / (2 Ts), or if it begins at minus
        one, see :mod:`.problem.plausible`.

    Raises
    ------
    InfeasibleError
        If no filter meets the bounds; the message says which M_max would be feasible.
    SolverError
        If the solver fails, or the certificate of its result does.

    See Also
    --------
    least_gain : the filter of least gain among those of least peak
    convergence : what another filter does
    trial_norm : what one trial, with its two ends, does to v

    Examples
    --------
    >>> import control
    >>> from ilctools import synthesise, zero_phase_butterworth
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> design = synthesise(P, zero_phase_butterworth(2, 40.0, 0.01))
    >>> round(float(design.sigma_M.max()), 2), design.problem.order
    (0.01, 1)
    >>> law = design.law()
    """
    if isinstance(base, str):
        arguments.choice("base", base, [CHOOSE])
        base = CHOOSE if order is None else None

    def known(Q):
        return response_of(P, omega, Ts, uncertainty, scale, Q)

    def problem(Q):
        return pose(
            known(Q),
            Q,
            order=order,
            M_max=M_max,
            L_max=L_max,
            L_high=L_high,
            band=band,
            reference=reference,
            structure=structure,
            objective=objective,
            everywhere=everywhere,
            base=base,
            reach=reach,
        )

    if Q is None:
        return warned(without_Q(problem, known(None), M_max))
    return warned(designed(problem(Q)))


def without_Q(problem_of, response, M_max) -> Synthesis:
    """The design with the cut-off that P admits; with half of it, if a trial's ends might grow."""
    refuse_singular(response)
    limit, Ts = reached(response, checked_M_max(M_max)), response.Ts
    lowest = max(LOWEST * np.pi / Ts, response.omega[response.omega > 0][0])

    def lowpass(cutoff):
        return ZeroPhaseButterworth(ORDER, max(float(f"{cutoff:.2g}"), lowest), Ts)

    first = design = designed(problem_of(lowpass(limit.omega)))
    _, norm = first.certificate.trial
    if norm >= 1:
        design = designed(problem_of(lowpass(limit.omega / 2)))
    cutoff = design.Q.cutoff
    text, costs = f"Q with cut-off {cutoff:.4g} rad/s", []
    if norm >= 1:
        text += f", half of {first.Q.cutoff:.4g} rad/s, where the norm of a trial is {norm:.3g}"
        costs.append(_cost_of_ends(first, design))
    text += f", {limit.reason}"
    if limit.decisive:
        text += f": {limit.decisive} decides, without it {limit.without:.2g} rad/s"
    if limit.costly:
        costs.append(Finding("narrow", limit.without, limit.omega, limit.decisive))
    if cutoff == lowest:
        costs.append(Finding("little", cutoff, lowest, limit.reason))
    problem = replace(design.problem, chosen=(text, *design.problem.chosen), costs=tuple(costs))
    certificate = replace(design.certificate, problem=problem)
    return replace(design, problem=problem, certificate=certificate)


def _cost_of_ends(first, half) -> Finding:
    """What the ends of a trial cost where they halve the cut-off, and what would mend them."""
    samples, norm = first.certificate.trial
    _, left = half.certificate.trial
    remedy = ""
    if found := _rest_that_mends(first):
        rest, mended = found
        Q = f"zero_phase_butterworth({ORDER}, {first.Q.cutoff:.4g}, {first.Q.Ts:g})"
        remedy = f". With {Q} as Q and law(rest={rest}) of that design, the norm is {mended:.2g}"
    code, norm = ("ends", left) if left >= 1 else ("halved", norm)
    return Finding(code, norm, half.Q.cutoff, f"of {samples} samples", remedy)


def _rest_that_mends(design) -> tuple[int, float] | None:
    """A number of samples at rest that takes the norm of a trial below one, and that norm."""
    problem, certificate = design.problem, design.certificate
    L, (samples, _) = certificate.scaled_filter, certificate.trial
    for rest in 2 ** np.arange(1, int(np.log2(samples * LONGEST_REST)) + 1):
        norm = max(
            trial_norm(P, problem.lowpass, L, samples, rest=int(rest))[0]
            for P in problem.response.models
        )
        if norm < 1:
            return int(rest), norm
    return None


def designed(problem: Problem) -> Synthesis:
    """L = B by default, if all bounds hold for it; else K, or L, by the convex problem."""
    design = direct(problem) if problem.formula_will_do else None
    return certified(problem) if design is None else design


def direct(problem: Problem) -> Synthesis | None:
    """L = B, K = 1, if all bounds hold for it and it is asked for nothing else."""
    if problem.objective.kind != "sum" or problem.objective.band is None:
        return None
    problem, one = replace(problem, order=1), np.eye(problem.channels)
    zero = np.zeros((len(problem.omega), *one.shape))
    solution = Solution(one[..., None], zero, zero, largest=np.nan)
    certificate = check(problem, problem.scaled_filter(solution.coefficients))
    beyond = certificate.peaks.get("assumed")
    if certificate.failures or (beyond is not None and beyond.sigma > problem.M_max):
        return None
    return result(problem, solution, certificate)


def insist(certificate: Certificate):
    """Raise if a certificate fails."""
    if certificate.failures:
        failures = "; ".join(map(str, certificate.failures))
        raise SolverError(f"{failures}.{_remedy(certificate.problem)}")


def _remedy(problem):
    """What to do where bounds at every frequency make a problem hard."""
    if not problem.bounds.everywhere:
        return ""
    return (
        " Bounds at every frequency are harder than on omega: take more frequencies, a shorter "
        "filter or a larger M_max, or leave `everywhere` out: the certificate says what holds then."
    )


def warned(design: Synthesis) -> Synthesis:
    """A design for whoever called the caller, with a warning for each of its findings."""
    for found in design.certificate.warnings:
        warn(str(found))
    return design


def certified(problem: Problem) -> Synthesis:
    """Solve a problem, and certify the filter; arguments and errors of :func:`synthesise`."""
    try:
        grid, solution = solve_everywhere(problem)
    except Infeasible:
        raise _infeasible(problem) from None
    except RuntimeError as error:
        raise SolverError(f"{error}.{_remedy(problem)}") from None
    certificate = certify(problem, grid, solution)
    insist(certificate)
    return result(problem, solution, certificate)


def result(problem, solution, certificate) -> Synthesis:
    """What a solution is, with its certificate."""
    L = problem.L(solution)
    return Synthesis(
        in_units(certificate.scaled_filter, problem.scale),
        problem,
        certificate,
        largest_singular_values(problem.M(L)),
        largest_singular_values(L),
        solution,
    )


def _infeasible(problem) -> InfeasibleError:
    """The error that says what would be feasible, and where the bounds are most in the way."""
    posed, nearest = solve_everywhere(problem, nearest=True)
    plant, omega = _obstacle(posed, nearest)
    where = f"plant {plant} at {omega:.4g} rad/s" if problem.robust else f"{omega:.4g} rad/s"
    least = np.ceil(1e6 * nearest.largest) / 1e6  # who follows the advice is not refused again
    longer = "a longer filter" if problem.structure == "full" else "a longer filter, or a full one"
    longer += "" if problem.base is None else ", a larger `reach`, or none of B (pass its order)"
    raised = " or ".join(claim.name for claim in problem.bounds.claims)
    texts = "; ".join(problem.assumptions)
    return InfeasibleError(
        f"infeasible: {' and '.join(map(str, problem.bounds.claims))} are too tight for a "
        f"{problem.structure} filter of order = {problem.order} (P lags by "
        f"{problem.delay} samples at the cut-off); the smallest feasible M_max is {least:.6g} "
        f"(most in the way: {where}): raise {raised}, take {longer}, lower the cut-off of Q "
        "(without Q, it is chosen), or design a faster loop. If no bound so tight was meant: are "
        "units, signs and the order of the channels right, in each plant?"
        f"{_remedy(problem)} {texts}",
        nearest.largest,
        plant,
        omega,
    )


def _obstacle(problem, nearest):
    """The plant and the frequency with the largest multiplier."""
    count, cuts = len(problem.omega), nearest.cuts
    plant, at, size = np.zeros(count, int), np.arange(count), np.linalg.norm(nearest.U, axis=(1, 2))
    if cuts is not None:  # equal ones first
        of_cuts = (1 + EQUAL) * np.linalg.norm(cuts.N, axis=(1, 2))
        plant, at = np.append(cuts.plant, plant), np.append(cuts.frequency, at)
        size = np.append(of_cuts, size)
    most = tied(size).argmax()
    return int(plant[most]), float(problem.omega[at[most]])
