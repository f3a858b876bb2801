"""From the problem to a filter with its certificate: the way through the synthesis."""

from dataclasses import replace

import numpy as np

from ilctools import arguments
from ilctools.errors import InfeasibleError, SolverError
from ilctools.evidence.certificate import Certificate, certify, check
from ilctools.evidence.finite import trial_norm
from ilctools.filters import ZeroPhaseButterworth
from ilctools.findings import Finding
from ilctools.problem.defaults import CHOOSE
from ilctools.problem.pose import checked_M_max, needs_square, pose, refuse_singular
from ilctools.problem.problem import Problem
from ilctools.response.door import LOWEST_CUTOFF, response_of
from ilctools.singular_values import tied
from ilctools.synthesis.cutoff import ORDER, choose_cutoff
from ilctools.synthesis.everywhere import solve_everywhere
from ilctools.synthesis.result import Synthesis
from ilctools.synthesis.solver.program import Infeasible
from ilctools.threads import on_one_thread
from ilctools.warn import warn

LONGEST_REST = 0.1  # part of a trial that may be given up at its end, so that v does not grow there
EQUAL_MULTIPLIERS = 1e-3  # relative distance of multipliers that are equal for the solver


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
    """Design a learning filter L for a plant, with a certificate of how fast trials converge.

    Trials follow the law v_{k+1} = Q (v_k + L e_k). Each trial leaves M = Q (I - P L) of the error
    before it. The filter makes sigma_max(M) small, and keeps bounds on sigma_max(M) and on its own
    gain sigma_max(L). By default a formula gives the filter. If that filter breaks a bound, convex
    optimisation finds another one, by (39) of the paper, or by (45) and (46).

    Parameters
    ----------
    P : model, loop, array_like of shape (n, p, m), or measured response; or a list of them
        The response from v (m learned inputs) to y (p outputs), in closed loop. A table is in rad/s
        and for exp(j omega t). In a list the first plant is the nominal one. The bounds hold for
        all plants of the list.
    Q : ZeroPhaseButterworth, or array_like of shape (n,), optional
        The filter, or its samples on `omega`. Default: one of order 2, up to where P reaches.
    omega : array_like, shape (n,), optional
        Design frequencies, rad/s. Default: the frequencies of the table, or 1000 frequencies up to
        the Nyquist frequency.
    Ts : float, optional
        Sampling period, s. Arrays need it.
    order : int, optional
        Samples that L looks ahead (44), or samples of K, at most 300. Default: from P and Q.
    M_max : float
        Bound on sigma_max(M), in (0, 1).
    L_max : float, None or "auto"
        Bound on sigma_max(L), in units of v per unit of y. None is no bound. Default: from the gain
        that inverts P.
    L_high : (float, float), optional
        A frequency in rad/s, and a further bound on sigma_max(L) from there on. Trials then learn
        less noise there, without a lower cut-off of Q.
    band : (float, float), optional
        Lowest and highest frequency of the sum in (39), rad/s. Default: up to Q's cut-off.
    reference : array_like, shape (time, m), optional
        A reference, whose first error weights the sum in place of the band. The certificate then
        predicts its RMS errors.
    structure : {"full", "diagonal"}
        Whether each error acts on all channels, or on its own channel only.
    objective : {"sum", "peak"}
        The sum (39) for the nominal plant, or the peak (45) of all plants.
    scale : dict, or array_like of shape (m,) for a square P, optional
        What counts as equally large, by the names of outputs and learned inputs. Default: ones.
    uncertainty : float, or array_like of shape (n,), optional
        Radius r: the bounds hold for all P + Delta with ||Delta|| <= r. A number is a share of
        sigma_max(P) at each frequency: 0.05 is 5 %.
    everywhere : bool
        Whether the bounds hold at all frequencies, and not on `omega` only.
    base : float, None or "auto"
        B of L = B K. None is the paper's finite L, and the default if `order` is given.
    reach : int, optional
        B as a finite filter of so many samples each way, as C, a PLC and trials without reset need.

    Returns
    -------
    Synthesis
        The design: ``.law()`` for trials, ``.filter``, ``.rate``, ``.margins``, ``.check(plant)``.

    Warns
    -----
    UserWarning
        For each of the certificate's `warnings`, which say what speaks against the design.

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

    Notes
    -----
    **P.** A table holds gain * exp(1j * phase); the gain is not in dB, and the phase is in rad.
    Conjugate a table for exp(-j omega t), whose phase leads. The samples belong to the sampled
    plant with its hold. python-control's data of a continuous model lack the hold, which is half a
    sample of delay: sample the model first. A transfer function with more than some four poles
    loses digits: pass ``control.sample_system(control.ss(plant), Ts)``. A labelled array is matched
    by name, see :mod:`ilctools.labels`. A measured response has a radius of its own, for a
    probability of 0.99. For another probability, pass both parts of ``P.on(omega, confidence)``.
    Without a radius, samples count as exact, although they may contain noise.

    **Channels.** With at least as many learned inputs as outputs, M = Q (I - P L), and the rate is
    the rate of the error. If there are more inputs than outputs, the smallest v is learned. With
    fewer learned inputs than outputs, M = Q (I - L P), and the rate is the rate of v. The part of
    the error that the inputs cannot reach then remains. In a square P an input without a scale of
    its own has the scale of its output. Directions that P never passes are left out.

    **Q.** Without Q, two conditions give the cut-off, see :mod:`.synthesis.cutoff`. The least
    singular value of all plants must exceed a tenth of its value at rest, and the plants must not
    differ by more than M_max allows. If a narrow range of frequencies decides, the certificate
    names the range, and the cut-off without it. If the norm of a trial is one or more, the cut-off
    is halved. The certificate then says which ``law(rest=...)`` makes the full cut-off possible.
    The norm is computed for a trial of ten settling times, or of 1000 samples over all channels.

    **Order and gain.** By default, `order` is the delay of P plus 4 / (cutoff Ts). The delay counts
    beyond the least phase that the gain of P admits. `order` is at least 10. It is at most 60, or
    20 more than the delay. `L_max` is eight times the largest gain that inverts P up to Q's
    cut-off. It is at most 20 times the largest gain that inverts P up to a thirtieth of the
    cut-off, unless this leaves more than two thirds of M_max of the error. If `base` is a number or
    None, `L_max` is four times the gain that inverts P up to the cut-off. `L_max` also holds
    between the frequencies of a coarse grid. Without `L_max`, filters may have any gain that
    doubles can hold, see :attr:`.Problem.L_bound`. If such a filter looks beyond the ends of a
    trial, trials often diverge: ask :func:`trial_norm`.

    **All frequencies.** Bounds and rate are proved between the frequencies if P and Q are models
    without a radius. Otherwise cubic splines run through the samples, and straight lines through
    the radius. They are drawn over omega or over log omega, whichever predicts every other sample
    better. A radius needs an `omega` that resolves narrow resonances. Above the last sample, P is
    zero within a radius as large as P at that sample. With `everywhere` the bounds hold on a finer
    grid, on which they are lower by 1e-5 (proved) or 3e-4. This takes three times as long in the
    median, and a hundred times at worst.

    **Base.** B = (P* P + b^2)^-1 P* inverts poles and zeros of P next to the unit circle, for which
    a finite filter is too short. By default B is made for all plants, with b = 1 / (2 L_max), so
    that sigma_max(B) is at most L_max. If L = B keeps all bounds, the design is L = B. Otherwise,
    and with a `reference` or the objective "peak", convex optimisation finds K. K has 21 samples or
    `order`, as many back as ahead, and a sigma_max(K) of at most four. If `base` is a number in
    (0, 1), b is this share of the largest sigma_max(P) up to Q's cut-off, and B is made for the
    first plant. If P is a model, B is exact at the ends of a trial, too. If P is a table, B has as
    many taps as change sigma_max(M) by less than 1e-4.

    **Reference.** The spectrum of the first error, (I - P) r, weights the sum; channels are divided
    by `scale`. Samples of the reference before P can answer are never learned, and do not count.

    Laws of this form are explained in D. A. Bristow, M. Tharayil and A. G. Alleyne, A survey of
    iterative learning control, IEEE Control Systems Magazine 26 (2006) 96-114.

    Examples
    --------
    >>> import control
    >>> from ilctools import synthesise, zero_phase_butterworth
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)  # a drive
    >>> design = synthesise(P, zero_phase_butterworth(2, 40.0, 0.01))
    >>> rate, margins, gains, *_ = str(design).splitlines()
    >>> print(rate)
    rate at most 0.0072, at all frequencies, proven; largest near 64 rad/s
    >>> for part in [*margins.split(", "), *gains.split("; ")]:
    ...     print(part)
    ...
    margins (one change at a time): gain 100 % lower to 100 % higher
    delay 4.7 samples shorter to 4.7 longer
    time scale 46 % faster to 100 % slower
    any error up to 200 % of sigma_max(P) at the cut-off
    P is 1 at zero frequency
    the cut-off of Q is 40 rad/s
    P has a delay of 1 sample there
    sigma_max(L) is 20
    the norm of a trial of 441 samples is 0.312
    >>> law = design.law()
    """
    if isinstance(base, str):
        arguments.choice("base", base, [CHOOSE])

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
        return warn_of_findings(without_Q(problem, known(None), M_max))
    return warn_of_findings(designed(problem(Q)))


