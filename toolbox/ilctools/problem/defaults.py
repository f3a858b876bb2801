"""Default band of the sum (39), order of the filter and bound on its gain: they follow P and Q.

They are for a plant that one does not know.
"""

import numpy as np

CHOOSE = "auto"  # in the place of L_max, of which None says that there is none
REACH = 4  # samples that the filter looks ahead beyond the delay of P, times cutoff Ts
FEWEST, MOST = 10, 60  # samples of the filter; with more the synthesis takes seconds,
LEFT = 20  # and is worth it only if fewer than these are left beyond the delay
# of the gain that inverts P: a finite filter overshoots it in some places to be close in others
ROOM = 4


def cutoff(butterworth, Q, omega) -> float:
    """The cut-off of Q, a filter or samples on omega: where it is down to one half, rad/s."""
    if butterworth is not None:
        return butterworth.cutoff
    size = np.abs(Q)
    passed = np.flatnonzero(size >= 0.5)
    if not len(passed) or passed[-1] == len(omega) - 1:
        return float(omega[-1])
    at = slice(passed[-1], passed[-1] + 2)
    return float(np.interp(-0.5, -size[at], omega[at]))


def band(cutoff, omega) -> tuple[float, float]:
    """From the lowest frequency above zero to the cut-off."""
    low, *higher = omega[omega > 0].tolist()
    return low, float(min(max(cutoff, higher[0]), omega[-1]))


def gain(cutoff, smallest, omega) -> float:
    """ROOM times the largest gain that inverts P up to the cut-off, rounded up to one digit.

    `smallest`, (n,): the smallest singular value of P at omega.
    """
    least = min([np.interp(cutoff, omega, smallest), *smallest[omega <= cutoff]])
    exact = ROOM / least
    digit = 10.0 ** np.floor(np.log10(exact))
    return float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.0e}")


def order(cutoff, delay, Ts, frequencies) -> int:
    """The delay of P and REACH / (cutoff Ts), within limits; the grid determines half of it."""
    samples = max(FEWEST, delay + np.ceil(REACH / (cutoff * Ts) - 1e-9))
    return int(min(samples, max(MOST, delay + LEFT), max(1, frequencies // 2)))


def delay(P, omega, Ts, cutoff) -> int:
    """Samples by which P lags at the cut-off beyond the least lag that its gain admits.

    Of each output by itself, the largest. The relation of gain and least phase is that of H. W.
    Bode, Network Analysis and Feedback Amplifier Design (1945), for frequencies as the bilinear
    transform maps them.
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 2:
        return 0
    # as decoupled at the lowest frequency: w_i acts on y_i
    outputs = np.einsum("nij,ji->ni", P, np.linalg.inv(P[0]))
    gains = np.log(np.maximum(np.abs(outputs), 1e-300))
    last = np.clip(cutoff, omega[1], omega[-1])
    mapped, at = (np.log(np.tan(np.minimum(x * Ts / 2, np.pi / 2 - 1e-9))) for x in (omega, last))
    steps = np.diff(mapped)
    distance = np.abs((mapped[1:] + mapped[:-1]) / 2 - at)
    # around zero the mean of a step, where the logarithm has no bound
    distance = np.maximum(distance, steps / (2 * np.e))
    least = -np.log(np.tanh(distance / 2)) @ np.diff(gains, axis=0) / np.pi
    phases = np.unwrap(np.angle(outputs), axis=0)
    slopes = [
        (low - np.interp(last, omega, phase)) / ((last - omega[0]) * Ts)
        for low, phase in zip(least, phases.T, strict=True)
    ]
    return max(0, round(max(slopes)))
