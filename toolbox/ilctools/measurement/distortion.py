"""Noise and distortion at the lines (the excited frequencies) of an excited record.

Distortion is the part of the response that is not linear. The regression of a record,
A(z) y = B(z) w + e, describes transients, and P between the lines. The regression treats its whole
residual as noise, although part of the residual may be distortion. E_rp is the transform of its
residual e over period p of realisation r of the random phases, at the lines of the excitation. W_r
is the transform of w in this realisation. The columns of E_rp and W_r belong to the m experiments.
Then

    D_rp = E_rp W_r^-1 / A,    G_rp = P + D_rp,                                                 (1)

where the G_rp are the responses (1) of :mod:`.excited`, without transients. Equations (2) and (3)
of that module therefore give the noise and the error at the lines. Distortion has the variance

    delta^2 = max(error^2 - noise^2, 0),  if the mean of error^2 / noise^2 over all lines       (2)

is above the 99 % point of its F distribution. Otherwise the variance is set to zero. Distortion is
the same in all periods of a realisation. With R realisations, distortion adds to E, at each line
and in each experiment, an error of the variance

    v = R delta^2 ||W||^2 / m^2 |A|^2,                                                          (3)

which is multiplied by the ratio of the quantiles of F and chi^2 at 1 - TAIL, because delta^2 is
itself an estimate. Let F be the transform of the regressors, summed over all periods of p samples.
The unknowns x of the regression then have the additional covariance

    M V M,    V = sum over experiments and lines of 2 v / p^2 Re(F F^H),                        (4)

with M = (X' X + D^-1)^-1, the regressors X and the prior variances D of x. Source: R. Pintelon and
J. Schoukens, System Identification, 2012, section 4.3.1.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri, fdtri

from ilctools.errors import LogError
from ilctools.measurement.arx.regression import Regression
from ilctools.measurement.arx.regressors import Regressors
from ilctools.measurement.arx.trials import Trials, series_of
from ilctools.measurement.estimation import SEEN, EstimatedResponse, estimated_response
from ilctools.measurement.excitation import Excitation
from ilctools.measurement.excited import ExcitedResponse
from ilctools.response.measured import CONFIDENCE
from ilctools.singular_values import largest_singular_values

CONTRADICTED = (
    "{reason}. Therefore P is taken from the excited frequencies (lines) alone, and from "
    "splines between them. P may be wrong between the lines, as it is behind a long delay or "
    "at a narrow resonance. Record longer periods, or more lines"
)
GATE = 0.99  # probability that noise alone is not mistaken for distortion
TAIL = 2e-4  # probability of the tail at which v is as uncertain as delta^2


def combined(
    log, excitation: Excitation, of_lines: ExcitedResponse
) -> EstimatedResponse | ExcitedResponse:
    """Estimate P from an excited record, by the regression and by the lines.

    The estimate is P at the lines alone in three cases: the lines have the smaller radius, no
    linear model describes the record, or the lines contradict the model. The last two cases are
    reported as findings.
    """
    try:
        estimate = estimated_response([log], "w")
    except LogError as error:
        return _at_lines(of_lines, str(error))
    estimate = with_distortion(estimate, excitation)
    P, radius = estimate.on(of_lines.omega, CONFIDENCE)
    if np.median(radius) > np.median(of_lines.radius(CONFIDENCE, jointly=True)):
        return of_lines
    off = largest_singular_values(estimate.lines.response - P)
    both = radius + estimate.lines.radius(CONFIDENCE, jointly=True)
    if np.any(off > both):
        worst = of_lines.omega[np.argmax(off / both)]
        return _at_lines(
            of_lines,
            f"at {worst:.3g} rad/s, a linear model contradicts the response at the "
            "excited frequencies",
        )
    findings = (*of_lines.findings, *estimate.findings)
    return replace(estimate, lines=of_lines, findings=findings)


def _at_lines(of_lines, reason):
    finding = CONTRADICTED.format(reason=reason)
    return replace(of_lines, findings=(*of_lines.findings, finding))


def lines_of(estimate: EstimatedResponse, excitation: Excitation) -> ExcitedResponse:
    """Compute the responses G_rp of (1) for all outputs, in the units of the estimate."""
    [group] = estimate.record.groups
    angles = excitation.omega * estimate.loop.Ts
    W = excitation.spectra(group.u[..., : group.commanded])
    rows = []
    for i, fit in enumerate(estimate.fits):
        E = excitation.spectra(fit.residual(group.u, group.y[..., i])[..., None])
        D = E @ np.linalg.inv(W) / fit.denominator_at(angles)[:, None, None]
        rows.append(fit.response(angles)[:, None] + D)
    periods = np.concatenate(rows, axis=-2)
    return ExcitedResponse(excitation.omega, periods * estimate.units, estimate.loop)


def with_distortion(estimate: EstimatedResponse, excitation: Excitation) -> EstimatedResponse:
    """Add the covariance (4) to the fits of outputs whose lines show distortion."""
    lines, [group] = lines_of(estimate, excitation), estimate.record.groups
    fits, linear = [], True
    for i, (fit, units) in enumerate(zip(estimate.fits, estimate.units, strict=True)):
        own = replace(lines, periods=lines.periods[..., [i], :] / units)
        v = distortion(own)
        if v.any():
            linear = False
            one = replace(group, y=group.y[..., [i]])
            fit = replace(fit, C=fit.C + added_covariance(fit, one, excitation, v))
        fits.append(fit)
    # The distortion at the lines includes a contradiction that is too small to report.
    apart = estimate.apart if estimate.apart > SEEN else 0.0
    return replace(estimate, fits=tuple(fits), apart=apart, lines=lines, linear=linear)


def distortion(lines: ExcitedResponse) -> np.ndarray:
    """Compute delta^2 of (2) for one output, times the ratio of quantiles in (3).

    The result has the shape (n,).
    """
    R, N = lines.periods.shape[:2]
    square, d, f = lines._error
    noise, n = lines.noise**2, len(lines.omega)
    error = lines._variance(lines.realisations - lines.response, R * (R - 1))
    gate = fdtri(2 * d * n * (R - 1), 2 * d * n * R * (N - 1), GATE)
    if np.mean(error / noise) <= gate:
        return np.zeros(n)
    ratio = fdtri(2 * d, 2 * f, 1 - TAIL) / (chdtri(2 * d, TAIL) / (2 * d))
    return np.maximum(square - noise, 0) * ratio


def added_covariance(fit: Regression, group: Trials, excitation, delta2) -> np.ndarray:
    """Compute the covariance M V M of (4) for the unknowns of one output."""
    period = excitation.period
    W = excitation.spectra(group.u[..., : group.commanded])[:, 0]  # alike in all periods
    power = np.sum(np.abs(W) ** 2, axis=(0, 2, 3)) / excitation.rows**2  # of all R realisations
    A = fit.denominator_at(excitation.omega * excitation.Ts)
    v = delta2 * power * np.abs(A) ** 2  # (3)
    V, M = 0.0, fit.posterior.spread
    for series in series_of([group]):
        X = Regressors(series, fit.data.layout).rows()
        one_period = X.reshape(len(X), -1, period).sum(axis=1)
        F = np.fft.rfft(one_period, axis=1)[:, excitation.harmonics]
        weight = fit.posterior.weight if series.is_mean else 1.0
        V = V + 2 * weight**2 / period**2 * (F * v @ F.conj().T).real  # (4)
    return M @ V @ M