def without_Q(problem_of, response, M_max) -> Synthesis:
    """Design with the chosen cut-off; with half this cut-off if the ends of a trial might grow."""
    refuse_singular(response)
    limit, Ts = choose_cutoff(response, checked_M_max(M_max)), response.Ts
    lowest = max(LOWEST_CUTOFF * np.pi / Ts, response.omega[response.omega > 0][0])

    def lowpass(cutoff):
        return ZeroPhaseButterworth(ORDER, max(float(f"{cutoff:.2g}"), lowest), Ts)

    first = design = designed(problem_of(lowpass(limit.omega)))
    norm = first.certificate.settled_trial.norm
    if norm >= 1:
        design = designed(problem_of(lowpass(limit.omega / 2)))
    cutoff = design.Q.cutoff
    text, costs = f"Q with cut-off {cutoff:.4g} rad/s", []
    if norm >= 1:
        text += f", half of {first.Q.cutoff:.4g} rad/s, with which trial_norm is {norm:.3g}"
        costs.append(_cost_of_ends(first, design))
    text += f", {limit.reason}"
    if limit.decisive:
        text += (
            f"; {limit.decisive} decides, and without that range the cut-off would be "
            f"{limit.without:.2g} rad/s"
        )
    if limit.costly:
        costs.append(Finding("narrow", limit.without, limit.omega, limit.decisive))
    if cutoff == lowest:
        costs.append(Finding("little", cutoff, lowest, limit.reason))
    problem = replace(
        design.problem, defaults_chosen=(text, *design.problem.defaults_chosen), costs=tuple(costs)
    )
    return Synthesis(replace(design.certificate, problem=problem))


