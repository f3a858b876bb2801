"""Choose defaults from P and Q: the band of the sum (39) of the paper, order and gain of L.

The defaults suit plants of which only the frequency response is known. A filter that inverts P
looks ahead by the delay of P, and by an additional time that is proportional to the time constant
of Q:

    order = delay + REACH / (cutoff Ts),    L_max = ROOM / min sigma_min(P) up to the cut-off.

Here REACH and ROOM are constants, cutoff is the cut-off of Q, and Ts is the sampling period. The
delay is computed from the phase lag of P in excess of the least lag that a plant with the same gain
can have. The least lag is the lag of a stable plant without delay and without zeros outside the
unit circle. Bode's relation gives the phase of such a plant,

    phi(u_0) = 1/pi integral d ln|P| / du  ln coth(|u - u_0| / 2) du,    u = ln tan(omega Ts / 2),

see H. W. Bode, Network Analysis and Feedback Amplifier Design (1945). The bilinear transform maps
the frequencies of the sampled plant to the frequencies of Bode's relation.
"""

import numpy as np
from scipy.interpolate import make_interp_spline

CHOOSE = "auto"  # L_max = "auto": the bound is chosen here. L_max = None: there is no bound
REACH = 4  # cutoff Ts times the samples that the filter looks ahead beyond the delay of P
FEWEST_TAPS, MOST_TAPS = 10, 60  # samples of the filter; with more, the synthesis takes seconds
TAPS_OF_K = 21  # samples of K in L = B K, as many back as ahead: enough if P B is nearly one
LEFT_TAPS = 20  # after a long delay, the order is at most the delay plus so many samples
# L_max relative to the gain that inverts P: a finite filter exceeds this gain at some frequencies
ROOM = 4
COMPARED = 500  # frequencies at most in `lead`: n frequencies take n^2 numbers of memory
# As ROOM, for L = B, where L_max decides b = 1 / (2 L_max). M is then 1 / (1 + 4 ROOM_OF_BASE^2).
# For 18 plants, the factors 8 and 16 leave the same error except for noise. 16 learns more noise.
ROOM_OF_BASE = 8
# Largest L_max relative to the gain that inverts P at low frequencies: a larger L mainly amplifies
# noise. Without this limit, 29 of the 32 plants in figures/performance.md are within a factor of
# 1.2 of the best law. With a limit of 15 or 20, 31 plants are.
STATIC = 20
# Low frequencies end at this share of the cut-off. With shares from 1/50 to 1/30, the same 31
# plants are within a factor of 1.2. If the gain at rest is used instead, 30 plants are. For a plant
# whose time constants are 1 : 10,000, trial 2 then leaves 4 times the error that it could leave, or
# the bounds are infeasible.
SLOW = 1 / 30
# With b, this share of M_max is the largest share of the error that may remain at any frequency.
# Without this limit, STATIC might make a design infeasible. From 0.6 / 0.9 on, the limit changes
# the design of none of the 32 plants; a half changes two designs.
REMAINS = 2 / 3
# P passes nothing at rest if sigma_min(P) there is less than this share of the largest sigma_min(P)
PASSES_AT_REST = 0.01


def cutoff(Q, omega) -> float:
    """Return the frequency above which a sampled |Q| stays below one half, rad/s."""
    size = np.abs(Q)
    passed = np.flatnonzero(size >= 0.5)
    if not len(passed) or passed[-1] == len(omega) - 1:
        return float(omega[-1])
    at = slice(passed[-1], passed[-1] + 2)
    return float(np.interp(-0.5, -size[at], omega[at]))


def band(cutoff, omega) -> tuple[float, float]:
    """Return the default band: from the lowest frequency above zero to the cut-off, rad/s."""
    low, *higher = omega[omega > 0].tolist()
    return low, float(min(max(cutoff, higher[0]), omega[-1]))


def at_rest(smallest) -> float:
    """Return the smallest singular value of P at the lowest frequency.

    If this value is negligible, return zero.

    `smallest` (n,) is the smallest singular value of P at each frequency, the lowest first. The
    value at the lowest frequency is negligible if it is below `PASSES_AT_REST` times the largest
    value.
    """
    return float(smallest[0]) if smallest[0] > PASSES_AT_REST * smallest.max() else 0.0


