"""Compute the largest singular values of many matrices, and find the largest of several values."""

import numpy as np

TIED = 1e-6  # relative distance below which a solver's accuracy decides which value is largest


def tied(values):
    """Mark the largest values, and values whose distance to the largest may be due to rounding."""
    return values >= values.max(axis=0) * (1 - TIED)


def largest_singular_values(G):
    """Compute the largest singular value of each of the n matrices in G, (n, p, m)."""
    if min(G.shape[1:]) > 2:
        return np.linalg.norm(G, 2, axis=(1, 2))
    # Below three by three, the Hermitian eigenvalue problem has a closed form: ten times faster.
    G = G if G.shape[1] <= G.shape[2] else np.swapaxes(G, 1, 2)
    # With a power of two as unit, no square leaves the range of doubles, and nothing is rounded.
    _, exponent = np.frexp(np.abs(G).max(axis=(1, 2)))
    unit = np.ldexp(1.0, exponent.clip(-1000, 1000))
    G = G * (1 / unit)[:, None, None]
    power = (G.real**2 + G.imag**2).sum(axis=2)
    total = power.sum(axis=1)
    if G.shape[1] == 1:
        return unit * np.sqrt(total)
    coupling = np.abs((G[:, 0] * G[:, 1].conj()).sum(axis=1))
    apart = np.hypot((power[:, 0] - power[:, 1]) / 2, coupling)
    return unit * np.sqrt(total / 2 + apart)
