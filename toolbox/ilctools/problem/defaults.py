"""Choose the defaults from P and Q: band of the sum (39), order of the filter, bound on its gain.

The defaults are for a plant that one does not know. A filter that inverts P looks ahead by the
delay of P, and further by a share of the time constant of Q:

    order = delay + REACH / (cutoff Ts),    L_max = ROOM / min sigma_min(P) up to the cut-off.

The delay is the phase lag of P beyond the least lag that the gain of P admits. For a stable plant
without delay and without zeros outside the unit circle, Bode's relation gives the phase,

    phi(u_0) = 1/pi integral d ln|P| / du  ln coth(|u - u_0| / 2) du,    u = ln tan(omega Ts / 2),

H. W. Bode, Network Analysis and Feedback Amplifier Design (1945), for frequencies as the bilinear
transform maps them.
"""

import numpy as np
from scipy.interpolate import make_interp_spline

CHOOSE = "auto"  # as L_max: choose the bound here. L_max = None means no bound
REACH = 4  # samples that the filter looks ahead beyond the delay of P, times cutoff Ts
FEWEST_TAPS, MOST_TAPS = 10, 60  # samples of the filter; with more, the synthesis takes seconds,
TAPS_OF_K = 21  # of K, as many back as ahead: enough if P B is nearly one
LEFT_TAPS = 20  # which is worth it only if fewer than these are left beyond the delay
# times the gain that inverts P: a finite filter exceeds this gain at some frequencies
ROOM = 4
COMPARED = 500  # frequencies at most: n frequencies take n^2 numbers of memory
# The same factor if it decides b = 1 / (2 L_max) of L = B. M is then 1 / (1 + 4 ROOM_OF_BASE^2).
# For 18 plants, 8 and 16 leave the same error except for noise. 16 learns more noise.
ROOM_OF_BASE = 8
# times the gain that inverts P at low frequencies: a larger L gains only noise. 29 of the 32 plants
# in figures/performance.md are within 1.2 of the best law without this limit, 31 with 15 or 20
STATIC = 20
# Low frequencies end at this share of the cut-off. With 1/50 to 1/30, the same 31 are within 1.2.
# With the gain at rest instead, 30 are. For a plant whose time constants are 1 : 10,000, trial 2
# then leaves 4 times the error that it could, or the bounds are infeasible.
SLOW = 1 / 30
# share of M_max, which b may leave of the error at any frequency. Without this limit, STATIC might
# make a design infeasible. From 0.6 / 0.9 on, the limit changes none of the 32 plants; a half
# changes two.
REMAINS = 2 / 3
PASSES_AT_REST = 0.01  # of the largest sigma_min(P): P passes nothing at rest if its value is less


def cutoff(Q, omega) -> float:
    """Return the cut-off of samples of Q, rad/s: above, |Q| stays below one half."""
    size = np.abs(Q)
    passed = np.flatnonzero(size >= 0.5)
    if not len(passed) or passed[-1] == len(omega) - 1:
        return float(omega[-1])
    at = slice(passed[-1], passed[-1] + 2)
    return float(np.interp(-0.5, -size[at], omega[at]))


def band(cutoff, omega) -> tuple[float, float]:
    """Return the band from the lowest frequency above zero to the cut-off, rad/s."""
    low, *higher = omega[omega > 0].tolist()
    return low, float(min(max(cutoff, higher[0]), omega[-1]))


def at_rest(smallest) -> float:
    """Return the smallest singular value of P at rest; zero if P passes nothing there."""
    return float(smallest[0]) if smallest[0] > PASSES_AT_REST * smallest.max() else 0.0


def gain(cutoff, smallest, omega) -> float:
    """Return ROOM times the largest gain that inverts P up to the cut-off, rounded up to one digit.

    `smallest` (n,) is the smallest singular value of P at omega.
    """
    exact = ROOM / _least(cutoff, smallest, omega)
    digit = 10.0 ** np.floor(np.log10(exact))
    return float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.0e}")


def gain_of_base(cutoff, smallest, omega, Q, M_max) -> float:
    """Return the bound on the gain of L = B, which gives b = 1 / (2 L_max).

    The bound is ROOM_OF_BASE times the largest gain that inverts P up to the cut-off, and at most
    STATIC times the largest gain that inverts P up to SLOW times the cut-off. With the b of this
    limit, a share |Q| b^2 / (sigma^2 + b^2) of the error remains, where sigma is the smallest
    singular value. If this share exceeds REMAINS M_max at some frequency, b is reduced until the
    share does not, but not below the b of the first bound. `Q` (n,) is |Q| at omega.
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
    """Return the delay of P plus REACH / (cutoff Ts), within limits and at most frequencies / 2."""
    samples = max(FEWEST_TAPS, delay + np.ceil(REACH / (cutoff * Ts) - 1e-9))
    return int(min(samples, max(MOST_TAPS, delay + LEFT_TAPS), max(1, frequencies // 2)))


def delay(P, omega, Ts, cutoff) -> int:
    """Return the delay of P at the cut-off, in samples, beyond the least lag that its gain admits.

    The delay is computed for each output, with the inputs decoupled at the lowest frequency. The
    largest delay counts.
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 2:
        return 0
    corner = np.clip(cutoff, omega[1], omega[-1])
    [lag] = _lag(P, omega, Ts, np.array([corner]))
    return max(0, round(lag.max() / ((corner - omega[0]) * Ts)))


def lead(P, omega, Ts) -> float:
    """Return the mean lead of the phase of P over the least lag that its gain admits, rad.

    No stable plant leads. But the samples end, and this cuts off Bode's integral: with 50 plants,
    an error of a tenth of a radian, and 0.13 at most, remained. If there are n > COMPARED samples,
    250 to 500 are compared. Independent noise of 1 rad in each phase then moves the mean by
    0.06 rad (standard deviation).
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 4:
        return 0.0
    at = omega[1 : -1 : 1 + len(omega) // COMPARED]
    return -_lag(P, omega, Ts, at).mean(axis=0).min()


def _lag(P, omega, Ts, at):
    """Phase lag of each output beyond the least lag, at some frequencies, (k, m), rad."""
    if P.shape[1] > P.shape[2]:  # then for each input, with the outputs combined
        P = P.swapaxes(1, 2)
    square = P.shape[1] == P.shape[2]
    response = np.einsum("nij,ji->ni", P, np.linalg.inv(P[0]) if square else np.linalg.pinv(P[0]))
    u, u_0 = (np.log(np.tan(np.minimum(x * Ts, np.pi) / 2)) for x in (omega, at))
    # The mean of ln coth(|u| / 2) over a step is the value in its middle, except for the step at
    # zero. There the function is about -ln(|u| / 2), whose mean is the value at width / (2 e).
    distance = np.abs((u[1:] + u[:-1]) / 2 - u_0[:, None])
    kernel = -np.log(np.tanh(np.maximum(distance, np.diff(u) / (2 * np.e)) / 2))
    gain_steps = np.diff(np.log(np.abs(response) + np.finfo(float).tiny), axis=0)
    least = kernel @ gain_steps / np.pi  # Bode's relation
    return least - make_interp_spline(omega, np.unwrap(np.angle(response), axis=0), k=1)(at)
