"""Design a learning filter: all steps from the user's arguments to a filter with a certificate."""

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

LONGEST_REST = 0.1  # largest share of a trial with v = 0 at its end, so that v does not grow there
EQUAL_MULTIPLIERS = 1e-3  # relative: multipliers that differ by less are equal for the solver


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

    Trials follow the law v_{k+1} = Q (v_k + L e_k), where e_k is the error in trial k and v_k is
    the learned signal. From one trial to the next, the remaining error is multiplied by M = Q (I -
    P L). The design makes sigma_max(M) small, and keeps bounds on sigma_max(M) and on the gain
    sigma_max(L). By default L is a regularised inverse B of P, which a formula gives. If B violates
    a bound, convex optimisation finds another filter, by (39) of the paper, or by (45) and (46).

    Parameters
    ----------
    P : model, loop, array_like of shape (n, p, m), or measured response; or a list of them
        The response from v (m learned inputs) to y (p outputs), in closed loop. The frequencies of
        a table are in rad/s, and its phase belongs to exp(j omega t). In a list, the first plant is
        the nominal plant. The bounds hold for all plants of the list.
    Q : ZeroPhaseButterworth, or array_like of shape (n,), optional
        The low-pass filter Q, or its samples on `omega`. Default: a filter of order 2, whose
        cut-off follows from P, see Notes.
    omega : array_like, shape (n,), optional
        Design frequencies, rad/s. Default: the frequencies of the table, or 1000 frequencies up to
        the Nyquist frequency.
    Ts : float, optional
        Sampling period, s. If P is an array and Q is not a filter, `Ts` is needed.
    order : int, optional
        Number of coefficients of the filter that is optimised, at most 300. If L = B K, see `base`,
        these are the coefficients of K. Otherwise these are the coefficients of L, which looks
        ahead by this number of samples, see equation (44) of the paper. Default: from P and Q.
    M_max : float
        Bound on sigma_max(M), in (0, 1).
    L_max : float, None or "auto"
        Bound on sigma_max(L), in units of v per unit of y. None means that there is no bound.
        Default: a multiple of the gain that inverts P, see Notes.
    L_high : (float, float), optional
        A frequency in rad/s, and an additional bound on sigma_max(L) at and above this frequency.
        Trials then learn less noise there, although the cut-off of Q stays the same.
    band : (float, float), optional
        Lowest and highest frequency of the sum in equation (39), rad/s. Default: from the lowest
        frequency above zero to the cut-off of Q.
    reference : array_like, shape (time, m), optional
        The reference of the trials. The spectrum of the error in its first trial then weights the
        sum in (39), in place of the band. The certificate predicts the RMS errors of later trials.
    structure : {"full", "diagonal"}
        With "full", each error acts on all learned inputs. With "diagonal", each error acts only on
        the input of its own channel.
    objective : {"sum", "peak"}
        "sum" minimises the sum (39) of sigma_max(M) for the nominal plant. "peak" minimises the
        largest sigma_max(M) of all plants, (45).
    scale : dict, or array_like of shape (m,) for a square P, optional
        For each output and learned input, by name, the size that counts as one. Signals of these
        sizes then count as equally large. Default: ones.
    uncertainty : float, or array_like of shape (n,), optional
        Radius r around each plant: the bounds hold for all P + Delta with ||Delta|| <= r. If
        `uncertainty` is a single number, the radius is this share of sigma_max(P) at each
        frequency. For example, 0.05 is 5 %.
    everywhere : bool
        Whether the bounds also hold between the frequencies `omega`.
    base : float, None or "auto"
        How the regularised inverse B in L = B K is chosen, see Notes. With None, L is the finite
        filter of the paper. None is the default if `order` is given and P is square.
    reach : int, optional
        Number of samples by which B looks ahead and back at most. If `reach` is passed, B is a
        finite filter. C code, a PLC and trials without reset need a finite filter.

    Returns
    -------
    Synthesis
        The design: ``.law()`` for trials, ``.filter``, ``.rate``, ``.margins``, ``.check(plant)``.

    Warns
    -----
    UserWarning
        One warning for each of the certificate's `warnings`, which name weak points of the design.

    Raises
    ------
    InfeasibleError
        If no filter meets the bounds. The message gives the smallest feasible M_max.
    SolverError
        If the solver fails, or if the certificate shows that its result violates a bound.

    See Also
    --------
    least_gain : the filter of least gain among those of least peak
    convergence : computes how fast trials converge with any filter
    trial_norm : computes how one finite trial, with its two ends, amplifies v

    Notes
    -----
    **P.** A table holds the complex values gain * exp(1j * phase). The gain is not in dB, and the
    phase is in rad. If a table was made for exp(-j omega t), so that its phase leads, pass its
    complex conjugate. The table must describe the sampled plant, including its hold. In
    python-control, the frequency response of a continuous model does not contain the hold, which
    adds a delay of half a sample: sample a continuous model first. A transfer function with more
    than about four poles loses digits: pass ``control.sample_system(control.ss(plant), Ts)``. The
    axes of a labelled array are matched by name, see :mod:`ilctools.labels`. A measured response
    has its own radius, for a probability of 0.99. For another probability, pass both arrays that
    ``P.on(omega, confidence)`` returns. Without a radius, samples count as exact, although they may
    contain noise.

    **Channels.** If P has at least as many learned inputs as outputs, M = Q (I - P L), and the rate
    is the rate of the error. If there are more inputs than outputs, the law learns the smallest v
    that removes the error. If there are fewer learned inputs than outputs, M = Q (I - L P), and the
    rate is the rate of v. The part of the error that the inputs cannot influence then remains. If P
    is square, an input without a scale of its own has the scale of its output. Directions in which
    P has no gain at any frequency are left out.

    **Q.** If Q is not passed, two conditions give the cut-off, see :mod:`.synthesis.cutoff`. The
    least singular value of all plants must exceed a tenth of its value at zero frequency. The
    plants must not differ by more than M_max allows. If a narrow range of frequencies lowers the
    cut-off, the certificate names this range, and the cut-off without the range. If the norm of a
    finite trial, see :func:`trial_norm`, is one or more, the cut-off is halved. The certificate
    then says which ``law(rest=...)`` would make the full cut-off possible. The norm is computed for
    a trial of ten settling times, but at most 1000 samples divided by the number of inputs.

    **Order and gain.** By default, the `order` of a finite L is the delay of P plus 4 / (cutoff
    Ts). The delay is computed from the phase lag in excess of the least lag that the gain of P
    allows. `order` is at least 10. `order` is at most 60, or at most the delay plus 20 if this sum
    is larger. `L_max` is eight times the largest gain that inverts P up to the cut-off of Q.
    `L_max` is also at most 20 times the largest gain that inverts P up to a thirtieth of the
    cut-off. If a share of the error above two thirds of M_max would remain at some frequency, the
    second limit is raised. If `base` is a number or None, `L_max` is four times the largest gain
    that inverts P up to the cut-off. `L_max` also holds between the frequencies of a coarse grid.
    Without `L_max`, filters may have any gain that doubles can represent, see
    :attr:`.Problem.L_bound`. If such a filter looks beyond the ends of a trial, trials often
    diverge: check this with :func:`trial_norm`.

    **All frequencies.** If P and Q are models without a radius, bounds and rate are proved between
    the frequencies. Otherwise cubic splines interpolate the samples, and straight lines interpolate
    the radius. The axis of both interpolations is omega or log omega, whichever predicts every
    other sample better. If P has a radius, `omega` must resolve narrow resonances. Above the last
    sample, P is taken to be zero, with a radius as large as P at this sample. With `everywhere` the
    bounds are kept on a finer grid. The limits on this grid are lower by a fraction of 1e-5 if the
    bounds are proved, and of 3e-4 otherwise. The design then takes three times as long in the
    median, and a hundred times at worst.

    **Base.** B = (P* P + b^2)^-1 P* is the regularised inverse of P. B also inverts poles and zeros
    of P near the unit circle, for which a finite filter is too short. By default B is made for all
    plants, with b = 1 / (2 L_max), so that sigma_max(B) is at most L_max. If L = B meets all
    bounds, the design is L = B. Otherwise, the design is L = B K, and convex optimisation finds the
    filter K. K is also optimised if a `reference` or the objective "peak" is passed. K has 21 or
    `order` coefficients and looks back as far as ahead, and sigma_max(K) is at most four. If `base`
    is a number in (0, 1), b is this share of the largest sigma_max(P) up to the cut-off of Q, and B
    is made for the first plant. If P is a model, B is also exact at the ends of a trial. If P is a
    table, B is a finite filter. This filter has so many samples that more samples would change
    sigma_max(M) by less than 1e-4.

    **Reference.** The spectrum of the first error, (I - P) r, weights the sum in (39). Each channel
    is divided by its `scale`. The first samples of the reference, which P cannot influence because
    of its delay, are never learned and do not count.

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
    """Design with a chosen cut-off of Q.

    If v might grow at the ends of a trial, the cut-off is halved.
    """
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
    """Make the finding that the cut-off is halved because of the ends of a trial.

    The text of the finding contains a remedy.
    """
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
    """Find a `rest`, in samples, with which the norm of a trial is below one.

    Return the rest and this norm.
    """
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
    """Design L = B if L = B is allowed and meets all bounds.

    Otherwise, solve the convex problem.
    """
    if problem.base is None and not problem.square:
        raise needs_square("base = None", problem.p, problem.m)
    design = by_formula(problem) if problem.formula_will_do else None
    return certified(problem) if design is None else design


