"""P, Q and the radius between their samples: by cubic splines, the radius by straight lines.

Measured grids are linear or logarithmic, plants smooth over one or the other. So both run over
omega or log omega, over that in which splines predict every other sample of Q P better, relative to
the nominal plant. It is one for all plants of a problem, and the same for each filter.

A spline misses P between its samples. By how much is estimated by what the spline of every other
sample misses of those left out, at twice the distance. The larger of what is missed at two
neighbours, times 4 t (1 - t) from one to the other, is a radius, in which P lies if its resonances
show in the samples; what the problem's own radius covers at the samples counts once.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.models import frequency_response
from ilctools.singular_values import largest_singular_values

FEWEST = 4  # samples of which every other one can be left out


def between(problem, plant: int, omega):
    """P (k, m, m) of a plant, Q (k,) and the radius (k,), or None, at other frequencies.

    Models are their own. Above the last sample P is zero with a radius, its size there; a radius of
    a model ends with the design frequencies.
    """
    design, model = problem.design, problem.models[plant]
    omega, Q = np.asarray(omega), design.Q_at(omega)
    if model is not None and design.radius is None:
        return frequency_response(model, omega), Q, None
    known, place = design.axis(design.omega), design.axis(omega.clip(*design.omega[[0, -1]]))
    radius = 0 if design.radius is None else np.interp(place, known, design.radius)
    if model is not None:
        inside = (omega >= design.omega[0]) & (omega <= design.omega[-1])
        return frequency_response(model, omega), Q, np.where(inside, radius, 0)
    P, missed = CubicSpline(known, design.plants[plant])(place), design.missed[plant]
    after = np.searchsorted(known, place).clip(1, len(known) - 1)
    t = (place - known[after - 1]) / (known[after] - known[after - 1])
    radius = radius + 4 * t * (1 - t) * np.maximum(missed[after - 1], missed[after])
    if design.beyond is not None:
        unknown = omega > design.omega[-1]
        P[unknown], radius = 0, np.where(unknown, design.beyond, radius)
    return P, Q, radius


def axis_of(P, Q, omega):
    """That of omega and log omega in which splines predict Q P better, relative to P."""
    axes = (np.asarray, np.log) if omega[0] > 0 and len(omega) >= FEWEST else (np.asarray,)
    relative = Q[:, None, None] * P, np.linalg.inv(P)
    return min(axes, key=lambda axis: missed(*relative, axis(omega)).max())


def missed(P, inverse, x) -> np.ndarray:
    """sigma_max((P - S) inverse), S the spline of every other sample: at each sample, (n,).

    At the ends that of the next one; of P itself with fewer than four samples.
    """
    sizes = largest_singular_values(P @ inverse)
    if len(x) < FEWEST:
        return sizes
    for first in (1, 2):  # between the two at the ends
        out = np.arange(first, len(x) - 1, 2)
        S = CubicSpline(np.delete(x, out), np.delete(P, out, axis=0))(x[out])
        sizes[out] = largest_singular_values((P[out] - S) @ inverse[out])
    sizes[[0, -1]] = sizes[[1, -2]]
    return sizes
