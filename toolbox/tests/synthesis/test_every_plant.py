"""No plant within radius and list exceeds, at any frequency, what a certificate says of all.

Judged on 20,000 frequencies by plants that exist: models by their response, samples and the radius
by the interpolation that the certificate states.
"""

import numpy as np
import pytest
from plants import altered, invertible
from scipy.interpolate import CubicSpline

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
from ilctools.evidence.robustness import within_radius
from ilctools.models import frequency_response
from ilctools.singular_values import largest_singular_values

POINTS = 20_000
PASSED = 1 + 1e-6


def posed(seed):
    """Plants by factors off a first one, each as a model or as samples, and what is asked."""
    rng = np.random.default_rng(seed)
    m, count, n = rng.integers(1, 3), rng.choice([1, 2, 3]), int(rng.integers(25, 60))
    last = np.pi * rng.choice([1.0, 0.7])
    omega = rng.choice([np.geomspace(1e-3, last, n), np.linspace(0.01, last, n)])
    first, share = invertible(seed, m), rng.choice([0.0, 0.5, 1.0])
    plants = [altered(first, B=off) for off in [1.0, *rng.uniform(0.8, 1.2, count - 1)]]
    plants = [P if rng.random() < share else frequency_response(P, omega) for P in plants]
    Q = zero_phase_butterworth(int(rng.integers(1, 3)), rng.uniform(0.1, 0.6), 1.0)
    asked = {
        "M_max": rng.choice([0.9, 0.3, 0.1]),
        "everywhere": True,
        "objective": rng.choice(["sum", "peak"]),
    }
    asked |= {"base": 0.1} if rng.random() < 0.4 else {"order": int(rng.integers(3, 12))}
    if rng.random() < 0.7:
        asked["uncertainty"] = rng.uniform(0, 0.1) * (1 + rng.random(n))
    return plants, Q, omega, asked


def judged(design, plants, omega, radius):
    """The worst sigma_max of M and L on a dense grid."""
    axis, (first, *_, last) = design.problem.response.axis, omega
    spacings = np.linspace(0, np.pi, POINTS // 2), np.geomspace(first, last, POINTS // 2)
    dense = np.sort(np.minimum(np.concatenate(spacings), np.pi))
    inside = (dense >= first) & (dense <= last)
    L, q, worst = design.filter.frequency_response(dense), design.Q.frequency_response(dense), []
    rho = np.zeros(len(dense))
    if radius is not None:
        rho[inside] = np.interp(axis(dense[inside]), axis(omega), radius)
    for given in plants:
        at, P = slice(None), given
        if isinstance(given, np.ndarray):
            at, P = inside, CubicSpline(axis(omega), given)(axis(dense[inside]))
        else:
            P = frequency_response(given, dense)
        level = design.certificate.all_M
        worst.append(within_radius(P, q[at], L[at], rho[at], level).max())
    return max(worst), largest_singular_values(L).max()


def exceeded(seed):
    """By which factors M and L exceed rate and peak as certified, and the bounds asked for."""
    plants, Q, omega, asked = posed(seed)
    try:
        design = synthesise(plants, Q, omega, 1.0, **asked)
    except InfeasibleError as error:
        asked["M_max"] = min(1.02 * error.smallest_M_max, 0.99)
        design = synthesise(plants, Q, omega, 1.0, **asked)
    most = design.certificate.all_M, design.certificate.all_L
    M, L = judged(design, plants, omega, asked.get("uncertainty"))
    return M / most[0], L / most[1], most[0] / asked["M_max"], most[1] / design.problem.L_max


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [1, 3, 7, 15])  # none of which takes long
def test_no_certificate_is_exceeded(seed):
    assert max(exceeded(seed)) <= PASSED
