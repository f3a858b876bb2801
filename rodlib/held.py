"""The rod behind a digital controller: between a zero-order hold and a sampler.

The response is computed without an approximate model. The neglected part is smaller than the
rounding of numbers.
"""

import numpy as np

from ilctools import arguments
from rodlib.rod import Rod, exact_response, modes

MODES = 10_000  # largest number of summed modes: with 1000 frequencies they take 160 MB


def sampled_response(rod: Rod, omega, Ts: float) -> np.ndarray:
    """Compute the response of the rod's equation (1)-(4) between a zero-order hold and a sampler.

    Equations (1)-(4) are those of the paper. The modes cos(n pi z / l), n = 0, 1, ..., of the rod
    decay with s_n = -(kappa_2 + lambda (n pi / l)^2) / kappa_1. With r_n for the static response of
    mode n and p_n = exp(s_n Ts),

        G(z) = sum_n r_n (1 - p_n) / (z - p_n).

    The first N modes are summed in this way. All further modes, infinitely many, have decayed after
    one sample: p_n = 0. Together they act as a delay of one sample. Their gain is the part of
    :func:`exact_response` at zero that the first N modes do not give,

        G(z) = sum_{n < N} r_n (1 - p_n) / (z - p_n) + (G(s = 0) - sum_{n < N} r_n) / z.

    Parameters
    ----------
    rod : Rod
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency pi / Ts.
    Ts : float
        Sampling period, s; for the paper's rod 0.4 ms or more.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex
        Inputs and outputs are in the order of :func:`midr`. theta_a is held like the heat flows.

    See Also
    --------
    exact_response : the response in continuous time
    ClosedLoop.frequency_response : takes these samples as its plant

    Notes
    -----
    The poles p_n from mode N on are left out. The error is below 1e-12 of the largest entry at each
    frequency. Let r = 1 / (b h l kappa_2) and x = lambda (N pi / l)^2 Ts / kappa_1. Then
    |r_n| <= 2 r and p_n <= exp(-x n^2 / N^2), so that the error is at most

        4 r sum_{n >= N} p_n <= 4 r e^-x (1 + N / 2x).

    The same flow from all sections excites the uniform mode alone. The largest entry is therefore
    no smaller than r (1 - p_0) / 2, which gives x = 40 - log(1 - p_0). The sum of all r_n is
    rounded to about 1e-16 r. The rounding is below 1e-10 of the largest entry if
    Ts > 1e-5 kappa_1 / kappa_2, which is 3 ms for the paper's rig. With a shorter period, the
    rounding is that small at low frequencies only.

    Examples
    --------
    >>> from rodlib import Rod, paper_loop, sampled_response
    >>> rod, loop, omega = Rod(), paper_loop(), [0.001, 0.01]
    >>> G = sampled_response(rod, omega, loop.Ts)[:, :, [0, 2]]  # from Q1 and Q3
    >>> loop.frequency_response(omega, plant=G).shape
    (2, 2, 2)
    """
    arguments.instance("rod", rod, Rod)
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.up_to_nyquist("omega", arguments.row("omega", omega), Ts)
    x = 40 - np.log(-np.expm1(-rod.kappa_2 * Ts / rod.kappa_1))
    N = np.ceil(rod.length / np.pi * np.sqrt(x * rod.kappa_1 / (rod.conductivity * Ts)))
    N = arguments.whole(f"Ts = {Ts} s is too short: the number of modes N", int(N), 1, MODES)
    s, B, C = modes(rod, np.arange(N))
    r = C.T[:, :, None] * (B / -s[:, None])[:, None]
    # z - p_n, without cancellation where both are close to one
    z_minus_1 = np.expm1(1j * omega * Ts)[:, None]
    poles_minus_1 = np.expm1(s * Ts)
    G = np.tensordot(1 / (z_minus_1 - poles_minus_1), -poles_minus_1[:, None, None] * r, axes=1)
    # Small terms are added first, which loses fewer digits.
    others = exact_response(rod, 0.0)[0].real - r[::-1].sum(axis=0)
    return G + others / (1 + z_minus_1[:, :, None])
