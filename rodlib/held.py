"""The rod behind a digital controller: between a zero-order hold and a sampler.

No model of it is approximated: what is left out is below the rounding of the numbers.
"""

from collections.abc import Sequence

import numpy as np

from rodlib.ilc import arguments
from rodlib.rod import Rod, exact_response

POWERS = 64  # of 1 / z; the square of a whole number


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
    """
    arguments.instance("rod", rod, Rod)
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.row("omega", omega)
    if omega.min() < 0 or omega.max() > np.pi / Ts * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega.min():.6g}, {omega.max():.6g}] rad/s, but must lie in "
            f"[0, {np.pi / Ts:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    step = np.expm1(1j * omega * Ts)
    return HeldRod(rod, Ts).response(step, delays(step), rod.inputs)


def delays(step) -> np.ndarray:
    """1 / z, 1 / z^2, ... at z = 1 + `step`, shape (n, POWERS), for :class:`HeldRod`."""
    return np.cumprod(
        np.broadcast_to(1 / (1 + step[:, None]), (len(step), POWERS)), axis=1
    )


class HeldRod:
    """The rod of :func:`sampled_response`: its slow modes, and an impulse response for the others.

    Each section may get another heat flow than the one commanded, by its gain.
    """

    def __init__(self, rod: Rod, Ts: float, gains: Sequence[float] | None = None):
        decay = Ts / rod.kappa_1
        x = 40 - np.log(-np.expm1(-rod.kappa_2 * decay))
        modes = rod.length / np.pi * np.sqrt(x / (rod.conductivity * decay))
        if modes > 1e5:
            raise ValueError(
                f"Ts = {Ts} is too short for this rod: {modes:.3g} modes count, and 100,000 are "
                f"the limit. Take at least {Ts * (modes / 1e5) ** 2:.3g} s"
            )
        n = np.arange(int(np.ceil(modes)))
        slow = int(np.ceil(modes / np.sqrt(POWERS)))
        rate = (
            rod.kappa_2 + rod.conductivity * (n * np.pi / rod.length) ** 2
        )  # -s_n kappa_1
        middles = (np.arange(rod.sections) + 0.5) / rod.sections
        shown = np.cos(np.outer(n * np.pi / rod.length, rod.sensors))
        flows = (
            np.cos(np.outer(n * np.pi, middles))
            * np.sinc(n / 2 / rod.sections)[:, None]
        )
        flows *= (np.where(n, 2, 1) / (rod.width * rod.height * rod.length * rate))[
            :, None
        ]
        r = np.zeros((len(n), len(rod.sensors), rod.sections + 1))
        r[:, :, :-1] = shown[:, :, None] * flows[:, None]
        r[0, :, -1] = 1  # the air excites the uniform mode alone

        gains = np.append(np.ones(rod.sections) if gains is None else gains, 1)
        r *= gains

        less_one = np.expm1(-rate * decay)  # p_n - 1
        first = -less_one[:, None, None] * r  # g_1 of each mode
        powers = np.exp(-np.outer(np.arange(POWERS + 1), rate[slow:] * decay))
        self.names = rod.inputs
        self.less_one, self.decay = less_one[:slow], rate[:slow] * decay
        self.slow, self.fast = (
            first[:slow],
            np.tensordot(powers[:-1], first[slow:], axes=1),
        )
        # What the slow modes leave of the sum of all r_n; small ones first, for fewer digits go.
        rest = exact_response(rod, 0.0)[0].real * gains - r[:slow][::-1].sum(axis=0)
        self.fast[0] = rest - np.tensordot(powers[1], r[slow:], axes=1)

    def response(self, step, delays, inputs: Sequence[str]) -> np.ndarray:
        """G(z) at z = 1 + step for some inputs, shape (n, outputs, inputs); `delays` of `step`."""
        slow, fast = self._of(inputs)
        response = (1 / (step[:, None] - self.less_one)) @ slow.reshape(len(slow), -1)
        response += delays @ fast.reshape(len(fast), -1)
        return response.reshape(len(step), *slow.shape[1:])

    def impulse_response(self, samples: int, inputs: Sequence[str]) -> np.ndarray:
        """g_0 = 0, g_1, ... of G(z) = g_1 / z + g_2 / z^2 + ..., (outputs, inputs, samples)."""
        slow, fast = self._of(inputs)
        block = int(np.ceil(np.sqrt(samples)))
        steps = np.arange(block) * self.decay[:, None]
        powers = (
            np.exp(-block * steps)[:, :, None] * np.exp(-steps)[:, None]
        )  # p^(block i + j)
        g = np.zeros((*slow.shape[1:], block**2 + 1))
        g[:, :, 1:] = np.tensordot(slow, powers.reshape(len(slow), -1), axes=(0, 0))
        g[:, :, 1 : POWERS + 1] += np.moveaxis(fast, 0, -1)[:, :, : block**2]
        return g[:, :, :samples]

    def _of(self, inputs):
        wanted = [self.names.index(name) for name in inputs]
        return self.slow[:, :, wanted], self.fast[:, :, wanted]
