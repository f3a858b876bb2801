"""The law (23) of the paper without a reset between trials: repetitive control.

Let N be the period in samples and a the learning gain. If a trial follows the last one without a
reset, the law is

    v(t) = (1 - a) v(t - N) + a Q (v + L e)(t - N).

Theorem. Let Q be scalar, the loop internally stable and P the same at all times. Let N be larger
than the number of samples by which Q and L look ahead. Let M = Q (I - P L), and
sigma_max(M) <= gamma < 1 at every frequency. Then the state and v converge exponentially to one
periodic motion, for any reference and disturbance of period N. The initial condition may be any.
Let e_0 be the error without learning. For a = 1

    e(t) = M e(t - N) + f(t),    f(t) = e_0(t) - Q e_0(t - N) + P w(t),
    ||e|| <= ||f|| / (1 - gamma)

where ||.||^2 is the energy of a signal from the start to any time. Here
w(t) = Q (v + L e)(t - N) - v(t) is the part of the law's signal that no trial applies. This part
belongs to the first period. It covers the samples after t = N that Q and L look ahead to, and the
samples before t = N that Q looks back to. In the periodic motion, the bound holds for every a, with
RMS values as norms and f = (1 - Q) e_0. If the period of a signal differs from N by a fraction p,
about 2 sin(pi k p) of its harmonic k remains. The law cannot detect a wrong period.

Proof. Because det(I - XY) = det(I - YX), v has the characteristic equation det(I - z^-N M(z)) = 0.
With a learning gain, M is replaced by M_a = (1 - a) I + a M, and
sigma_max(M_a) <= 1 - a + a gamma < 1. By the choice of N, z^-N M(z) is causal. This product is
analytic in |z| >= 1, because P is analytic there. By the maximum principle, the largest singular
value of the product in |z| >= 1 is at most gamma. Therefore no root lies in |z| >= 1 (small gain).
The equation of e follows from P v = e_0 - e, because Q commutes with P. The delayed M is causal and
has the norm gamma.

:func:`ilctools.synthesise` with ``everywhere=True`` proves the condition also between the
frequencies of its grid. The theorem does not cover limits at which commands saturate, nor a shorter
N.
"""

from functools import lru_cache

import numpy as np
from scipy.signal import oaconvolve

from ilctools import arguments
from ilctools.filters import Composition, LearningFilter, ZeroPhaseButterworth
from ilctools.law.law import Law

NEGLIGIBLE_OF_M = 1e-6  # largest error of M by truncating the response of Q, if P is at most one


def finite_response(law: Law) -> np.ndarray:
    """Return the impulse response of Q, symmetric in time, truncated where it is negligible.

    The truncation causes an error of M = Q (I - P L), which is proportional to the size of L. A
    larger L therefore needs a longer response.
    """
    gain = np.linalg.norm(np.abs(law.L.coefficients).sum(axis=2), 2)
    return _cut(law.Q, NEGLIGIBLE_OF_M / max(1.0, gain))


@lru_cache(maxsize=4)
def _cut(Q: ZeroPhaseButterworth, share: float) -> np.ndarray:
    """Return the impulse response of Q without its ends.

    The samples that are cut away sum up to the fraction `share`.
    """
    impulse = np.zeros((2 * Q.decay + 1, 1))
    impulse[Q.decay] = 1
    h = Q.apply(impulse)[:, 0]
    cut = np.searchsorted(2 * np.cumsum(np.abs(h[: Q.decay])), share)
    return h[cut : len(h) - cut]


def reach_ahead(law: Law) -> int:
    """Return the number of samples by which the law looks ahead in the previous trial."""
    return len(finite_response(law)) // 2 + max(0, law.L.last)


def check_period(law: Law, period: int) -> None:
    """Check that a law can act without reset on trials of `period` samples."""
    if law.L is None:
        return
    if law.rest:
        raise ValueError(
            f"rest = {law.rest}, but without reset a trial has no end at which v "
            "could rest: take rest=0"
        )
    if isinstance(law.L, Composition):
        reach = (period - len(_cut(law.Q, NEGLIGIBLE_OF_M)) // 2) // 2
        raise ValueError(
            "L = B K has a B that is made for trials with ends: for trials without reset, "
            f"synthesise with reach={reach} or less, or with base=None"
        )
    arguments.instance("L", law.L, LearningFilter)
    shortest = reach_ahead(law) + 1
    if period < shortest:
        raise ValueError(
            f"reference has {period} samples per trial, but without reset it needs {shortest} "
            "or more, because Q and L look ahead by so many samples: take a longer period, or "
            "several periods as one trial, a higher cut-off of Q, or a lower order"
        )


def memory(law: Law, period: int) -> float:
    """Return the number of past samples on which a sample of v may depend."""
    if law.L is None:
        return np.inf
    return period + len(finite_response(law)) + max(0, -law.L.first)


def next_samples(law: Law, v, e, first) -> np.ndarray:
    """Compute the next samples of v, as many as v and e of all earlier samples determine."""
    period, now, a = len(first), len(v), law.gain
    if law.L is None or now < period:
        return first[now % period :]
    h = finite_response(law)
    x = np.pad(v + law.L.apply(e), [(len(h) // 2, 0), (0, 0)])  # at rest before the first trial
    begin, end = now - period, now - reach_ahead(law)  # a period before the next samples
    x = x[begin : end + len(h) - 1]
    return (1 - a) * v[begin:end] + a * oaconvolve(x, h[:, None], "valid", axes=0)
