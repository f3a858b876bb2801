"""The default cut-off of Q, from the bandwidth of P and from the differences between the plants.

Let sigma(omega) be the least singular value of P at omega, among all plants. Let sigma_0 be the
value of sigma at zero frequency, or the largest value of sigma if P has no gain at zero frequency.
The cut-off is at most the lowest frequency omega_1 where

    sigma(omega) < WEAK sigma_0.

Above omega_1, L would amplify noise and the errors of the model.

The cut-off must also be so low that one filter works for all plants. In this test, the filter is
the regularised inverse B of all plants, see :mod:`ilctools.base`. The bound on the gain of B is
here STATIC / sigma_0. At each frequency, |Q| d <= M_max is required. Here d is the share of the
error that one trial would leave without Q,

    d = max_k sigma_max(I - P_k B) + r sigma_max(B),

and r is the radius around the plants. The Butterworth filter of order 2 has Q = 1 / (1 + x^4) with
x = tan(omega Ts / 2) / tan(cutoff Ts / 2). The condition is therefore
x >= (d / M_max - 1)^(1/4). The condition gives a highest cut-off for each frequency. The lowest of
these cut-offs is chosen, so that no search is needed.

Only the frequencies of the response are considered. If the response was estimated from records,
only frequencies whose period fits into a record are considered by default, see
:attr:`.EstimatedResponse.resolved`. A single frequency may decide the cut-off. The neighbouring
frequencies at which P is also weak, or also too uncertain, form a range with this frequency. If P
is strong and known above this range, the range is reported, with the cut-off that would follow
without the range.
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
# Relative to sigma_0. Among 0.03, 0.05 and 0.1, a law with this value learns the least noise, see
# figures/performance.md.
WEAK = 0.1
SHARE_OF_M_MAX = 0.9  # share of M_max that the differences between the plants may use up
# Highest cut-off relative to the frequency of the last sample, if this frequency is below the
# Nyquist frequency. |Q| is then at most 0.06 at the last sample.
INSIDE_SAMPLES = 0.5
HIGHEST_CUTOFF = 0.9  # relative to the Nyquist frequency
NEARLY_NYQUIST = 3  # rad: a larger omega Ts counts as the Nyquist frequency, omega Ts = pi
NAMED_FACTOR = 1.1  # a range is reported if it lowers the cut-off by at least this factor
COSTLY_FACTOR = 2.0  # a range gives a warning if it lowers the cut-off by at least this factor


class Cutoff(NamedTuple):
    """The chosen cut-off of Q, and the reason for this value."""

    omega: float  # rad/s
    reason: str  # what limits the cut-off, in words
    decisive: str = ""  # the narrow range that limits the cut-off, in words; else empty
    without: float = np.inf  # the cut-off if this range is ignored, rad/s

    @property
    def costly(self) -> bool:
        """Whether a narrow range lowers the cut-off so much that a warning is due."""
        return bool(self.decisive) and self.without >= COSTLY_FACTOR * self.omega


class _Limits(NamedTuple):
    """The highest cut-off that each frequency allows, (n,), rad/s.

    If a frequency sets no limit, the value is infinite.
    """

    omega: np.ndarray  # (n,), rad/s
    Ts: float  # s
    weak: np.ndarray  # the frequency itself, if P is below WEAK sigma_0
    apart: np.ndarray  # the cut-off at which |Q| d meets its bound
    highest: float  # rad/s: limit that follows from the last frequency at which P is known


class _Least(NamedTuple):
    """The lowest of all limits on the cut-off."""

    omega: float  # rad/s
    index: int | None = None  # of the frequency with this limit; None if it is `highest`
    among: np.ndarray | None = None  # (n,), bool: all frequencies with a limit of this kind
    last: int = 0  # index of the last frequency that may limit the cut-off


def choose_cutoff(response: Response, M_max: float) -> Cutoff:
    """Choose the cut-off of Q from the gain, the radius and the differences of the plants."""
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
    """Compute all limits on the cut-off, see the docstring of the module."""
    omega, P, Ts = response.omega, response.P, response.Ts
    values = np.linalg.svdvals(P)[..., -1].min(axis=0)
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
    """Find the lowest limit, without the frequencies that the mask `left_out` selects.

    The mask has the shape (n,). False stands for no frequencies.
    """
    weak, apart = (np.where(left_out, np.inf, each) for each in (limits.weak, limits.apart))
    asked = limits.omega <= min(weak.min(), limits.highest) / INSIDE_SAMPLES
    last = np.sum(asked & (limits.omega * limits.Ts < NEARLY_NYQUIST)) - 1
    least = _Least(limits.highest)
    for each, end in ((weak, len(weak) - 1), (np.where(asked, apart, np.inf), last)):
        if each.min() < least.omega:
            least = _Least(float(each.min()), each.argmin(), np.isfinite(each), end)
    return least


def _span(omega):
    """State the first and last frequency of a range in words."""
    low, high = (f"{end:.2g}" for end in omega[[0, -1]])
    return f"at {low} rad/s" if low == high else f"from {low} to {high} rad/s"