def by_formula(problem: Problem) -> Synthesis | None:
    """Design L = B, with K = 1.

    Return None if B violates a bound.
    """
    problem, one = replace(problem, order=1), np.eye(problem.channels)
    certificate = check(problem, problem.scaled_filter(one[..., None]))
    beyond = certificate.peaks.get("assumed")
    if certificate.failures or (beyond is not None and beyond.sigma > problem.M_max):
        return None
    return Synthesis(certificate)


def refuse_failures(certificate: Certificate):
    """Raise a SolverError if a claim of a certificate does not hold."""
    if certificate.failures:
        failures = "; ".join(map(str, certificate.failures))
        raise SolverError(f"{failures}.{_remedy(certificate.problem)}")


def _remedy(problem):
    """Return a remedy if the problem has bounds at every frequency.

    Otherwise, return an empty text.
    """
    if not problem.bounds.everywhere:
        return ""
    return (
        " Bounds at every frequency are harder to meet than bounds on omega: take more "
        "frequencies, a shorter filter or a larger M_max, or leave `everywhere` out, and read "
        "in the certificate what then holds."
    )


def warn_of_findings(design: Synthesis) -> Synthesis:
    """Issue a warning for each finding of a design, and return the design."""
    for found in design.certificate.warnings:
        warn(str(found))
    return design


def certified(problem: Problem) -> Synthesis:
    """Solve a problem, and certify its filter.

    The function raises the same errors as :func:`synthesise`.
    """
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
    """Make the error of an infeasible problem, with the least feasible M_max and a remedy."""
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
    """Find the plant and the frequency whose bound has the largest multiplier."""
    size, cuts = np.linalg.matrix_norm(nearest.U), nearest.cuts
    plant, at = 0, tied(size).argmax()
    if cuts is not None:
        of_cuts = np.linalg.matrix_norm(cuts.N)
        if of_cuts.max() * (1 + EQUAL_MULTIPLIERS) >= size.max():
            most = tied(of_cuts).argmax()
            plant, at = cuts.plant[most], cuts.frequency[most]
    return int(plant), float(problem.omega[at])
