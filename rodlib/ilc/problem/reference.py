"""What is to be learned of a reference: the spectrum of the first error, e_1 = (I - P) r."""

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from rodlib.ilc import arguments
from rodlib.ilc.problem.problem import Samples

FINER = 4  # than the signal's own are the lines of the spectrum that is integrated
FAINT = 1e-12  # share of the power of a signal that is rounding


def first_error(samples: Samples, reference, outputs) -> tuple[np.ndarray, np.ndarray]:
    """Power of e_1 at the frequencies, (n, m, m), in units of `scale` squared; and weights, (n,).

    The power is (I - P) S (I - P)^H, with the power S of r between the middles of neighbouring
    frequencies. However far apart these are, no narrow line is missed, and the traces of all S sum
    to the mean square of r. After the trial r returns to rest smoothly, in as many samples again: a
    task that ends elsewhere has no jump at its end. Weights are |E_1| d omega, and sum to one.
    """
    m = samples.plants.shape[-1]
    names = outputs or arguments.names_of(reference) or range(m)
    r = arguments.in_columns("reference", reference, ("time", m), names) / samples.scale
    count = len(r)
    back = np.cos(np.linspace(0, np.pi / 2, count)) ** 2
    r = np.concatenate([r, r[-1] * back[:, None]])
    length = 2 * next_fast_len(FINER * len(r), real=True)
    R = rfft(r, length, axis=0)
    power = R[:, :, None] * R[:, None].conj() / count
    angles = np.linspace(0, np.pi, len(R))
    below = cumulative_trapezoid(power, angles, axis=0, initial=0) / np.pi
    own = samples.omega * samples.Ts
    edges = np.concatenate([[0], (own[1:] + own[:-1]) / 2, [np.pi]])
    S = np.diff(make_interp_spline(angles, below, k=1)(edges), axis=0)
    left = np.eye(m) - samples.plants[0]
    power = left @ S @ left.conj().swapaxes(1, 2)
    share = np.trace(power, axis1=1, axis2=2).real
    if not share.sum() > 0:
        raise ValueError(
            "reference leaves no error in the first trial, so that nothing is to be learned: pass "
            "a reference that is not zero, or a band"
        )
    amplitude = np.sqrt(share.clip(0) * np.diff(edges))
    weights = np.where(share > FAINT * share.sum(), amplitude, 0)
    return power, weights / weights.sum()


def outputs_of(plant) -> list[str] | None:
    """Names of the outputs of a plant in any form, if it knows them."""
    loop = getattr(plant, "loop", plant)  # of a measured response
    return getattr(loop, "outputs", getattr(loop, "output_labels", None))
