"""What is chosen where nobody says otherwise: frequencies, their band, and a bound on the gain.

Of the paper's Q-filter, loop and sampling period they are what the paper chose: 1e-4 rad/s to the
Nyquist frequency, (1e-4, 0.02) rad/s, and 50.
"""

import reprlib

import control
import numpy as np

from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.loop.closed import Loop

CHOOSE = "auto"  # in the place of L_max, of which None says that there is none
FREQUENCIES = 1000
DECADES = 3  # from the lowest frequency up to the cut-off of Q
SHARE = 1 / 5  # of the cut-off, where the band ends: a Q of order two passes 99.8 %


def frequencies(P, Q, Ts) -> np.ndarray:
    """Design frequencies, rad/s: of samples their own, of models a logarithmic grid up to Nyquist.

    `P` is a list of plants; of a measured one the grid begins where it is known.
    """
    known = [
        plant.omega for plant in P if isinstance(plant, control.FrequencyResponseData)
    ]
    if known:
        return known[0]
    sampled = [plant for plant in P if not isinstance(plant, Loop | control.LTI)]
    if any(not hasattr(plant, "on") for plant in sampled):
        raise ValueError(
            "omega must be given: P is an array, which does not know its frequencies"
        )
    if not isinstance(Q, ZeroPhaseButterworth):
        raise ValueError(
            f"omega must be given, as Q = {reprlib.repr(Q)} is no filter, from whose cut-off a "
            "grid could be chosen"
        )
    lowest = [Q.cutoff / 10**DECADES]
    lowest += [
        plant.omega[getattr(plant, "known", plant.omega > 0)][0] for plant in sampled
    ]
    return np.geomspace(max(lowest), np.pi / Ts, FREQUENCIES)


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
