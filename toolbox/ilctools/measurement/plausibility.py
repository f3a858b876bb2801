"""What speaks against a measurement of P: each warning is a sentence that says what follows."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import fdtrc
from scipy.stats import chi2

from ilctools.law.limits import commands_beyond
from ilctools.measurement.region import TINY
from ilctools.measurement.transient import separated, windows_of

DRIFT = 3.0  # standard deviations without drift, from which one is reported
SIGNIFICANCE = 1e-3  # probability of a false report
ROUNDING = 1e-12  # of P: less is no sign of anything
TOLERANCE = 1.2  # of a radius: half of the lines must predict more than all of them
BY_LINE = ("omega", "response", "noise", "spread", "freedom")  # of a measured response


def findings_of(u, y, limits, windows, excitation, measured) -> tuple[str, ...]:
    """All warnings: of the commands, the outputs, and what was measured from them."""
    texts = (
        _beyond_limits(u, measured.loop.controls, limits),
        _nonlinear(y, excitation, measured),
        _drift(y, windows, excitation, measured),
        _far_from_identity(measured),
        _sparse(measured),
    )
    return tuple(text for text in texts if text)


def _beyond_limits(u, controls, limits):
    """Commands that the actuators did not follow."""
    beyond = commands_beyond(u, controls, limits)
    return beyond and (
        f"{beyond}: what was measured is not the loop, and the radius does not contain that. Shake "
        "with a smaller amplitude"
    )


def _nonlinear(y, excitation, measured):
    """F tests at harmonics that were not excited: there, a linear loop shows noise only.

    Their probabilities are combined by Fisher's method, and corrected for the m outputs.
    """
    excited = np.array(excitation.harmonics)
    between = (excited[1:] + excited[:-1]) // 2
    quiet = between[~np.isin(between, excited)]
    if not quiet.size:
        return None
    m, loop = excitation.channels, measured.loop
    windows = windows_of(quiet, excitation, loop)
    spectra, noise, freedom = separated(y, windows)
    power = np.mean(np.abs(spectra) ** 2, axis=2)  # (line, output)
    expected = np.einsum("njj->nj", noise).real
    p = fdtrc(2 * m, 2 * freedom[:, None], power / np.maximum(expected, TINY))
    combined = chi2.sf(-2 * np.log(np.maximum(p, 1e-300)).sum(axis=0), 2 * len(quiet))
    significant = combined <= SIGNIFICANCE / m
    if not significant.any():
        return None
    excess = np.sqrt(np.maximum(power - expected, 0).mean(axis=0).max())
    error = excess * np.median(np.linalg.norm(measured.spread, 2, axis=(1, 2)))
    if error < ROUNDING * np.linalg.norm(measured.response):
        return None
    names = ", ".join(np.array(loop.outputs)[significant])
    return (
        f"the loop is not linear: {names} move at harmonics that were not excited. P is "
        f"off by about {error:.2g}, which the radius does not contain. An actuator at its limit, "
        "perhaps: shake with a smaller amplitude"
    )


def _drift(y, windows, excitation, measured):
    """Whether the means drift from period to period by more than noise explains."""
    periods, m = excitation.periods, excitation.channels
    means = y.reshape(m, periods, -1, m).mean(axis=2)
    number = np.arange(periods) - (periods - 1) / 2
    slope = np.einsum("p,epj->ej", number, means) / np.sum(number**2)
    ramp = slope[:, None] * np.arange(y.shape[1])[:, None] / excitation.period
    spectra = separated(ramp, windows)[0]
    error = np.linalg.norm(spectra @ measured.spread, 2, axis=(1, 2))
    noise = np.einsum("njj->n", separated(y - ramp, windows)[1]).real
    std = np.sqrt(noise) * np.linalg.norm(measured.spread, axis=(1, 2))
    worst = np.argmax(error / np.maximum(std, TINY))
    if error[worst] <= DRIFT * std[worst]:
        return None
    largest = np.abs(slope).max(axis=0)
    output = largest.argmax()
    hourly = largest[output] / (excitation.period * excitation.Ts) * 3600
    return (
        f"{measured.loop.outputs[output]} drifts by {hourly:.3g} an hour: P is off by about "
        f"{error[worst]:.2g} at {measured.omega[worst]:.3g} rad/s, and the radius is larger for "
        "it. Wait until the rig is warm, or shake at higher frequencies"
    )


def _far_from_identity(measured):
    """Whether P, where it is I at zero, is far from it at the lowest frequency."""
    if not measured.anchored:
        return None
    P = measured.response[0]
    distance = np.linalg.norm(P - np.eye(len(P)), 2)
    if distance <= 1:
        return None
    return (
        f"P differs from I by {distance:.2g} at the lowest frequency, {measured.omega[0]:.3g} "
        "rad/s: between it and zero, P is not known. Shake at lower frequencies, or design above"
    )


def _sparse(measured):
    """Whether every other line predicts those between, within the radius that it claims."""
    n = len(measured.omega)
    number = np.arange(n)
    ends = (number == 0) | (number == n - 1)
    own_radius = measured.radius(1 - SIGNIFICANCE, jointly=True)
    worst, text = 0.0, None
    for odd in (0, 1):
        chosen = ends | (number % 2 == odd)
        lines = {name: getattr(measured, name)[chosen] for name in BY_LINE}
        half = replace(measured, **lines)
        predicted, radius = half.on(measured.omega, 1 - SIGNIFICANCE)
        radius = maximum_filter1d(radius, 5)  # small by itself where P hardly bends
        error = np.linalg.norm(predicted - measured.response, 2, axis=(1, 2))
        excess = error - TOLERANCE * (radius + own_radius)
        k = excess.argmax()
        if excess[k] > worst:
            worst = excess[k]
            text = (
                f"lines are too far apart near {measured.omega[k]:.3g} rad/s: from every other one "
                f"P would be off by {error[k]:.2g} there, with a radius of {radius[k]:.2g}; "
                "between those that there are, the radius may be as wrong. Shake with more lines"
            )
    return text
