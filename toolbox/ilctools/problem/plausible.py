"""Is P the response that is asked for: in rad/s, with its sign, and not the inverse of it?

Nothing in a table says in which unit its frequencies are, or from where to where it was measured.
What follows is asked of tables alone, as questions: each of them has an answer that is no mistake.

**Unit.** A table in Hz ends just below 1 / (2 Ts), at the last line of a transform or at nine
tenths of the Nyquist frequency. In rad/s this number means nothing: few tables end there by chance.
If a table ends there exactly, P in Hz is real there. A table that is not real, by more than noise,
is then in rad/s. Elsewhere the phase does not decide. Other units turn a delay of one sample into
one of six, which is a plant, too. Rational functions of z = exp(j omega Ts) with up to four poles
were tried. Some ten of 44 plants they fit three times better in Hz and more, although the table is
in rad/s and ends at a tenth of the Nyquist frequency: they resolve slow poles better there.

**Rest.** What tracks a reference has the gain one at rest. A gain of minus one there is a sign;
nothing at rest, and one at the highest frequencies, is the sensitivity I - P; one at rest, with a
gain that grows as its phase leads, is the inverse. Other gains at rest are those of other plants.

A loop whose observer integrates has the identity at rest, whatever the plant is. If a response that
was measured in it is another one, something else than this loop was at work.
"""

import numpy as np

from ilctools.findings import Finding
from ilctools.models import frequency_response
from ilctools.response.response import Response
from ilctools.singular_values import largest_singular_values

NEAR = 0.85  # of 1 / (2 Ts), from which on the end of a table looks like one in Hz
ROUNDED = 1e-3  # by which a table in Hz may pass 1 / (2 Ts)
NOISY = 0.05  # of the largest gain, below which noise may turn the phase
FAR = 0.3  # of a gain of one, at rest; of the gain at 1 / (2 Ts), of its imaginary part
END = 0.5  # of a gain of one that a sensitivity has at its end, where a loop still passes something
GROWN = 2.0  # gain at the end of an inverse, from one at rest
LEADS = 0.5  # rad, phase there
TURNED = 0.2  # rad, of a phase that is worth its digits
VISIBLE = 0.01  # of the largest gain: coupling that is worth a number
NOTHING = 1e-9  # of the largest gain: rounding


def doubts(response: Response) -> list[Finding]:
    """What speaks against the nominal plant as it was passed."""
    P, omega = response.P[0], response.omega
    if response.one_at_first:
        return _far_from_one(response)
    if response.models[0] is not None or response.measured:
        return []
    return [*_hertz(P, omega, response.Ts), *_sign(P, omega), *_sensitivity_or_inverse(P, omega)]


def at_rest_in_words(response: Response) -> str:
    """The nominal P at rest, or at its lowest frequency: how large, and of which sign.

    Of several channels the gain of each to itself, and the largest of one to another.
    """
    model, omega = response.models[0], response.omega[0]
    if model is not None:
        [P], where = frequency_response(model, [0.0]), "at rest"
    else:
        P, where = response.P[0, 0], f"at {omega:.4g} rad/s" if omega > 0 else "at rest"
    largest = largest_singular_values(response.P[0]).max()
    own = ", ".join(_number(value, largest) for value in np.diagonal(P))
    if len(P) == 1:
        return f"P is {own} {where}"
    between = np.abs(P[~np.eye(len(P), dtype=bool)]).max()
    coupling = f", up to {between:.2g} between channels" if between > VISIBLE * largest else ""
    return f"P is diag({own}){coupling} {where}"


def _number(value, largest):
    """A gain with its sign, or with its phase where that is neither 0 nor 180 degrees."""
    if np.abs(value) < NOTHING * largest:
        return "0"
    if np.abs(value.imag) < TURNED * np.abs(value):
        return f"{np.copysign(np.abs(value), value.real):.3g}"
    return f"{np.abs(value):.3g} at {np.degrees(np.angle(value)):.0f} degrees"


def _from_one(P):
    """By how much one response, (m, m), differs from the identity."""
    return float(np.linalg.norm(P - np.eye(len(P)), 2))


def _far_from_one(response):
    """A loop whose observer integrates, and whose gain at the lowest frequency is not one."""
    radius = 0 if response.radius is None else response.radius[0]
    off = _from_one(response.P[0, 0]) - radius
    place = f"at {response.omega[0]:.4g} rad/s"
    return [Finding("rest", off, 1 - FAR, place)] if off > 1 - FAR else []


def _hertz(P, omega, Ts):
    """A table that ends where one in Hz does; not one that turns where P in Hz would be real."""
    end = omega[-1] * 2 * Ts
    if not NEAR <= end <= 1 + ROUNDED:
        return []
    sizes = np.abs(P).max(axis=(1, 2))
    turned = np.abs(P[-1].imag).max() > FAR * sizes[-1] > FAR * NOISY * sizes.max()
    if end > 1 - ROUNDED and turned:
        return []
    return [Finding("hertz", 0.5 / Ts, NEAR, f"omega ends at {omega[-1]:.6g}")]


def _sign(P, omega):
    """Channels whose own gain tends to minus one towards rest, with little from the others."""
    later = min(np.searchsorted(omega, 2 * omega[0], side="right"), len(omega) - 1)
    own = np.diagonal(P[: later + 1], axis1=1, axis2=2)
    phase = np.unwrap(np.angle(own), axis=0)
    slope = (phase[-1] - phase[0]) / (omega[later] - omega[0])
    at_rest = np.abs(own[0]) * np.exp(1j * (phase[0] - slope * omega[0]))
    others = np.abs(P[0]).sum(axis=1) - np.abs(own[0])
    turned = np.flatnonzero((np.abs(at_rest + 1) < FAR) & (others < FAR))
    place = f"at {omega[0]:.4g} rad/s"
    if P.shape[1] > 1:
        place = f"from each of the inputs {(turned + 1).tolist()} to its output {place}"
    return [Finding("sign", -1.0, 1.0, place)] if turned.size else []


def _sensitivity_or_inverse(P, omega):
    """A table of I - P, or of P^-1, where P is one at rest and passes nothing at its end."""
    passed = float(np.linalg.norm(P[0], 2))
    if passed < FAR and _from_one(P[-1]) < END:
        return [Finding("sensitivity", passed, FAR, f"at {omega[0]:.4g} rad/s")]
    own = np.diagonal(P, axis1=1, axis2=2)
    most = np.abs(own[-1]).argmax()
    leads, grown = np.unwrap(np.angle(own[:, most]))[-1], float(np.abs(own[-1, most]))
    if _from_one(P[0]) < FAR and grown > GROWN and leads > LEADS:
        return [Finding("inverse", grown, GROWN, f"at {omega[-1]:.4g} rad/s")]
    return []
