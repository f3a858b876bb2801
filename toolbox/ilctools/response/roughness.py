"""Do samples of a response scatter from line to line, as noise does and a plant does not?

Asked are the fourth divided differences of P over omega, each of five neighbouring lines. Where the
lines show how P bends, neighbouring ones have the same sign, but for a few places; of noise that is
independent from line to line 80 % of them differ in sign. Null hypothesis: half of them do.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import binom

from ilctools.findings import Finding
from ilctools.singular_values import largest_singular_values

FALSE_ALARM = 1e-3  # probability, at most, that samples without noise are said to scatter
ROUNDED = 1e-3  # relative to P: what tables are rounded to is not counted
LINES = 5  # of a difference


def scatter(omega, P, Q=1.0) -> float:
    """RMS of the noise of the samples P, (n, m, m), relative to P / |Q|; 0 if not significant."""
    if len(omega) <= LINES:
        return 0.0
    near = sliding_window_view(omega, LINES)
    gaps = near[:, :, None] - near[:, None, :] + np.eye(LINES)
    weights = 1 / gaps.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)  # the variance of one line
    size = largest_singular_values(P)
    relative = np.abs(Q) / np.maximum(size, 1e-12 * size.max())
    difference = np.einsum("kl,kijl->kij", weights, sliding_window_view(P, LINES, axis=0))
    difference *= relative[LINES // 2 : -(LINES // 2), None, None]
    parts = np.stack([difference.real, difference.imag])
    before, after = parts[:, :-1], parts[:, 1:]
    counted = np.minimum(np.abs(before), np.abs(after)) > ROUNDED
    changes = np.count_nonzero(counted & (before * after < 0))
    if binom.sf(changes - 1, np.count_nonzero(counted), 0.5) > FALSE_ALARM:
        return 0.0
    return float(np.sqrt(np.mean(largest_singular_values(difference) ** 2)))


def scattered(omega, P, Q=1.0) -> list[Finding]:
    """What follows if samples scatter."""
    size = scatter(omega, P, Q)
    return [Finding("scatter", size, 0)] if size else []
