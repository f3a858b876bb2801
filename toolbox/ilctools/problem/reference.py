"""What is to be learned of a reference: the spectrum of the first error, e_1 = (I - P) r.

With E(w) = sum_p e_1(p) exp(-j w p), w = omega Ts, Parseval's theorem is

    1/N sum_p e_1(p) e_1(p)' = 1 / (pi N) Re integral_0^pi E(w) E(w)* dw.

The integral between the middles of neighbouring frequencies is the power of e_1 at each of them.
"""

import numpy as np
from scipy.fft import irfft, rfft
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

FINER = 16  # times the signal's own lines are summed, so that a narrow line is not missed
FADING = 10  # trials are so much longer than an error at their end takes to fade without a jump
TRIALS = 10  # whose error is predicted


def first_error(P, angles, r) -> tuple[np.ndarray, np.ndarray]:
    """Power of e_1 at the angles omega Ts, (n, m, m), and weights that sum to one, (n,).

    However far apart the frequencies are, no narrow line is missed, and the traces of the power sum
    to the mean square of e_1. It is of the trial: what the loop does after its end does not count.
    The weights are |E_1| d omega. `P`, (n, m, m), and `r`, (time, m), are in the same units; beyond
    the ends of `angles` P is taken as there.
    """
    fine, E = error_spectrum(P, angles, r)
    density = E[:, :, None] * E[:, None].conj() / (np.pi * len(r))
    up_to = cumulative_trapezoid(density, fine, axis=0, initial=0)
    edges = np.concatenate([[0], (angles[1:] + angles[:-1]) / 2, [np.pi]])
    power = np.diff(make_interp_spline(fine, up_to, k=1)(edges), axis=0)
    weights = np.sqrt(np.trace(power, axis1=1, axis2=2).real.clip(0) * np.diff(edges))
    if not weights.any():
        raise ValueError(
            "reference leaves no error in the first trial, so that nothing is to be learned: pass "
            "a reference that is not zero, or a band"
        )
    return power, weights / weights.sum()


def error_spectrum(P, angles, r):
    """Angles from 0 to pi, and E there; behind its end e_1 fades along a straight line."""
    N, length = len(r), FINER * len(r)
    fine = np.linspace(0, np.pi, length // 2 + 1)
    P = make_interp_spline(angles, P, k=1)(fine.clip(angles[0], angles[-1]))
    R = rfft(r, length, axis=0)[..., None]
    e = irfft((R - P @ R)[..., 0], length, axis=0)[:N]
    faded = np.pad(e, [(0, N // FADING), (0, 0)], mode="linear_ramp")
    return fine, rfft(faded, length, axis=0)


def predicted_rms(problem, L) -> dict[int, float]:
    """RMS of the error in trials 1 to 10, in the plant's units, from the power of the first.

    Of the nominal plant, by the law (23), e_{k+1} = M e_k + (1 - Q) e_1: where Q is less than one,
    a part of the first error stays. Without noise, and for trials without ends.
    """
    M, rms = problem.M(L.frequency_response(problem.omega)), {}
    T = one = np.eye(problem.channels)  # e_k = T e_1
    for trial in range(1, TRIALS + 1):
        power = (T @ problem.objective.first_error * T.conj()).sum(axis=(0, 2)).real
        rms[trial] = float(np.sqrt(problem.scale**2 @ power))
        T = M @ T + (1 - problem.Q)[:, None, None] * one
    return rms
