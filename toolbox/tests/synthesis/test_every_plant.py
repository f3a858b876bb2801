"""No plant within radius and list exceeds, at any frequency, what a certificate says of all.

Judged on dense grids by plants that exist: models by their transfer function, samples and the
radius by the interpolation that the certificate states, the worst Delta by power iteration.
"""

import numpy as np
import pytest
from plants import invertible
from scipy.interpolate import CubicSpline

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth

POINTS = 20_000
PASSED = 1 + 1e-6


def response(model, omega):
    return np.moveaxis(model(np.exp(1j * omega), squeeze=False), -1, 0)


def posed(seed):
    """Plants, by factors off a first model, and samples of some of them; what is asked."""
    rng = np.random.default_rng(seed)
    m, count, n = rng.integers(1, 3), rng.choice([1, 1, 2, 3]), int(rng.integers(15, 30))
    last = np.pi * rng.choice([1.0, 0.7])
    omega = rng.choice([np.geomspace(1e-3, last, n), np.linspace(0.01, last, n)])
    first, share = invertible(seed, m), rng.choice([0.0, 0.5, 1.0])
    off = [np.eye(m)] + [np.eye(m) + 0.1 * rng.uniform(-1, 1, (m, m)) for _ in range(count - 1)]
    models = [factor * first for factor in off]
    plants = [P if rng.random() < share else response(P, omega) for P in models]
    Q = zero_phase_butterworth(int(rng.integers(1, 3)), rng.uniform(0.1, 0.6), 1.0)
    asked = {"M_max": rng.choice([0.9, 0.3, 0.1]), "objective": rng.choice(["sum", "peak"])}
    asked |= {"base": 0.1} if rng.random() < 0.4 else {"order": int(rng.integers(3, 7))}
    if rng.random() < 0.7:
        asked["uncertainty"] = rng.uniform(0, 0.1) * (1 + rng.random(n))
    return plants, models, Q, omega, asked


def reached(M, L, rho):
    """max over x of |M x| + rho |L x|, from below, by power iteration from two starts."""
    best = np.linalg.norm(M, 2, axis=(1, 2))
    for G in (M, L) if rho.any() else ():
        x = np.linalg.svd(G)[2][:, 0].conj()[..., None]
        for _ in range(40):
            y, z = M @ x, L @ x
            y, z = (v / (np.linalg.norm(v, axis=1, keepdims=True) + 1e-300) for v in (y, z))
            x = M.conj().swapaxes(1, 2) @ y + rho[:, None, None] * (L.conj().swapaxes(1, 2) @ z)
            x /= np.linalg.norm(x, axis=1, keepdims=True) + 1e-300
        value = np.linalg.norm(M @ x, axis=1) + rho[:, None] * np.linalg.norm(L @ x, axis=1)
        best = np.maximum(best, value[:, 0])
    return best


def judged(design, plants, models, Q, omega, radius, said):
    """The worst sigma_max of M and L on a dense grid; of M, where it is near what is said."""
    axis, first, last = design.problem.response.axis, omega[0], omega[-1]
    grids = np.linspace(0, np.pi, POINTS // 2), np.geomspace(first, last, POINTS // 2)
    dense = np.sort(np.concatenate(grids)).clip(0, np.pi)
    inside = (dense >= first) & (dense <= last)
    L, q = design.filter.frequency_response(dense), Q.frequency_response(dense)
    rho, worst = np.zeros(len(dense)), 0.0
    if radius is not None:
        rho[inside] = np.interp(axis(dense[inside]), axis(omega), radius)
    for given, model in zip(plants, models, strict=True):
        if isinstance(given, np.ndarray):
            at, P = inside, CubicSpline(axis(omega), given)(axis(dense[inside]))
        else:
            at, P = np.ones_like(inside), response(model, dense)
        M, r = q[at, None, None] * (np.eye(L.shape[1]) - P @ L[at]), (q * rho)[at]
        most = np.linalg.norm(M, axis=(1, 2)) + r * np.linalg.norm(L[at], axis=(1, 2))
        high = (most > 0.99 * said) & (most >= np.sort(most)[-POINTS // 10])
        worst = max(worst, *reached(M[high], L[at][high], r[high]), 0.0)
    return worst, np.linalg.norm(L, 2, axis=(1, 2)).max()


@pytest.mark.filterwarnings("ignore")
# models, samples and both; of one channel and two; with a radius and without; base and order
@pytest.mark.parametrize("seed", [0, 2, 9, 15, 47])
def test_no_certificate_is_exceeded(seed):
    """Nor the bounds asked for."""
    plants, models, Q, omega, asked = posed(seed)
    try:
        design = synthesise(plants, Q, omega, 1.0, everywhere=True, **asked)
    except InfeasibleError as error:
        asked["M_max"] = min(1.02 * error.smallest_M_max, 0.99)
        design = synthesise(plants, Q, omega, 1.0, everywhere=True, **asked)
    certificate, radius = design.certificate, asked.get("uncertainty")
    assert "without" not in str(certificate).partition("\n")[0]
    M, L = judged(design, plants, models, Q, omega, radius, certificate.all_M)
    assert PASSED * certificate.all_M >= M and certificate.all_M <= PASSED * asked["M_max"]
    assert L <= PASSED * certificate.all_L <= PASSED**2 * design.problem.L_max