def gain(cutoff, smallest, omega) -> float:
    """Return the default L_max of a finite filter, rounded up to one digit.

    L_max is ROOM times the largest gain that inverts P up to the cut-off.

    `smallest` (n,) is the smallest singular value of P at omega.
    """
    exact = ROOM / _least(cutoff, smallest, omega)
    digit = 10.0 ** np.floor(np.log10(exact))
    return float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.0e}")


def gain_of_base(cutoff, smallest, omega, Q, M_max) -> float:
    """Return the default L_max for L = B, from which b = 1 / (2 L_max) follows.

    B = (P* P + b^2)^-1 P* is the regularised inverse of P. L_max is ROOM_OF_BASE times the largest
    gain that inverts P up to the cut-off. L_max is also at most STATIC times the largest gain that
    inverts P up to SLOW times the cut-off. The second limit may increase b. With this b, a share
    |Q| b^2 / (sigma^2 + b^2) of the error remains, where sigma is the smallest singular value of P.
    If this share exceeds REMAINS M_max at some frequency, b is reduced until the share no longer
    exceeds this limit. But b is not reduced below the b that follows from ROOM_OF_BASE alone.
    `smallest` (n,) is sigma, and `Q` (n,) is |Q| at omega.
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
    """Return the smallest singular value of P at all frequencies up to the cut-off."""
    return min([np.interp(cutoff, omega, smallest), *smallest[omega <= cutoff]])


def order(cutoff, delay, Ts, frequencies) -> int:
    """Return the default order: the delay of P plus REACH / (cutoff Ts) samples.

    The order has a lower and an upper limit.

    The order is at most half the number of frequencies.
    """
    samples = max(FEWEST_TAPS, delay + np.ceil(REACH / (cutoff * Ts) - 1e-9))
    return int(min(samples, max(MOST_TAPS, delay + LEFT_TAPS), max(1, frequencies // 2)))


def delay(P, omega, Ts, cutoff) -> int:
    """Return the delay of P at the cut-off, in samples.

    The delay follows from the phase lag in excess of the least lag that the gain of P allows. The
    delay is computed for each output, after the inputs are combined so that P is the identity at
    the lowest frequency. The largest delay counts.
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 2:
        return 0
    corner = np.clip(cutoff, omega[1], omega[-1])
    [lag] = _lag(P, omega, Ts, np.array([corner]))
    return max(0, round(lag.max() / ((corner - omega[0]) * Ts)))


def lead(P, omega, Ts) -> float:
    """Return by how much the phase of P leads the phase with the least lag for its gain, rad.

    The lead is the mean over the frequencies. A stable plant has no lead. But Bode's integral is
    truncated at the last sample. For 50 plants, the truncation caused an error of a tenth of a
    radian. The largest error was 0.13 rad. If there are n > COMPARED samples, the phase is compared
    at 250 to 500 of these samples. Independent noise of 1 rad in each phase then gives the mean a
    standard deviation of 0.06 rad.
    """
    P, omega = P[omega > 0], omega[omega > 0]
    if len(omega) < 4:
        return 0.0
    at = omega[1 : -1 : 1 + len(omega) // COMPARED]
    return -_lag(P, omega, Ts, at).mean(axis=0).min()


def _lag(P, omega, Ts, at):
    """Compute the phase lag of each output in excess of the least lag, (k, m), rad.

    `at` selects the k frequencies.
    """
    if P.shape[1] > P.shape[2]:  # then compute the lag for each input, with the outputs combined
        P = P.mT
    square = P.shape[1] == P.shape[2]
    response = np.einsum("nij,ji->ni", P, np.linalg.inv(P[0]) if square else np.linalg.pinv(P[0]))
    u, u_0 = (np.log(np.tan(np.minimum(x * Ts, np.pi) / 2)) for x in (omega, at))
    # The mean of ln coth(|u| / 2) over a step is the value in its middle, except for the step at
    # zero. At zero the function is about -ln(|u| / 2), whose mean is its value at width / (2 e).
    distance = np.abs((u[1:] + u[:-1]) / 2 - u_0[:, None])
    kernel = -np.log(np.tanh(np.maximum(distance, np.diff(u) / (2 * np.e)) / 2))
    gain_steps = np.diff(np.log(np.abs(response) + np.finfo(float).tiny), axis=0)
    least = kernel @ gain_steps / np.pi  # Bode's relation
    return least - make_interp_spline(omega, np.unwrap(np.angle(response), axis=0), k=1)(at)
