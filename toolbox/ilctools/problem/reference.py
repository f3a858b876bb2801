"""What is to be learned of a reference: the spectrum of the first error, e_1 = (I - P) r.

With E(w) = sum_p e_1(p) exp(-j w p), w = omega Ts, Parseval's theorem is

    1/N sum_p e_1(p) e_1(p)' = 1 / (pi N) Re integral_0^pi E(w) E(w)* dw.

The integral between the middles of neighbouring frequencies is the power of e_1 at each of them.
"""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

FINER = 16  # times the signal's own lines are integrated, so that a narrow line is not missed
FADING = 10  # trials are so much longer than an error at their end takes to fade without a jump


def first_error(P, angles, r) -> tuple[np.ndarray, np.ndarray]:
    """Power of e_1 at the angles omega Ts, (n, m, m), and weights that sum to one, (n,).

    However far apart the frequencies are, no narrow line is missed, and the traces of the power sum
    to the mean square of e_1. It is of the trial: what the loop does after its end does not count.
    The weights are |E_1| d omega. `P`, (n, m, m), and `r`, (time, m), are in the same units; beyond
    the ends of `angles` P is taken as there.
    """
    fine, E = _spectrum(P, angles, r)
    density = E[:, :, None] * E[:, None].conj() / (np.pi * len(r))
    integral = cumulative_trapezoid(density, fine, axis=0, initial=0)
    edges = np.concatenate([[0], (angles[1:] + angles[:-1]) / 2, [np.pi]])
    power = np.diff(make_interp_spline(fine, integral, k=1)(edges), axis=0)
    share = np.trace(power, axis1=1, axis2=2).real
    if not share.sum() > 0:
        raise ValueError(
            "reference leaves no error in the first trial, so that nothing is to be learned: pass "
            "a reference that is not zero, or a band"
        )
    weights = np.sqrt(share.clip(0) * np.diff(edges))
    return power, weights / weights.sum()


def _spectrum(P, angles, r):
    """E of e_1 = (I - P) r at angles from 0 to pi; behind its end e_1 fades without a jump."""
    length = 2 * next_fast_len(FINER * len(r) // 2, real=True)
    fine = np.linspace(0, np.pi, length // 2 + 1)
    P = make_interp_spline(angles, P, k=1)(np.clip(fine, angles[0], angles[-1]))
    R = rfft(r, length, axis=0)[..., None]
    e = irfft((R - P @ R)[..., 0], length, axis=0)[: len(r)]
    fading = np.cos(np.linspace(0, np.pi / 2, len(r) // FADING)) ** 2
    return fine, rfft(np.concatenate([e, fading[:, None] * e[-1]]), length, axis=0)
