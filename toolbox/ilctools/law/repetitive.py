"""The law (23) for trials that follow each other without a reset: repetitive control.

With a period of N samples and the learning gain a, in endless time,

    v(t) = (1 - a) v(t - N) + a Q (v + L e)(t - N).

Theorem. Let Q be scalar, the loop internally stable, P the same at all times, and N larger than Q
and L reach ahead. If sigma_max(M) <= gamma < 1 at every frequency, M = Q (I - P L), then state and
v tend exponentially, from any start and for any reference and disturbance of period N, to those of
one periodic motion. With e_0 the error without learning, for a = 1

    e(t) = M e(t - N) + f(t),    f(t) = e_0(t) - Q e_0(t - N) + P w(t),
    ||e|| <= ||f|| / (1 - gamma)

in energy from the start to any time. Here w(t) = Q (v + L e)(t - N) - v(t) is what no trial applies
of it: of the first period, as far as Q and L reach ahead of t = N, and Q back from it. In the
periodic motion, whatever a is, the bound holds as RMS with f = (1 - Q) e_0. Of a signal whose
period is off by a share p, harmonic k leaves some 2 sin(pi k p) of itself; nothing warns of that.

Proof. As det(I - XY) = det(I - YX), v has the characteristic equation det(I - z^-N M(z)) = 0; with
a gain, M_a = (1 - a) I + a M, and sigma_max(M_a) <= 1 - a + a gamma < 1. By the choice of N,
z^-N M(z) is causal, and analytic in |z| >= 1, as P is: by the maximum principle its largest
singular value there is at most gamma, so that no root is there (small gain). The equation of e
follows from P v = e_0 - e, as Q commutes with P; M delayed is causal, with norm gamma.

:func:`ilctools.synthesise` with ``everywhere=True`` proves the condition between the samples of its
grid, too. It promises nothing for limits at which commands are cut off, nor for N that are shorter.
"""

from functools import lru_cache

import numpy as np
from scipy.signal import oaconvolve

from ilctools import arguments
from ilctools.filters import Composition, LearningFilter, ZeroPhaseButterworth
from ilctools.law.law import Law

NEGLIGIBLE_OF_M = 1e-6  # at any frequency, where P is at most one: what Q's response is cut for


def finite_response(law: Law) -> np.ndarray:
    """Impulse response of Q, symmetric in time, without the ends that are negligible with this L.

    M is Q (I - P L): what Q loses counts as often as L is large.
    """
    gain = np.linalg.norm(np.abs(law.L.coefficients).sum(axis=2), 2)
    return _cut(law.Q, NEGLIGIBLE_OF_M / max(1.0, gain))


@lru_cache(maxsize=4)
def _cut(Q: ZeroPhaseButterworth, share: float) -> np.ndarray:
    """Impulse response of Q without ends that hold such a share of it."""
    impulse = np.zeros((2 * Q.decay + 1, 1))
    impulse[Q.decay] = 1
    h = Q.apply(impulse)[:, 0]
    cut = np.searchsorted(2 * np.cumsum(np.abs(h[: Q.decay])), share)
    return h[cut : len(h) - cut]


def reach_ahead(law: Law) -> int:
    """Samples of the trial before that v needs beyond its own."""
    return len(finite_response(law)) // 2 + max(0, law.L.last)


def check_period(law: Law, period: int) -> None:
    """Check that a law can go on from trial to trial of so many samples."""
    if law.L is None:
        return
    if law.rest:
        raise ValueError(f"rest = {law.rest}, but without reset trials have no end: take rest=0")
    if isinstance(law.L, Composition):
        reach = (period - len(_cut(law.Q, NEGLIGIBLE_OF_M)) // 2) // 2
        raise ValueError(
            "L has the base of a model, which acts on trials with ends: for trials without reset "
            f"synthesise with reach, {reach} samples or fewer, or with base=None"
        )
    arguments.instance("L", law.L, LearningFilter)
    shortest = reach_ahead(law) + 1
    if period < shortest:
        raise ValueError(
            f"reference has {period} samples a trial, but without reset needs {shortest} or more, "
            "by which Q and L look ahead: take a longer period, several of them as one, a higher "
            "cut-off of Q or a lower order"
        )


def memory(law: Law, period: int) -> float:
    """How many samples before it v may depend on."""
    if law.L is None:
        return np.inf
    return period + len(finite_response(law)) + max(0, -law.L.first)


def repeated(law: Law, v, e, period: int, start: int, stop: int) -> np.ndarray:
    """v in the samples from start to stop, from v and e, (time, m), of all samples before."""
    h = finite_response(law)
    x = np.pad(v + law.L.apply(e), [(len(h) // 2, 0), (0, 0)])  # at rest before the first trial
    before = slice(start - period, stop - period)
    x = x[before.start : before.stop + len(h) - 1]
    return (1 - law.gain) * v[before] + law.gain * oaconvolve(x, h[:, None], "valid", axes=0)


def next_samples(law: Law, v, e, first) -> np.ndarray:
    """v in the samples that follow, as far as it follows from v and e of all before."""
    period, now = len(first), len(v)
    if law.L is None or now < period:
        return first[now % period :]
    return repeated(law, v, e, period, now, now + period - reach_ahead(law))