def _cost_of_ends(first, half) -> Finding:
    """State the cost of the ends of a trial, which halve the cut-off, and a remedy."""
    samples, norm = first.certificate.settled_trial
    left = half.certificate.settled_trial.norm
    remedy = ""
    if found := _rest_that_mends(first):
        rest, mended = found
        Q = f"zero_phase_butterworth({ORDER}, {first.Q.cutoff:.4g}, {first.Q.Ts:g})"
        remedy = (
            f". With {Q} as Q, and with law(rest={rest}) of that design, trial_norm is {mended:.2g}"
        )
    code, norm = ("ends", left) if left >= 1 else ("halved", norm)
    return Finding(code, norm, half.Q.cutoff, f"of {samples} samples", remedy)


def _rest_that_mends(design) -> tuple[int, float] | None:
    """Find a number of samples at rest for which the norm of a trial is below one, and the norm."""
    problem, certificate = design.problem, design.certificate
    L, samples = certificate.scaled_filter, certificate.settled_trial.samples
    for rest in 2 ** np.arange(1, int(np.log2(samples * LONGEST_REST)) + 1):
        norm = max(
            trial_norm(P, problem.lowpass, L, samples, rest=int(rest))[0]
            for P in problem.response.models
        )
        if norm < 1:
            return int(rest), norm
    return None


