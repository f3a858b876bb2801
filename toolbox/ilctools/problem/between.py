"""P, Q and the radius between their samples: by cubic splines, the radius by straight lines.

Measured grids are linear or logarithmic, plants smooth over one or the other. So both run over
omega or log omega, over that in which splines predict every other sample of Q P better, relative to
the nominal plant. It is one for all plants of a problem, and the same for each filter.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.models import frequency_response


def between(problem, plant: int, omega):
    """P (k, m, m) of a plant, Q (k,) and the radius (k,), or None, within the design frequencies.

    Models of P and Q are their own, elsewhere, too; the radius is zero there.
    """
    design, model, Q, radius = problem.design, problem.models[plant], problem.butterworth, None
    at = np.clip(omega, design.omega[0], design.omega[-1])
    known, place = design.axis(design.omega), design.axis(at)
    if model is None:
        P = CubicSpline(known, design.plants[plant])(place)
    else:
        P = frequency_response(model, omega)
    Q = CubicSpline(known, design.Q)(place) if Q is None else Q.frequency_response(omega)
    if design.radius is not None:
        radius = np.where(at == omega, np.interp(place, known, design.radius), 0)
    return P, Q, radius


def axis_of(P, Q, omega):
    """That of omega and log omega in which splines predict Q P better, relative to P."""
    axes = (np.asarray, np.log) if omega[0] > 0 else (np.asarray,)
    inverse = np.linalg.inv(P)
    return min(axes, key=lambda axis: missed(P, Q, omega, inverse, axis))


def missed(P, Q, omega, L, axis, radius=0.0) -> float:
    """By how much splines miss M in cross-validation, at most, beyond what a radius covers.

    With fewer than four samples it is infinite.
    """
    if len(omega) < 4:
        return np.inf
    covered, largest = np.abs(Q) * radius * np.linalg.norm(L, 2, axis=(1, 2)), 0.0
    for first in (1, 2):  # every other sample between the two at the ends
        out = np.arange(first, len(omega) - 1, 2)
        known, place = axis(np.delete(omega, out)), axis(omega[out])
        M, M_out = (
            q[:, None, None] * (np.eye(P.shape[-1]) - p @ L[out])
            for p, q in (
                (P[out], Q[out]),
                [CubicSpline(known, np.delete(X, out, axis=0))(place) for X in (P, Q)],
            )
        )
        largest = max(largest, *(np.linalg.norm(M_out - M, 2, axis=(1, 2)) - covered[out]))
    return float(largest)
