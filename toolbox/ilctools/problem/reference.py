"""What is to be learned of a reference: the spectrum of the first error, e_1 = (I - P) r."""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from ilctools import arguments
from ilctools.problem.problem import Samples

FINER = 16  # than the signal's own are the lines of the spectrum that is integrated
FADING = 10  # trials are so much longer than an error at their end takes to fade


def first_error(samples: Samples, reference) -> tuple[np.ndarray, np.ndarray]:
    """Power of e_1 at the frequencies, (n, m, m), in units of `scale` squared; and weights, (n,).

    The power is that between the middles of neighbouring frequencies: however far apart these are,
    no narrow line is missed, and the traces sum to the mean square of e_1. It is of the trial: what
    the loop does after its end does not count, and an error there fades without a jump. Weights
    are |E_1| d omega, and sum to one.
    """
    m, own = samples.plants.shape[-1], samples.omega * samples.Ts
    names = samples.labels.labels[:m] or arguments.names_of(reference) or range(m)
    r = arguments.in_columns("reference", reference, ("time", m), names) / samples.scale
    length = 2 * next_fast_len(FINER * len(r) // 2, real=True)
    angles = np.linspace(0, np.pi, length // 2 + 1)
    between = np.clip(angles, own[0], own[-1])
    P = make_interp_spline(own, samples.plants[0], k=1)(between)
    R = rfft(r, length, axis=0)[..., None]
    e = irfft((R - P @ R)[..., 0], length, axis=0)[: len(r)]
    fading = np.cos(np.linspace(0, np.pi / 2, len(r) // FADING)) ** 2
    E = rfft(np.concatenate([e, fading[:, None] * e[-1]]), length, axis=0)
    density = E[:, :, None] * E[:, None].conj() / (np.pi * len(r))
    below = cumulative_trapezoid(density, angles, axis=0, initial=0)
    edges = np.concatenate([[0], (own[1:] + own[:-1]) / 2, [np.pi]])
    power = np.diff(make_interp_spline(angles, below, k=1)(edges), axis=0)
    share = np.trace(power, axis1=1, axis2=2).real
    if not share.sum() > 0:
        raise ValueError(
            "reference leaves no error in the first trial, so that nothing is to be learned: pass "
            "a reference that is not zero, or a band"
        )
    weights = np.sqrt(share.clip(0) * np.diff(edges))
    return power, weights / weights.sum()
