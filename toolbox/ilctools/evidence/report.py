"""The printed text of a certificate, whose values :mod:`.evidence.certificate` computes."""

import numpy as np

from ilctools.evidence.peak import BELOW, DEAF, PEAK_TOLERANCE
from ilctools.problem.plausible import at_rest_in_words
from ilctools.problem.problem import K_MAX
from ilctools.problem.reference import unreachable_rms
from ilctools.response.samples import Assumed
from ilctools.singular_values import TIED

PREDICTED_TRIALS = (1, 2, 3, 5, 10)  # trials whose RMS error is printed if there is a reference


def printed(certificate) -> str:
    """Return the printed text of a certificate: rate, margins, gains, limits and warnings."""
    return "\n".join(_lines(certificate))


def _lines(certificate):
    """Yield the lines of the printed text."""
    assumptions = certificate.problem.assumptions
    known = [line for line in assumptions if not isinstance(line, Assumed)]
    yield _rate(certificate)
    if certificate.rate <= 1 + PEAK_TOLERANCE:
        yield repr(certificate.margins)
    yield "; ".join(_gains(certificate))
    yield from _unequal(certificate)
    yield "; ".join([_limits(certificate), *_mean(certificate)])
    yield from _deaf(certificate)
    yield from known
    yield from _below(certificate)
    if len(known) < len(assumptions):
        yield "assumptions: see .certificate.details"
    yield from _against(certificate)


def details(certificate) -> str:
    """Return the text of :attr:`.Certificate.details`: a table of all peaks and bounds."""
    problem, bounds = certificate.problem, certificate.problem.bounds
    table = [(claim.limit, claim.name) for claim in bounds.on("M")]
    for how, peak in certificate.peaks.items():
        table.append((peak.sigma, f"sigma_max(M), {how}, {certificate.place(peak)}"))
    for claim in bounds.on("L"):
        table += [
            (claim.limit, claim.name),
            (certificate.on_grid(claim), f"{claim.what}, on the grid"),
            (certificate.anywhere(claim), f"{claim.what}, at all frequencies"),
        ]
    if not bounds.on("L"):
        table.append((certificate.all_L, "sigma_max(L), at all frequencies, without a bound"))
    table += [
        (certificate.value, "objective"),
        (certificate.lower_bound, "lower bound of the objective"),
    ]
    lines = [f"{value:<11.5g}{what}" for value, what in table]
    lines += [*_mean(certificate), *map(str, problem.assumptions), *_against(certificate)]
    return "\n".join(lines)


def _rate(certificate):
    """Return the line with the rate, the frequency of the rate, and the plants of this rate."""
    problem, peak = certificate.problem, certificate.highest_peak
    near = certificate.problem_on_grid.omega[certificate.worst.sigma >= 0.99 * peak.sigma]
    at = np.append(near, peak.omega).min()
    span = _span(problem.omega)
    where = ", proven" if certificate.proven else f" {span}, estimated"
    if BELOW in certificate.peaks:
        where = f", estimated {span}"
    return (
        f"rate at most {certificate.rate:.4f}{_whom(problem)}, at all frequencies{where}; largest "
        f"near {float(f'{at:.2g}'):g} rad/s"
    )


def _whom(problem):
    """Name the plants for which the rate holds.

    For a single plant without a radius, the text is empty.
    """
    count = len(problem.plants)
    of = f" of {count} plants" if count > 1 else ""
    if problem.radius is not None:
        return f" for every plant within the radius{of}"
    return f" for each{of}" if of else ""


def _gains(certificate):
    """Yield P at rest, the cut-off of Q, the delay, the gains of L, and the norm of a trial."""
    problem, trial = certificate.problem, certificate.settled_trial
    yield at_rest_in_words(problem.response)
    yield f"the cut-off of Q is {problem.lowpass.cutoff:.4g} rad/s"
    yield f"P has a delay of {_count(problem.delay_samples, 'sample')} there"
    yield f"sigma_max(L) is {certificate.all_L:.3g}"
    for claim in problem.bounds.on("L"):
        if claim.lowest > 0:
            yield f"{claim.what} is {certificate.anywhere(claim):.3g}"
    if trial.samples:
        of_which = ", over all v that errors lead to" if problem.m > problem.p else ""
        yield f"the norm of a trial of {trial.samples} samples is {trial.norm:.3g}{of_which}"


def _unequal(certificate):
    """Yield a line on what is learned if the numbers of learned inputs and outputs differ."""
    problem = certificate.problem
    if problem.square:
        return
    counts = f"{_count(problem.m, 'learned input')} for {_count(problem.p, 'output')}"
    if problem.m > problem.p:
        yield f"{counts}: among all v that remove an error, the law learns the smallest"
        return
    text = (
        f"{counts}: the rate is the rate of v, and the part of the error that v cannot "
        "reach remains"
    )
    if problem.objective.first_error is not None:
        names, _ = problem.response.names
        rms = zip(names, unreachable_rms(problem), strict=True)
        text += ", with an RMS of " + ", ".join(f"{value:.3g} in {name}" for name, value in rms)
    yield text


def _count(number, what):
    """Return a number with its noun, in the singular or the plural."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _deaf(certificate):
    """If sigma_max(M) has a peak where P has no gain, yield a line on this peak."""
    if DEAF in certificate.peaks:
        place = certificate.place(certificate.peaks[DEAF])
        yield (
            f"P passes nothing {place}: sigma_max(M) is |Q| for every L, and the error there "
            "remains"
        )


def _below(certificate):
    """Yield what is assumed about P below its first sample, and the rate above this sample."""
    if below := certificate.problem.response.below_in_words:
        yield f"{below}; above this frequency, the rate is {certificate.rate_above:.4f}"


def _limits(certificate):
    """Return a line with the bounds that limit the optimum, and the order of the filter."""
    problem = certificate.problem
    if np.isnan(certificate.lower_bound):
        return "L = B by its formula (K = 1): nothing was optimised"
    of_grid = zip(problem.bounds.claims, certificate.problem_on_grid.bounds.claims, strict=True)
    limits = [
        str(stated)
        for stated, on_grid in of_grid
        if certificate.on_grid(on_grid) > (1 - TIED) * on_grid.limit
    ]
    size = f"order = {problem.order}"
    if problem.base is not None:
        product = "K B" if problem.of_v else "B K"
        size += f" of K in L = {product} by convex optimisation, and sigma_max(K) <= {K_MAX:g}"
    return f"limited by {', '.join([*limits, size])}"


def _mean(certificate):
    """Yield the predicted RMS errors, or without a reference the mean of sigma_max(M)."""
    problem, rms, mean = certificate.problem, certificate.predicted, certificate.mean_M
    nominal = " of the nominal plant" if problem.robust else ""
    if rms:
        trials = ", ".join(f"{rms[k]:.3g} in trial {k}" for k in PREDICTED_TRIALS)
        yield f"predicted RMS of the error{nominal}: {trials}"
    elif problem.objective.kind == "sum" and not np.isnan(mean):
        span = _span(problem.objective.band)
        yield f"mean of sigma_max(M){nominal} over the band: {mean:.4f}, {span}"


def _against(certificate):
    """Yield the lines of warnings and failures."""
    yield from (f"WARNING: {found}" for found in certificate.warnings)
    yield from (f"FAILS: {found}" for found in certificate.failures)


def _span(omega):
    """Return the first and the last of some frequencies in words."""
    return f"from {omega[0]:.4g} to {omega[-1]:.4g} rad/s"
