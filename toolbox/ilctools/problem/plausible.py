"""Does a table look like P: in rad/s, and with its sign? And P at rest, in words.

Nothing in a table shows the unit of its frequencies, or between which signals it was measured. The
following doubts concern tables alone, and are stated as questions, as each one may be no mistake.
The print also shows P at rest. There the sensitivity I - P is near 0, and an inverse is not P.

**Unit.** A table in Hz ends just below 1 / (2 Ts), at the last line of a transform or at nine
tenths of the Nyquist frequency. In rad/s this number means nothing: few tables end there by chance.
If a table ends there exactly, P in Hz is real there. A table that is not real, by more than noise,
is then in rad/s. At other ends the phase does not decide. Other units turn a delay of one sample
into a delay of six samples, which is also possible. Rational functions of z = exp(j omega Ts) with
up to four poles were tried. For some ten of 44 plants, these functions fit at least three times
better in Hz, although the table is in rad/s. These tables end at a tenth of the Nyquist frequency,
and the functions resolve slow poles better there.

**Rest.** A plant that tracks a reference has the gain one at rest. A gain of minus one there is a
wrong sign. A loop whose observer integrates has the identity at rest, whatever the plant is. If a
response that was measured in such a loop differs from the identity, something
other than this loop was at work.
"""

import numpy as np

from ilctools.findings import Finding
from ilctools.models import frequency_response
from ilctools.problem.defaults import lead
from ilctools.response.response import Response
from ilctools.singular_values import largest_singular_values

NEAR_NYQUIST = 0.85  # of 1 / (2 Ts): a table that ends above looks like one in Hz
PAST_NYQUIST = 1e-3  # relative, by which a table in Hz may exceed 1 / (2 Ts)
NOISE_OF_PHASE = 0.05  # of the largest gain: a smaller imaginary part may be noise
FAR_FROM_ONE = 0.3  # of a gain of one, at rest
# rad, mean lead of the phase of P, above which the sign of the phase counts as wrong
LEAD_DOUBTED = 0.5
TURNED_PHASE = 0.2  # rad: smaller phases are not printed
ROUNDED_TO_ZERO = 1e-9  # of the largest gain: rounding


def doubts(response: Response) -> list[Finding]:
    """Return the findings against the nominal plant as it was passed."""
    return [*_of_signals(response), *_of_tables(response)]


def _of_signals(response):
    """Findings if outputs in several units count alike, or if P does not pass all directions."""
    (outputs, inputs), signals = response.names, response.signals
    units = {signals.units.get(name, "") for name in outputs} - {""}
    if len(units) > 1 and response.scale.is_one:
        yield Finding("units", len(units), 1, ", ".join(sorted(units)))
    if response.directions is not None:
        place = response.directions.in_words(outputs, inputs)
        passed, channels = min(response.P.shape[2:]), min(map(len, response.scale))
        yield Finding("directions", passed, channels, place)


def _of_tables(response):
    """Findings against a table, or against a response whose loop makes it the identity."""
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
    ahead = lead(P, omega, response.Ts) if is_table else 0.0  # else signals say what leads
    if ahead > LEAD_DOUBTED:
        yield Finding("lead", ahead, LEAD_DOUBTED)


def _ends_as_in_hertz(P, omega, Ts):
    """Whether a table ends as one in Hz does, and is real if P in Hz has to be real there."""
    end = omega[-1] * 2 * Ts
    turns = np.abs(P[-1].imag).max() > NOISE_OF_PHASE * np.abs(P).max()
    return NEAR_NYQUIST <= end <= 1 + PAST_NYQUIST and not (turns and end > 1 - PAST_NYQUIST)


def at_rest_in_words(response: Response) -> str:
    """Describe the nominal P at rest, or at its lowest frequency, by the gain of each channel.

    If the numbers of inputs and outputs differ, the singular values are given instead.
    """
    model, omega = response.models[0], response.omega[0]
    if model is not None:
        [P], where = frequency_response(model, [0.0]), "at zero frequency"
    else:
        P, where = response.P[0, 0], f"at {omega:.4g} rad/s" if omega > 0 else "at zero frequency"
    if P.shape[0] != P.shape[1] or response.directions is not None:
        values = [f"{value:.3g}" for value in np.linalg.svd(P, compute_uv=False)]
        s = "s" if len(values) > 1 else ""
        return f"P has the singular value{s} {', '.join(values)} {where}"
    rounding = ROUNDED_TO_ZERO * largest_singular_values(response.P[0]).max()
    gains = ", ".join(_number(value, rounding) for value in np.diagonal(P))
    return f"P is {gains} {where}" if len(P) == 1 else f"P is diag({gains}) {where}"


def _number(value, rounding):
    """A gain with its sign, or with its phase if this is neither 0 nor 180 degrees."""
    if np.abs(value) < rounding:
        return "0"
    if np.abs(value.imag) < TURNED_PHASE * np.abs(value):
        return f"{np.copysign(np.abs(value), value.real):.3g}"
    return f"{np.abs(value):.3g} at {np.degrees(np.angle(value)):.0f} degrees"
