"""No plant within radius and list exceeds, at any frequency, what a certificate says of all.

Judged on 5,000 frequencies by plants that exist: models by their response, samples and the radius
by the interpolation that the certificate states, the worst Delta by power iteration.
"""

import control
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response

POINTS = 2500
PASSED = 1 + 1e-6


def plant(rng, m):
    """Lags and a resonance, coupled, with unit gain or so."""
    poles, r, angle = rng.uniform(0.2, 0.9, m), rng.uniform(0.8, 0.98), rng.uniform(0.5, 2.5)
    turned = r * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    B = np.vstack([np.diag(1 - poles), 0.3 * (1 - r) * rng.standard_normal((2, m))])
    C = np.hstack([np.eye(m) + rng.uniform(-0.2, 0.2, (m, m)), rng.standard_normal((m, 2))])
    return control.ss(block_diag(np.diag(poles), turned), B, C, 0, 1.0)


def posed(seed):
    """Plants, as models or samples, and as models; what is asked of a design."""
    rng = np.random.default_rng(seed)
    m, n = 1 + seed % 2, int(rng.integers(25, 60))
    omega = rng.choice([np.geomspace(1e-3, np.pi, n), np.linspace(0.01, 2.2, n)])
    first = plant(rng, m)
    off = [np.eye(m), *(np.eye(m) + 0.1 * rng.uniform(-1, 1, (seed % 3, m, m)))]
    truth = [control.ss(first.A, first.B, F @ first.C, 0, 1.0) for F in off]
    plants = [P if rng.random() < 0.5 else frequency_response(P, omega) for P in truth]
    Q = zero_phase_butterworth(2, rng.uniform(0.1, 0.6), 1.0)
    asked = {"M_max": rng.choice([0.9, 0.3]), "objective": rng.choice(["sum", "peak"])}
    asked |= {"base": 0.1} if rng.random() < 0.4 else {"order": int(rng.integers(3, 12))}
    if rng.random() < 0.7:
        asked["uncertainty"] = rng.uniform(0, 0.1) * (1 + rng.random(n))
    return plants, truth, Q, omega, {"everywhere": True} | asked


def reached(M, L, rho):
    """max over x of |M x| + rho |L x|, from below, by power iteration from two starts."""
    best = np.linalg.norm(M, 2, axis=(1, 2))
    for G in (M, L):
        x = np.linalg.svd(G)[2][:, 0].conj()[..., None]
        for _ in range(40):
            y, z = M @ x, L @ x
            y, z = (v / (np.linalg.norm(v, axis=1, keepdims=True) + 1e-300) for v in (y, z))
            x = M.conj().swapaxes(1, 2) @ y + rho[:, None, None] * (L.conj().swapaxes(1, 2) @ z)
            x /= np.linalg.norm(x, axis=1, keepdims=True) + 1e-300
        value = np.linalg.norm(M @ x, axis=1) + rho[:, None] * np.linalg.norm(L @ x, axis=1)
        best = np.maximum(best, value[:, 0])
    return best


def judged(design, plants, truth, Q, omega, radius):
    """The worst sigma_max of M and L on a dense grid."""
    axis, first, last = design.problem.response.samples[0].axis, omega[0], omega[-1]
    dense = np.concatenate([np.linspace(0, np.pi, POINTS), np.geomspace(first, last, POINTS)])
    dense = np.sort(dense.clip(max=np.pi))
    inside = (dense >= first) & (dense <= last)
    L, q, worst = design.filter.frequency_response(dense), Q.frequency_response(dense), 0.0
    rho = np.zeros(len(dense))
    if radius is not None:
        rho[inside] = np.interp(axis(dense[inside]), axis(omega), radius)
    for given, model in zip(plants, truth, strict=True):
        at, P = slice(None), frequency_response(model, dense)
        if isinstance(given, np.ndarray):
            at, P = inside, CubicSpline(axis(omega), given)(axis(dense[inside]))
        M = q[at, None, None] * (np.eye(L.shape[1]) - P @ L[at])
        worst = max(worst, reached(M, L[at], (q * rho)[at]).max())
    return worst, np.linalg.norm(L, 2, axis=(1, 2)).max()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(6))
def test_no_certificate_is_exceeded(seed):
    """Nor do rate and peak as certified exceed the bounds asked for."""
    plants, truth, Q, omega, asked = posed(seed)
    try:
        design = synthesise(plants, Q, omega, 1.0, **asked)
    except InfeasibleError as error:
        asked["M_max"] = min(1.02 * error.smallest_M_max, 0.99)
        design = synthesise(plants, Q, omega, 1.0, **asked)
    certificate, radius = design.certificate, asked.get("uncertainty")
    most = certificate.all_M, certificate.all_L
    M, L = judged(design, plants, truth, Q, omega, radius)
    L_max = design.problem.L_max
    assert max(M / most[0], L / most[1], most[0] / asked["M_max"], most[1] / L_max) <= PASSED
