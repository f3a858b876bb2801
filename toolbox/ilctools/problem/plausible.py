"""Is a table plausible as P: are its frequencies in rad/s, and is its sign right?

A table of a frequency response shows neither the unit of its frequencies nor the signals between
which it was measured. The following doubts concern tables only. They are printed as questions,
because the table may be right. The printed certificate also shows P at rest, in words. If a user
passed the sensitivity I - P by mistake, this value is near 0. If a user passed an inverse, the
value is the inverse of the gain of P.

**Unit.** A table in Hz often ends just below 1 / (2 Ts): at the last line of a Fourier transform,
or at nine tenths of the Nyquist frequency. In rad/s the number 1 / (2 Ts) has no meaning, so that
few tables in rad/s end there. If a table in Hz ends exactly at 1 / (2 Ts), P must be real at this
frequency. If the imaginary part there exceeds the noise, the table is in rad/s. If the table ends
at another frequency, its phase does not show the unit. In the wrong unit, a delay of one sample
becomes a delay of six samples, which is also plausible. As a test of the unit, rational functions
of z = exp(j omega Ts) with up to four poles were fitted to tables of 44 plants. For about ten
plants, the fit is at least three times better in Hz, although the table is in rad/s. These tables
end at a tenth of the Nyquist frequency, and the functions resolve slow poles better in Hz. This
test is therefore not used.

**Rest.** A loop that tracks a reference has the gain one at zero frequency. A gain of minus one
there is probably a wrong sign. If the observer of a loop integrates, P is the identity at zero
frequency for any plant. If a response that was measured in such a loop differs from the identity,
the data come from another loop.
"""

import numpy as np

from ilctools.findings import Finding
from ilctools.models import frequency_response
from ilctools.problem.defaults import lead
from ilctools.response.response import Response
from ilctools.singular_values import largest_singular_values

NEAR_NYQUIST = 0.85  # share of 1 / (2 Ts): a table that ends above it looks like a table in Hz
PAST_NYQUIST = 1e-3  # relative, by which a table in Hz may exceed 1 / (2 Ts)
NOISE_OF_PHASE = 0.05  # of the largest gain: a smaller imaginary part may be noise
FAR_FROM_ONE = 0.3  # distance of the gain at rest from one or minus one
# rad, mean lead of the phase of P, above which the sign of the phase counts as wrong
LEAD_DOUBTED = 0.5
TURNED_PHASE = 0.2  # rad: smaller phases are not printed
ROUNDED_TO_ZERO = 1e-9  # of the largest gain: rounding


def doubts(response: Response) -> list[Finding]:
    """Return findings about what looks wrong in the nominal plant that the user passed."""
    return [*_of_signals(response), *_of_tables(response)]


def _of_signals(response):
    """Yield findings if outputs in several units have no scale, or if directions are left out."""
    (outputs, inputs), signals = response.names, response.signals
    units = {signals.units.get(name, "") for name in outputs} - {""}
    if len(units) > 1 and response.scale.is_one:
        yield Finding("units", len(units), 1, ", ".join(sorted(units)))
    if response.directions is not None:
        place = response.directions.in_words(outputs, inputs)
        passed, channels = min(response.P.shape[2:]), min(map(len, response.scale))
        yield Finding("directions", passed, channels, place)


def _of_tables(response):
    """Yield findings on a table, or on a response that should be the identity at zero frequency."""
    P, omega = response.P[0], response.omega
    at_first = f"at {omega[0]:.4g} rad/s"
    is_table = response.models[0] is None and response.low is None
    if response.one_at_first:
        apart = np.linalg.norm(P[0] - np.eye(len(P[0])), 2) - response.radii[0]
        if apart > 1 - FAR_FROM_ONE:
            yield Finding("rest", apart, 1 - FAR_FROM_ONE, at_first)
    elif is_table:
        if np.any(np.abs(np.diagonal(P[0]) + 1) < FAR_FROM_ONE):
            yield Finding("sign", -1, 1, at_first)
        if _ends_as_in_hertz(P, omega, response.Ts):
            place = f"omega ends at {omega[-1]:.6g}"
            yield Finding("hertz", 0.5 / response.Ts, NEAR_NYQUIST, place)
    ahead = lead(P, omega, response.Ts) if is_table else 0.0  # a record fixes the sign
    if ahead > LEAD_DOUBTED:
        yield Finding("lead", ahead, LEAD_DOUBTED)


def _ends_as_in_hertz(P, omega, Ts):
    """Check if a table ends near 1 / (2 Ts), and is real if it ends exactly there."""
    end = omega[-1] * 2 * Ts
    turns = np.abs(P[-1].imag).max() > NOISE_OF_PHASE * np.abs(P).max()
    return NEAR_NYQUIST <= end <= 1 + PAST_NYQUIST and not (turns and end > 1 - PAST_NYQUIST)


def at_rest_in_words(response: Response) -> str:
    """Describe the nominal P at zero or at its lowest frequency by the gain of each channel.

    If the numbers of inputs and outputs differ, the singular values are given instead.
    """
    model, omega = response.models[0], response.omega[0]
    if model is not None:
        [P], where = frequency_response(model, [0.0]), "at zero frequency"
    else:
        P, where = response.P[0, 0], f"at {omega:.4g} rad/s" if omega > 0 else "at zero frequency"
    if P.shape[0] != P.shape[1] or response.directions is not None:
        values = [f"{value:.3g}" for value in np.linalg.svdvals(P)]
        s = "s" if len(values) > 1 else ""
        return f"P has the singular value{s} {', '.join(values)} {where}"
    rounding = ROUNDED_TO_ZERO * largest_singular_values(response.P[0]).max()
    gains = ", ".join(_number(value, rounding) for value in np.diagonal(P))
    return f"P is {gains} {where}" if len(P) == 1 else f"P is diag({gains}) {where}"


def _number(value, rounding):
    """Return a gain as text with its sign, or with its phase if the gain is not real."""
    if np.abs(value) < rounding:
        return "0"
    if np.abs(value.imag) < TURNED_PHASE * np.abs(value):
        return f"{np.copysign(np.abs(value), value.real):.3g}"
    return f"{np.abs(value):.3g} at {np.degrees(np.angle(value)):.0f} degrees"
