"""What samples of P and Q show to be likely mistakes: each is a sentence that names the cause.

What a causal plant cannot be, or hardly, is told from its samples; a model is causal by itself.
"""

from collections.abc import Iterator

import numpy as np

EXACT = 1e-6  # of the largest entry: rounding, or the digits of a table
TURNED = np.pi / 8  # a phase, rad, from which on it is no accident
FALLS = -0.5  # slope of ln |det P| over ln omega, from which on it falls
PASSED = 0.5  # |Q| where learning ends
NOTHING = 0.1  # |Q| in the mean over a band in which next to nothing is learned


def doubts_about_P(name: str, P, omega, Ts: float) -> Iterator[str]:
    """About a plant that is known as samples, (n, m, m)."""
    size = np.abs(P).max()
    if np.abs(P.imag).max() <= EXACT * size:
        # Then its impulse response is even in time: it is causal only if nothing but h(0) is left.
        if np.abs(P - P[0]).max() > EXACT * size:
            yield (
                f"{name} is real at all frequencies, as no plant is that acts later than its "
                "input: likely its magnitude, without the phase"
            )
        return
    # At the Nyquist frequency z is -1, and so the response of a real plant real.
    last = np.abs(P[-1].imag).max() <= EXACT * np.abs(P[-1]).max()
    if last and abs(omega[-1] * Ts - 0.5) < EXACT:
        yield (
            f"omega ends at {omega[-1]:.6g} = 1 / (2 Ts), and {name} is real there, as it is at "
            "the Nyquist frequency: likely omega is in Hz; multiply it by 2 pi"
        )
    elif (ahead := _phase_where_it_falls(P, omega)) > TURNED:
        yield (
            f"where {name} falls with frequency, its phase is {ahead:.2g} rad, ahead of the "
            "input: likely it is conjugated, as from exp(-j omega t); pass its conjugate"
        )


def _phase_where_it_falls(P, omega):
    """The median phase of det P, from zero at frequency zero, where |det P| falls."""
    # By Bode's relation the phase follows the slope, and delays and zeros outside the unit circle
    # only add to the lag. So it is negative where |det P| falls, and of a conjugate, positive.
    with np.errstate(divide="ignore"):
        sign, size = np.linalg.slogdet(P)
        slope = np.diff(size) / np.diff(np.log(np.maximum(omega, omega[1] / 2)))
    steps = np.angle(sign[1:] / sign[:-1])
    known = np.logical_and.accumulate(
        np.abs(steps) < np.pi / 2
    )  # or it has no one phase
    start = np.angle(sign[0] ** 2) / 2  # from the nearer half of the real axis
    if abs(start) > TURNED:  # it has begun to turn below: nothing is known
        return 0.0
    phase = start + np.cumsum(steps)
    falling = known & (slope < FALLS)
    return float(np.median(phase[falling])) if falling.any() else 0.0


def doubts_about_Q(Q, omega, in_band, Ts: float) -> Iterator[str]:
    """About a Q-filter on a grid, (n,), and the band that is to be learned, or None."""
    passed = np.flatnonzero(np.abs(Q) >= PASSED)
    turned = np.abs(np.angle(Q[passed]))
    if turned.max(initial=0) > TURNED:
        where = passed[turned.argmax()]
        yield (
            f"Q turns the phase by {turned.max():.2g} rad at {omega[where]:.4g} rad/s: likely the "
            "response of a filter that runs in one direction only. It delays v from trial to "
            "trial; pass |Q|^2 of it, or zero_phase_butterworth"
        )
    if in_band is not None and np.abs(Q[in_band]).mean() < NOTHING:
        yield (
            f"|Q| is {np.abs(Q[in_band]).mean():.2g} in the mean over the band, and so is M, "
            "whatever is learned: likely the cut-off, in rad/s, is too low; one that is normalised "
            f"as scipy does is to be multiplied by pi / Ts = {np.pi / Ts:.6g}"
        )
