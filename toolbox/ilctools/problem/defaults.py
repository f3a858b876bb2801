"""Default band of the sum (39), order of the filter and bound on its gain: they follow P and Q.

They are for a plant that one does not know. A filter that inverts P looks ahead by the delay of P,
and further by a share of the time constant of Q:

    order = delay + REACH / (cutoff Ts),    L_max = ROOM / min sigma_min(P) up to the cut-off.

The delay is what the phase of P lags beyond the least lag that its gain admits. Of a stable plant
without delay and without zeros outside the unit circle, Bode's relation says this phase,

    phi(u_0) = 1/pi integral d ln|P| / du  ln coth(|u - u_0| / 2) du,    u = ln tan(omega Ts / 2),

H. W. Bode, Network Analysis and Feedback Amplifier Design (1945), for frequencies as the bilinear
transform maps them.
"""

import numpy as np
from scipy.interpolate import make_interp_spline

CHOOSE = "auto"  # in the place of L_max, of which None says that there is none
REACH = 4  # samples that the filter looks ahead beyond the delay of P, times cutoff Ts
FEWEST_TAPS, MOST_TAPS = 10, 60  # samples of the filter; with more the synthesis takes seconds,
TAPS_OF_K = 21  # of K, as many back as ahead: what is left for it when P B is nearly one
LEFT_TAPS = 20  # and is worth it only if fewer than these are left beyond the delay
# of the gain that inverts P: a finite filter overshoots it in some places to be close in others
ROOM = 4
COMPARED = 500  # frequencies, at most: n of them take n^2 numbers of memory
# The same where it decides b = 1 / (2 L_max) of L = B: M is 1 / (1 + 4 ROOM_OF_BASE^2) then.
# Of 18 plants 8 and 16 leave the same but for noise, of which 16 learns more.
ROOM_OF_BASE = 8
# of the gain that inverts P at low frequencies, there: beyond, what L gains is noise. Of the 32
# plants in figures/performance.md 29 are within 1.2 of the best law without it, 31 with 15 or 20
STATIC = 20
# Low frequencies end at this share of the cut-off. With 1/50 to 1/30 the same 31 are within 1.2.
# With the gain at rest in its place, 30; and of a plant whose time constants are 1 : 10,000, trial
# 2 leaves 4 times what it could, or the bounds are infeasible.
SLOW = 1 / 30
# of M_max: what b may leave of the error at any frequency. Without this, STATIC might make a design
# infeasible. From 0.6 / 0.9 on it changes none of the 32 plants, with a half two.
REMAINS = 2 / 3
PASSES_AT_REST = 0.01  # of the largest sigma_min(P): what is less at rest passes nothing there


def cutoff(Q, omega) -> float:
    """The cut-off of samples of Q: where they are down to one half for good, rad/s."""
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


def at_rest(smallest) -> float:
    """The smallest singular value of P at rest; zero if P passes nothing there."""
    return float(smallest[0]) if smallest[0] > PASSES_AT_REST * smallest.max() else 0.0


def gain(cutoff, smallest, omega) -> float:
    """ROOM times the largest gain that inverts P up to the cut-off, rounded up to one digit.

    `smallest`, (n,): the smallest singular value of P at omega.
    """
    exact = ROOM / _least(cutoff, smallest, omega)
    digit = 10.0 ** np.floor(np.log10(exact))
    return float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.0e}")


def gain_of_base(cutoff, smallest, omega, Q, M_max) -> float:
    """The bound on the gain of L = B, by which b = 1 / (2 L_max) is chosen.

    ROOM_OF_BASE times the largest gain that inverts P up to the cut-off, and at most STATIC times
    the largest that inverts P up to SLOW of it. With the b of that, |Q| b^2 / (sigma^2 + b^2) stays
    of the error, where sigma is the smallest singular value: if that were more than REMAINS M_max
    at some frequency, b is as much smaller. Q, (n,): its size at omega.
    """
    slow = smallest[omega <= max(SLOW * cutoff, omega[0])].min()
    above = smallest[omega >= SLOW * cutoff].max(initial=0)
    passes_at_rest = slow > PASSES_AT_REST * above
    by_noise = slow / (2 * STATIC) if passes_at_rest else 0.0
    remains = REMAINS * M_max
    passed = remains < Q
    by_error = smallest[passed] * np.sqrt(remains / (Q[passed] - remains))
    by_room = _least(cutoff, smallest, omega) / (2 * ROOM_OF_BASE)
    b = max(by_room, min(by_noise, by_error.min(initial=np.inf)))
    return float(1 / (2 * b))


def _least(cutoff, smallest, omega):
    """The smallest singular value of P up to the cut-off."""
    return min([np.interp(cutoff, omega, smallest), *smallest[omega <= cutoff]])


def order(cutoff, delay, Ts, frequencies) -> int:
    """The delay of P and REACH / (cutoff Ts), within limits; the grid determines half of it."""
    samples = max(FEWEST_TAPS, delay + np.ceil(REACH / (cutoff * Ts) - 1e-9))
    return int(min(samples, max(MOST_TAPS, delay + LEFT_TAPS), max(1, frequencies // 2)))


def delay(P, omega, Ts, cutoff) -> int:
    """Samples by which P lags at the cut-off beyond the least lag that its gain admits.

    Of each output by itself, with the inputs decoupled at the lowest frequency; the largest.
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 2:
        return 0
    corner = np.clip(cutoff, omega[1], omega[-1])
    [lag] = _lag(P, omega, Ts, np.array([corner]))
    return max(0, round(lag.max() / ((corner - omega[0]) * Ts)))


def lead(P, omega, Ts) -> float:
    """By how much the phase of P leads the least lag that its gain admits, in the mean, rad.

    No stable plant leads; but the samples' ends cut off Bode's integral, and a tenth of a radian,
    0.13 at most, remained of 50 plants. Of n > COMPARED samples 250 to 500 are compared: then
    independent noise of 1 rad in each phase moves the mean by 0.06 rad (standard deviation).
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 4:
        return 0.0
    at = omega[1 : -1 : 1 + len(omega) // COMPARED]
    return -_lag(P, omega, Ts, at).mean(axis=0).min()


def _lag(P, omega, Ts, at):
    """Phase by which each output lags at some frequencies beyond the least lag, (k, m), rad."""
    if P.shape[1] > P.shape[2]:  # of each input by itself, with the outputs combined
        P = P.swapaxes(1, 2)
    square = P.shape[1] == P.shape[2]
    response = np.einsum("nij,ji->ni", P, np.linalg.inv(P[0]) if square else np.linalg.pinv(P[0]))
    u, u_0 = (np.log(np.tan(np.minimum(x * Ts, np.pi) / 2)) for x in (omega, at))
    # The mean of ln coth(|u| / 2) over each step is the value in its middle, but for the step at
    # zero: there it is about -ln(|u| / 2), whose mean is its value at width / (2 e).
    distance = np.abs((u[1:] + u[:-1]) / 2 - u_0[:, None])
    kernel = -np.log(np.tanh(np.maximum(distance, np.diff(u) / (2 * np.e)) / 2))
    gain_steps = np.diff(np.log(np.abs(response) + np.finfo(float).tiny), axis=0)
    least = kernel @ gain_steps / np.pi  # Bode's relation
    return least - make_interp_spline(omega, np.unwrap(np.angle(response), axis=0), k=1)(at)
