"""Q where it is left out: its cut-off follows from how far P reaches, and how far its plants agree.

With sigma(omega) for the least sigma_min of all plants, and sigma_0 for its value at rest, or its
largest if P passes nothing there, P reaches up to the frequency omega_1 where

    sigma(omega) < WEAK sigma_0.

Beyond, what L gains is noise and what the model does not know. The bound on L will follow from the
cut-off, and is STATIC / sigma_0 at least. The plants P_k agree as far as the quadratic law B of all
of them, with that bound, leaves |Q| d <= M_max, with what is left without Q,

    d = max_k sigma_max(I - P_k B) + r sigma_max(B),

r their radius. Of the Butterworth filter of order 2, Q = 1 / (1 + x^4) with
x = tan(omega Ts / 2) / tan(cutoff Ts / 2), so that this is x >= (d / M_max - 1)^(1/4): one cut-off
for each frequency, and the least of them counts. There is nothing to search.

Which frequencies are asked is decided before: of an estimate from records, those of which a period
fits into a record, see :attr:`.EstimatedResponse.resolved`. Among these a single one may decide.
The frequencies beside it at which P is as weak, or as little known, belong to it. If P is strong
and known again above them, they are a range whose price can be named: the cut-off that would follow
without them.
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
WEAK = 0.1  # of sigma_0: of 0.03, 0.05 and 0.1 least noise; see figures/performance.md
SHARE_OF_M_MAX = 0.9  # of M_max that may be used up by what the plants differ
INSIDE_SAMPLES = 0.5  # of the last sample, if that is below Nyquist's: |Q| is 0.06 there
HIGHEST_CUTOFF = 0.9  # of the Nyquist frequency
NEARLY_NYQUIST = 3  # rad, of omega Ts: from there on it is as good as the Nyquist frequency's, pi
NAMED_FACTOR = 1.1  # a range is named if the cut-off were this many times as high without
COSTLY_FACTOR = 2.0  # and a warning tells of it from this factor on


class Cutoff(NamedTuple):
    """A cut-off that is chosen, and what decided it."""

    omega: float  # rad/s
    reason: str  # what it follows from, in words
    decisive: str = ""  # the range that decides, in words; empty if none is so narrow
    without: float = np.inf  # the cut-off without that range, rad/s

    @property
    def costly(self) -> bool:
        """Whether a narrow range lowers the cut-off so much that a warning is due."""
        return bool(self.decisive) and self.without >= COSTLY_FACTOR * self.omega


class _Limits(NamedTuple):
    """The cut-off that each frequency admits, (n,), rad/s; infinite if it is no limit."""

    omega: np.ndarray  # (n,), rad/s
    Ts: float  # s
    weak: np.ndarray  # that frequency, where P is below WEAK sigma_0
    apart: np.ndarray  # where |Q| d is what M_max admits
    highest: float  # rad/s, as P is known no further


class _Least(NamedTuple):
    """The least of the limits."""

    omega: float  # rad/s
    index: int | None = None  # of the frequency that decides; None if `highest` does
    among: np.ndarray | None = None  # (n,), bool: where P is as weak, or as little known
    last: int = 0  # number of the last frequency that was asked


def choose_cutoff(response: Response, M_max: float) -> Cutoff:
    """The cut-off up to which P reaches and its plants agree, and what decided it."""
    limits = _limits(response, SHARE_OF_M_MAX * M_max)
    least = _least(limits, left_out=False)
    if least.index is None:
        return Cutoff(least.omega, "the highest at which P is known well enough")
    if limits.weak[least.index] == least.omega:
        reason, what = "by how far P reaches", "that P passes little"
    elif response.radius is not None:
        reason, what = "by how far P is known", "the radius of P"
    else:
        reason, what = "by how far the plants agree", "that the plants differ"
    rows, _ = label(least.among)
    run = rows == rows[least.index]  # the neighbours in a row
    without = _least(limits, run).omega
    if np.flatnonzero(run)[-1] >= least.last or without < NAMED_FACTOR * least.omega:
        return Cutoff(least.omega, reason)
    return Cutoff(least.omega, reason, f"{what} {_span(limits.omega[run])}", without)


def _limits(response, M_max):
    """What limits the cut-off: see the module."""
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
    """The least limit, without some of the frequencies, (n,) bool, or with all."""
    weak, apart = (np.where(left_out, np.inf, each) for each in (limits.weak, limits.apart))
    asked = limits.omega <= min(weak.min(), limits.highest) / INSIDE_SAMPLES
    last = np.sum(asked & (limits.omega * limits.Ts < NEARLY_NYQUIST)) - 1
    least = _Least(limits.highest)
    for each, end in ((weak, len(weak) - 1), (np.where(asked, apart, np.inf), last)):
        if each.min() < least.omega:
            least = _Least(float(each.min()), each.argmin(), np.isfinite(each), end)
    return least


def _span(omega):
    """Where a range is, in words."""
    low, high = (f"{end:.2g}" for end in omega[[0, -1]])
    return f"at {low} rad/s" if low == high else f"from {low} to {high} rad/s"
