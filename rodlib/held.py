"""The rod behind a digital controller: between a zero-order hold and a sampler.

No model of it is approximated: what is left out is below the rounding of the numbers.
"""

from collections.abc import Sequence

import numpy as np

from ilctools import arguments
from rodlib.rod import Rod, exact_response, modes

POWERS = 64  # of 1 / z, for the fast modes; the square of a whole number


def sampled_response(rod: Rod, omega, Ts: float) -> np.ndarray:
    """Frequency response of the rod's equation (1)-(4) between a zero-order hold and a sampler.

    The modes cos(n pi z / l), n = 0, 1, ..., of the rod decay with s_n = -(kappa_2 + lambda
    (n pi / l)^2) / kappa_1. With r_n for the static response of mode n and p_n = exp(s_n Ts),

        G(z) = sum_n r_n (1 - p_n) / (z - p_n).

    The slow modes are summed like that. The others, infinitely many, have decayed after a few
    samples: together they have a short impulse response, g_1 / z + g_2 / z^2 + ... with

        g_k = sum_n r_n (1 - p_n) p_n^(k - 1).

    It falls as exp(-n^2), so that a few hundred modes are all that counts, but for the sum of all
    r_n in g_1. That is what the slow modes leave of :func:`exact_response` at zero.

    Parameters
    ----------
    rod : Rod
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency pi / Ts.
    Ts : float
        Sampling period, s.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex
        Inputs and outputs in the order of :func:`midr`; theta_a is held like the heat flows.

    See Also
    --------
    exact_response : in continuous time
    ClosedLoop.frequency_response : what takes such samples

    Notes
    -----
    What is left out of g_k, from mode N on, is below 1e-12 of the largest entry at each frequency.
    With r = 1 / (b h l kappa_2) and x = lambda (N pi / l)^2 Ts / kappa_1 there is |r_n| <= 2 r and
    p_n <= exp(-x n^2 / N^2), so that the sum over k of what is left out is at most

        4 r sum_{n >= N} p_n <= 4 r e^-x (1 + N / 2x).

    Slow are the first N / 8 modes. For the others p_n^64 obeys the bound of p_n with N / 8 in the
    place of N, so that what is left out from g_65 on is smaller still. The same flow from all
    sections excites the uniform mode alone, so that the largest entry is no smaller than
    r (1 - p_0) / 2; hence x = 40 - log(1 - p_0). The sum of all r_n is rounded to about 1e-16 r,
    which is below 1e-10 of the largest entry if Ts > 1e-5 kappa_1 / kappa_2, 3 ms for the paper's
    rig; with a shorter period that holds at low frequencies only.

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
    omega = arguments.row("omega", omega)
    if omega.min() < 0 or omega.max() > np.pi / Ts * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega.min():.6g}, {omega.max():.6g}] rad/s, but must lie in "
            f"[0, {np.pi / Ts:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    return HeldRod(rod, Ts).response(np.expm1(1j * omega * Ts), rod.inputs)


class HeldRod:
    """The rod of :func:`sampled_response`: its slow modes, and an impulse response for the others.

    Each section may get another heat flow than the one commanded, by its gain.
    """

    def __init__(self, rod: Rod, Ts: float, gains: Sequence[float] | None = None):
        total, slow = _mode_counts(rod, Ts)
        losses, means, values = modes(rod, np.arange(total))
        decay = losses * Ts / rod.kappa_1  # -s_n Ts
        r = np.zeros((total, len(rod.sensors), rod.sections + 1))
        norm = np.full(total, rod.width * rod.height * rod.length / 2)
        norm[0] *= 2  # integral of the square of the mode
        flows = means / (norm * losses)[:, None]
        r[:, :, :-1] = values[:, :, None] * flows[:, None]
        r[0, :, -1] = 1  # the air excites the uniform mode alone
        gains = np.append(np.ones(rod.sections) if gains is None else gains, 1)
        r *= gains

        first = -np.expm1(-decay)[:, None, None] * r  # g_1 of each mode
        powers = np.exp(-np.outer(np.arange(POWERS), decay[slow:]))
        self.inputs = rod.inputs
        self.decay = decay[:slow]
        self.slow = first[:slow]
        self.fast = np.tensordot(powers, first[slow:], axes=1)
        # Sum of r_n over the fast modes; small terms first, which loses fewer digits.
        static = exact_response(rod, 0.0)[0].real * gains
        rest = static - r[:slow][::-1].sum(axis=0)
        self.fast[0] = rest - np.tensordot(powers[1], r[slow:], axes=1)

    def response(self, step, inputs: Sequence[str], powers=None) -> np.ndarray:
        """G(z) at z = 1 + step from some inputs, shape (n, outputs, inputs).

        `powers`: those of :func:`inverse_powers` at `step`, which are the same for every rod.
        """
        columns = [self.inputs.index(name) for name in inputs]
        powers = inverse_powers(step) if powers is None else powers
        poles = np.expm1(-self.decay)  # p_n - 1
        slow = 1 / (step[:, None] - poles)
        response = np.tensordot(slow, self.slow[:, :, columns], axes=1)
        return response + np.tensordot(powers, self.fast[:, :, columns], axes=1)

    def impulse_response(self, count: int, inputs: Sequence[str]) -> np.ndarray:
        """g_0 = 0, g_1, ... of G(z) = g_1 / z + g_2 / z^2 + ..., (count, outputs, inputs)."""
        columns = [self.inputs.index(name) for name in inputs]
        powers = np.exp(-np.outer(np.arange(count - 1), self.decay))
        g = np.tensordot(powers, self.slow[:, :, columns], axes=1)
        g[:POWERS] += self.fast[: len(g), :, columns]
        return np.concatenate([np.zeros((1, *g.shape[1:])), g])


def inverse_powers(step) -> np.ndarray:
    """1 / z, 1 / z^2, ... at z = 1 + step, for the fast modes."""
    shape = len(step), POWERS
    return np.broadcast_to(1 / (1 + step[:, None]), shape).cumprod(axis=1)


def _mode_counts(rod, Ts):
    """How many modes count, N in the notes above, and how many of them are slow."""
    x = 40 - np.log(-np.expm1(-rod.kappa_2 * Ts / rod.kappa_1))
    N = rod.length / np.pi * np.sqrt(x * rod.kappa_1 / (rod.conductivity * Ts))
    if N > 1e5:
        raise ValueError(
            f"Ts = {Ts} is too short for this rod: {N:.3g} modes count, and 100,000 are "
            f"the limit. Take at least {Ts * (N / 1e5) ** 2:.3g} s"
        )
    return int(np.ceil(N)), int(np.ceil(N / np.sqrt(POWERS)))