def designed(problem: Problem) -> Synthesis:
    """Take L = B by default, if B meets all bounds; else solve the convex problem for K or L."""
    if problem.base is None and not problem.square:
        raise needs_square("base = None", problem.p, problem.m)
    design = by_formula(problem) if problem.formula_will_do else None
    return certified(problem) if design is None else design


def by_formula(problem: Problem) -> Synthesis | None:
    """Design L = B, K = 1; None if B breaks a bound, or if another objective is wanted."""
    if problem.objective.kind != "sum" or problem.objective.band is None:
        return None
    problem, one = replace(problem, order=1), np.eye(problem.channels)
    certificate = check(problem, problem.scaled_filter(one[..., None]))
    beyond = certificate.peaks.get("assumed")
    if certificate.failures or (beyond is not None and beyond.sigma > problem.M_max):
        return None
    return Synthesis(certificate)


def refuse_failures(certificate: Certificate):
    """Raise if a certificate fails."""
    if certificate.failures:
        failures = "; ".join(map(str, certificate.failures))
        raise SolverError(f"{failures}.{_remedy(certificate.problem)}")


def _remedy(problem):
    """State a remedy if bounds at every frequency make a problem hard."""
    if not problem.bounds.everywhere:
        return ""
    return (
        " Bounds at every frequency are harder to meet than bounds on omega: take more "
        "frequencies, a shorter filter or a larger M_max, or leave `everywhere` out, and read "
        "in the certificate what then holds."
    )


def warn_of_findings(design: Synthesis) -> Synthesis:
    """Warn of each finding of a design, and return the design."""
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
    refuse_failures(certificate)
    return Synthesis(certificate)


def _infeasible(problem) -> InfeasibleError:
    """Make the error: what would be feasible, and where the bounds are the main obstacle."""
    posed, nearest = solve_everywhere(problem, nearest=True)
    plant, omega = _obstacle(posed, nearest)
    where = f"plant {plant} at {omega:.4g} rad/s" if problem.robust else f"P at {omega:.4g} rad/s"
    least = np.ceil(1e6 * nearest.largest) / 1e6  # rounded up, so that this M_max is feasible
    longer = "a longer filter" if problem.structure == "full" else "a longer filter, or a full one"
    longer += "" if problem.base is None else ", a larger `reach`, or base=None"
    raised = " or ".join(claim.name for claim in problem.bounds.claims)
    texts = "; ".join(map(str, problem.assumptions))
    return InfeasibleError(
        f"infeasible: no {problem.structure} filter of order = {problem.order} meets "
        f"{' and '.join(map(str, problem.bounds.claims))}, where P has a delay of "
        f"{problem.delay_samples} samples at the cut-off. The smallest feasible M_max is "
        f"{least:.6g}; the main obstacle is {where}. Raise {raised}, take {longer}, lower the "
        "cut-off of Q (without Q, the design chooses it), or design a faster loop. If the "
        "bounds were not meant to be this tight, check the units, signs and the order of the "
        f"channels in each plant.{_remedy(problem)} {texts}",
        nearest.largest,
        plant,
        omega,
    )


def _obstacle(problem, nearest):
    """Find the plant and the frequency with the largest multiplier."""
    size, cuts = np.linalg.norm(nearest.U, axis=(1, 2)), nearest.cuts
    plant, at = 0, tied(size).argmax()
    if cuts is not None:
        of_cuts = np.linalg.norm(cuts.N, axis=(1, 2))
        if of_cuts.max() * (1 + EQUAL_MULTIPLIERS) >= size.max():
            most = tied(of_cuts).argmax()
            plant, at = cuts.plant[most], cuts.frequency[most]
    return int(plant), float(problem.omega[at])
