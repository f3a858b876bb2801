"""What speaks against a measurement of P: each finding is a sentence that says what follows."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import fdtrc
from scipy.stats import chi2

from rodlib.ilc.measurement.region import TINY
from rodlib.ilc.measurement.transient import separated, windows_of
from rodlib.ilc.rigs.limits import commands_beyond

DRIFT = 3.0  # standard deviations without it, from which a drift is reported
SURE = 1e-3  # probability of a false report
FAIR = (
    1.2  # of a radius may be missed, as half of the lines are asked for more than all
)
BY_LINE = ("omega", "response", "noise", "spread", "freedom")  # of a measured response


def findings_of(u, y, limits, windows, excitation, measured) -> tuple[str, ...]:
    """All findings: of the commands, the outputs, and what was measured from them."""
    reports = (
        _cut_off(u, measured.loop.controls, limits),
        _distortion(y, excitation, measured),
        _drift(y, windows, excitation, measured),
        _unanchored(measured),
        _sparse(measured),
    )
    return tuple(report for report in reports if report)


def _cut_off(u, controls, limits):
    """Commands that the actuators did not follow."""
    beyond = commands_beyond(u, controls, limits)
    return beyond and (
        f"{beyond}: what was measured is not the loop, and the radius does not contain that. Shake "
        "with a smaller amplitude"
    )


def _distortion(y, excitation, measured):
    """What is found at harmonics that were not excited: there, a linear loop shows noise only."""
    excited = np.array(excitation.harmonics)
    between = (excited[1:] + excited[:-1]) // 2
    quiet = between[~np.isin(between, excited)]
    if not quiet.size:
        return None
    m, loop = excitation.channels, measured.loop
    windows = windows_of(quiet, excitation, loop)
    net, noise, freedom = separated(y, windows)
    power = np.mean(np.abs(net) ** 2, axis=2)  # (line, output)
    expected = np.einsum("njj->nj", noise).real
    chance = fdtrc(2 * m, 2 * freedom[:, None], power / np.maximum(expected, TINY))
    together = chi2.sf(-2 * np.log(np.maximum(chance, 1e-300)).sum(0), 2 * len(quiet))
    if together.min() > SURE / m:
        return None
    excess = np.sqrt(np.maximum(power - expected, 0).mean(0).max())
    off = excess * np.median(np.linalg.norm(measured.spread, 2, axis=(1, 2)))
    names = [n for n, p in zip(loop.outputs, together, strict=True) if p <= SURE / m]
    return (
        f"the loop is not linear: {', '.join(names)} move at harmonics that were not excited. P is "
        f"off by about {off:.2g}, which the radius does not contain. An actuator at its limit, "
        "perhaps: shake with a smaller amplitude"
    )


def _drift(y, windows, excitation, measured):
    """Whether the means drift from period to period, more than what else there is would explain."""
    periods, m = excitation.periods, excitation.channels
    means = y.reshape(m, periods, -1, m).mean(axis=2)
    steps = np.arange(periods) - (periods - 1) / 2
    slope = np.einsum("p,epj->ej", steps, means) / np.sum(steps**2)
    ramp = slope[:, None] * np.arange(y.shape[1])[:, None] / excitation.period
    off = np.linalg.norm(separated(ramp, windows)[0] @ measured.spread, 2, axis=(1, 2))
    noise = np.einsum("njj->n", separated(y - ramp, windows)[1]).real
    deviation = np.sqrt(noise) * np.linalg.norm(measured.spread, axis=(1, 2))
    worst = (off / np.maximum(deviation, TINY)).argmax()
    if off[worst] <= DRIFT * deviation[worst]:
        return None
    fastest = np.abs(slope).max(axis=0).argmax()
    rate = np.abs(slope[:, fastest]).max() / (excitation.period * excitation.Ts) * 3600
    return (
        f"{measured.loop.outputs[fastest]} drifts by {rate:.3g} an hour: P is off by about "
        f"{off[worst]:.2g} at {measured.omega[worst]:.3g} rad/s, and the radius is larger for it. "
        "Wait until the rig is warm, or shake at higher frequencies"
    )


def _unanchored(measured):
    """Whether P has turned away from I before the lowest frequency, if it is I at zero."""
    if not measured.anchored:
        return None
    away = np.linalg.norm(measured.response[0] - np.eye(len(measured.response[0])), 2)
    if away <= 1:
        return None
    return (
        f"P differs from I by {away:.2g} at the lowest frequency, {measured.omega[0]:.3g} rad/s: "
        "between it and zero, P is not known. Shake at lower frequencies, or design above"
    )


def _sparse(measured):
    """Whether every other line foretells those between, within the radius that it would claim."""
    n = len(measured.omega)
    own, number = measured.radius(1 - SURE, jointly=True), np.arange(n)
    worst, report = 0.0, None
    for odd in (0, 1):
        kept = (number % 2 == odd) | (number == 0) | (number == n - 1)
        half = replace(
            measured, **{name: getattr(measured, name)[kept] for name in BY_LINE}
        )
        foretold, radius = half.on(measured.omega, 1 - SURE)
        radius = maximum_filter1d(
            radius, 5
        )  # which by itself is small where P hardly bends
        off = np.linalg.norm(foretold - measured.response, 2, axis=(1, 2))
        excess = off - FAIR * (radius + own)
        k = excess.argmax()
        if excess[k] > worst:
            worst = excess[k]
            report = (
                f"lines are too far apart near {measured.omega[k]:.3g} rad/s: from every other one "
                f"P would be off by {off[k]:.2g} there, with a radius of {radius[k]:.2g}; between "
                "those that there are, the radius may be as wrong. Shake with more lines"
            )
    return report
