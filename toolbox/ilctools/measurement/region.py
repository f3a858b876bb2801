"""How far off a measured matrix may be: the norm of a normal one whose covariance is estimated.

The square of one entry has an F distribution. The size of a matrix has one, with the freedom of the
noise in all its directions together (Satterthwaite), and its shape is that of a normal matrix; 95 %
then cover from 93 to 96.5 % of the truths, from 4 degrees of freedom on, as the tests count.
"""

from functools import cache

import numpy as np
from scipy.optimize import elementwise
from scipy.special import fdtrc, fdtri

DRAWS = 200  # of directions, for the norm of a random matrix
TINY = 1e-300  # instead of a variance of zero


@cache
def _directions(m):
    """Random matrices whose entries are normal, divided by their Frobenius norm."""
    if m == 1:
        return np.ones((1, 1, 1))
    parts = np.random.default_rng(0).standard_normal((2, DRAWS, m, m))
    G = parts[0] + 1j * parts[1]
    return G / np.linalg.norm(G, axis=(1, 2), keepdims=True)


def _shrunk(noise, freedom):
    """Eigenvalues of the noise's covariance, eigenvectors, and the freedom of their sum."""
    # Those of an estimate lie further apart than the true ones. They are drawn towards their mean
    # until the sum of their squares is what it is without bias; it also tells in how many
    # directions the noise goes, from 1 to m, each of which has its own degrees of freedom.
    m = noise.shape[-1]
    values, vectors = np.linalg.eigh(noise)
    values = np.maximum(values, 0)
    square, squares = values.sum(axis=1) ** 2, (values**2).sum(axis=1)
    directions = (square - squares / freedom) / np.maximum(squares - square / freedom, TINY)
    directions = np.clip(directions, 1, m)
    apart = (square / directions - square / m) / np.maximum(squares - square / m, TINY)
    mean = values.mean(axis=1, keepdims=True)
    values = mean + np.sqrt(np.clip(apart, 0, 1))[:, None] * (values - mean)
    return np.maximum(values, 0), vectors, freedom * directions


def radius_of(noise, spread, freedom, miss):
    """The radius that the norm of the error exceeds with probability `miss`, at each frequency."""
    m = noise.shape[-1]
    values, vectors, freedom = _shrunk(noise, freedom)
    root = vectors * np.sqrt(values)[:, None]
    products = root[:, None] @ _directions(m) @ spread[:, None]
    norms = np.linalg.eigvalsh(products @ products.conj().swapaxes(-1, -2))[..., -1]
    gain = m**2 * np.maximum(norms, TINY)

    def excess(log_square, k):
        ratio = np.exp(log_square)[..., None] / gain[k]
        return fdtrc(2 * m**2, 2 * freedom[k][..., None], ratio).mean(-1) - miss

    quantile = np.log(fdtri(2 * m**2, 2 * freedom, 1 - miss))
    bracket = (np.log(gain.min(1)) + quantile - 1e-6, np.log(gain.max(1)) + quantile + 1e-6)
    with np.errstate(invalid="ignore"):  # a bracket at rounding level, which is then halved
        found = elementwise.find_root(excess, bracket, args=(np.arange(len(noise)),))
    return np.exp(found.x / 2)
