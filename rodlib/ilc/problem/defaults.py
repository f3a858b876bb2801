"""Default band of the sum (39), and default bound on the gain.

Of the paper's Q-filter and loop they are what the paper chose: (1e-4, 0.02) rad/s, and 50.
"""

import numpy as np

CHOOSE = "auto"  # in the place of L_max, of which None says that there is none
SHARE = 1 / 5  # of the cut-off, where the band ends: a Q of order two passes 99.8 %


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
    """From the lowest frequency above zero to a fifth of the cut-off, or to the cut-off."""
    low, *higher = omega[omega > 0].tolist()
    end = SHARE * cutoff if SHARE * cutoff > higher[0] else cutoff
    return low, float(min(max(end, higher[0]), omega[-1]))


def gain(cutoff, smallest, omega) -> float:
    """The gain that inverts P at the cut-off, rounded up to one digit.

    `smallest`, (n,): the smallest singular value of P at omega.
    """
    exact = 1 / np.interp(cutoff, omega, smallest)
    digit = 10.0 ** np.floor(np.log10(exact))
    return float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.0e}")
