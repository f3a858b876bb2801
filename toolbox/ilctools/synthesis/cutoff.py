"""The default cut-off of Q, from how far P reaches and how far its plants agree.

Let sigma(omega) be the least sigma_min of all plants. Let sigma_0 be the value of sigma at rest, or
the largest value of sigma if P passes nothing at rest. P reaches up to the frequency omega_1 where

    sigma(omega) < WEAK sigma_0.

Above omega_1, L would amplify noise and the errors of the model. The bound on L will follow from
the cut-off, and is at least STATIC / sigma_0. The plants P_k agree at frequencies where the
quadratic law B of all plants, with this bound, gives |Q| d <= M_max. Here d is what is left without
Q,

    d = max_k sigma_max(I - P_k B) + r sigma_max(B),

and r is the radius of the plants. The Butterworth filter of order 2 has Q = 1 / (1 + x^4) with
x = tan(omega Ts / 2) / tan(cutoff Ts / 2). The condition is therefore
x >= (d / M_max - 1)^(1/4). The condition gives one cut-off for each frequency, and the least
cut-off counts. No search is needed.

The frequencies that count are decided before. For an estimate from records, these are the
frequencies of which a period fits into a record, see :attr:`.EstimatedResponse.resolved`. A single
one of these frequencies may decide. The neighbouring frequencies at which P is as weak, or as
uncertain, are grouped with the one that decides. If P is strong and known again above these
frequencies, they form a range with a price. The price is the cut-off that would follow without this
range.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from ilctools.base import quadratic_law
from ilctools.problem.defaults import STATIC, at_rest
from ilctools.problem.problem import convergence_matrix
from ilctools.response.response import Response
from ilctools.singular_values import largest_singular_values

ORDER = 2  # of the Butterworth filter, as in the paper
# Relative to sigma_0. Among 0.03, 0.05 and 0.1, this gives least noise; see figures/performance.md.
WEAK = 0.1
SHARE_OF_M_MAX = 0.9  # share of M_max that the differences between the plants may use up
# Highest cut-off relative to the last sample, if that is below the Nyquist frequency. |Q| is 0.06
# at the last sample.
INSIDE_SAMPLES = 0.5
HIGHEST_CUTOFF = 0.9  # relative to the Nyquist frequency
NEARLY_NYQUIST = 3  # rad: a larger omega Ts is as good as that of the Nyquist frequency, pi
NAMED_FACTOR = 1.1  # a range is named if the cut-off would be this many times as high without it
COSTLY_FACTOR = 2.0  # a warning is given from this factor on


class Cutoff(NamedTuple):
    """The chosen cut-off, and what decided it."""

    omega: float  # rad/s
    reason: str  # what the cut-off follows from, in words
    decisive: str = ""  # the range that decides, in words; empty if no narrow range decides
    without: float = np.inf  # the cut-off without that range, rad/s

    @property
    def costly(self) -> bool:
        """Whether a narrow range lowers the cut-off so much that a warning is due."""
        return bool(self.decisive) and self.without >= COSTLY_FACTOR * self.omega


class _Limits(NamedTuple):
    """The highest cut-off for each frequency, (n,), rad/s; infinite if there is no limit."""

    omega: np.ndarray  # (n,), rad/s
    Ts: float  # s
    weak: np.ndarray  # the frequency itself, if P is below WEAK sigma_0
    apart: np.ndarray  # the cut-off at which |Q| d meets its bound
    highest: float  # rad/s, because P is not known at higher frequencies


class _Least(NamedTuple):
    """The least of all limits on the cut-off."""

    omega: float  # rad/s
    index: int | None = None  # of the frequency that decides; None if `highest` does
    among: np.ndarray | None = None  # (n,), bool: where P is as weak, or as little known
    last: int = 0  # number of the last frequency that counts


def choose_cutoff(response: Response, M_max: float) -> Cutoff:
    """Choose the cut-off up to which P reaches and its plants agree; say what decided it."""
    limits = _limits(response, SHARE_OF_M_MAX * M_max)
    least = _least(limits, left_out=False)
    if least.index is None:
        return Cutoff(least.omega, "limited by the frequencies at which P is known well enough")
    if limits.weak[least.index] == least.omega:
        reason, what = "limited by the small gain of P", "the small gain of P"
    elif response.radius is not None:
        reason, what = "limited by the radius of P", "the radius of P"
    else:
        reason, what = (
            "limited by the differences between the plants",
            "the difference between the plants",
        )
    rows, _ = label(least.among)
    run = rows == rows[least.index]  # the neighbours in a row
    without = _least(limits, run).omega
    if np.flatnonzero(run)[-1] >= least.last or without < NAMED_FACTOR * least.omega:
        return Cutoff(least.omega, reason)
    return Cutoff(least.omega, reason, f"{what} {_span(limits.omega[run])}", without)


def _limits(response, M_max):
    """Compute what limits the cut-off, see the docstring of the module."""
    omega, P, Ts = response.omega, response.P, response.Ts
    values = np.linalg.svd(P, compute_uv=False)[..., -1].min(axis=0)
    rest = at_rest(values) or values.max()
    weak, start = values < WEAK * rest, np.argmax(values >= WEAK * rest)
    weak[:start] = False  # P passes nothing at rest
    highest = (
        HIGHEST_CUTOFF * np.pi / Ts
        if omega[-1] * Ts > NEARLY_NYQUIST
        else INSIDE_SAMPLES * omega[-1]
    )

    B = quadratic_law(P, b=rest / (2 * STATIC))
    ones = np.ones(len(omega))
    d = np.max([largest_singular_values(convergence_matrix(each, ones, B)) for each in P], axis=0)
    apart = (d + largest_singular_values(response.radii[:, None, None] * B)) / M_max
    apart[: start + 1] = 0
    asked = (apart > 1) & (omega * Ts < NEARLY_NYQUIST)
    x = (apart[asked] - 1) ** (1 / (2 * ORDER))
    apart = np.full(len(omega), np.inf)
    apart[asked] = 2 / Ts * np.arctan(np.tan(omega[asked] * Ts / 2) / x)
    return _Limits(omega, Ts, np.where(weak, omega, np.inf), apart, highest)


def _least(limits, left_out) -> _Least:
    """Find the least limit, without the frequencies `left_out`, (n,) bool, or with all."""
    weak, apart = (np.where(left_out, np.inf, each) for each in (limits.weak, limits.apart))
    asked = limits.omega <= min(weak.min(), limits.highest) / INSIDE_SAMPLES
    last = np.sum(asked & (limits.omega * limits.Ts < NEARLY_NYQUIST)) - 1
    least = _Least(limits.highest)
    for each, end in ((weak, len(weak) - 1), (np.where(asked, apart, np.inf), last)):
        if each.min() < least.omega:
            least = _Least(float(each.min()), each.argmin(), np.isfinite(each), end)
    return least


def _span(omega):
    """State in words where a range is."""
    low, high = (f"{end:.2g}" for end in omega[[0, -1]])
    return f"at {low} rad/s" if low == high else f"from {low} to {high} rad/s"
