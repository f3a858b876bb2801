"""Q where it is left out: its cut-off follows from how far P reaches, and how far its plants agree.

With sigma(omega) for the least sigma_min of all plants, and sigma_0 for its value at rest, or its
largest if P passes nothing there, P reaches up to the frequency omega_1 where

    sigma(omega) < REACHED sigma_0.

Beyond, what L gains is noise and what the model does not know. L is then bounded by
STATIC / sigma_0. The plants P_k agree as far as the quadratic law B of all of them, with that
bound, leaves |Q| d <= M_max, with what is left without Q,

    d = max_k sigma_max(I - P_k B) + r sigma_max(B),

r their radius. Of the Butterworth filter of order 2, Q = 1 / (1 + x^4) with
x = tan(omega Ts / 2) / tan(cutoff Ts / 2), so that this is x >= (d / M_max - 1)^(1/4): one cut-off
for each frequency, and the least of them counts. There is nothing to search.
"""

import numpy as np

from ilctools.base import quadratic_law
from ilctools.problem.defaults import STATIC, at_rest
from ilctools.response.response import Response
from ilctools.singular_values import largest_singular_values

ORDER = 2  # of the Butterworth filter, as in the paper
REACHED = 0.1  # of sigma_0: of 0.03, 0.05 and 0.1 least noise; see figures/performance.md
SHARE = 0.9  # of M_max that may be used up by what the plants differ
INSIDE = 0.5  # of the last sample, if it is below the Nyquist frequency: |Q| is 0.06 there
HIGHEST = 0.9  # of the Nyquist frequency


def reached(response: Response, M_max: float) -> float:
    """The cut-off up to which P reaches and its plants agree, rad/s."""
    omega, P, Ts, M_max = response.omega, response.P, response.Ts, SHARE * M_max
    values = np.linalg.svd(P, compute_uv=False)[..., -1].min(axis=0)
    rest = at_rest(values) or values.max()
    below, start = values < REACHED * rest, np.argmax(values >= REACHED * rest)
    below[:start] = False  # P passes nothing at rest
    highest = HIGHEST * np.pi / Ts if omega[-1] * Ts > 3 else INSIDE * omega[-1]
    limits = [highest, *omega[below][:1]]

    r = 0 if response.radius is None else response.radius[:, None, None]
    B = quadratic_law(P, b=rest / (2 * STATIC))
    d = np.max([*map(largest_singular_values, np.eye(P.shape[-1]) - P @ B)], axis=0)
    d = d + largest_singular_values(r * B)
    at = (d > M_max) & (omega > omega[start]) & (omega <= limits[-1] / INSIDE) & (omega * Ts < 3)
    x = (d[at] / M_max - 1) ** (1 / (2 * ORDER))
    limits += (2 / Ts * np.arctan(np.tan(omega[at] * Ts / 2) / x)).tolist()
    return float(min(limits))
