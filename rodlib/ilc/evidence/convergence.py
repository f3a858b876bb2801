"""Do the trials converge, and how fast? Two numbers of M = Q (I - P L), on a grid.

The largest sigma_max(M) is the gamma of Lemma 1: below one the error converges *monotonically*, in
every trial by that factor at least. The largest spectral radius of M is never larger: below one the
error *converges*, though it may grow before. Both are about trials without ends.
"""

from typing import NamedTuple

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningOperator, check_learning
from rodlib.ilc.law.limits import WEIGHT
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values, tied
from rodlib.ilc.problem.responses import Q_on_grid, on_grid, plants

TOGETHER = 5000  # matrices at once: what fits into the processor's cache


class Rate(NamedTuple):
    """Lemma 1's gamma, the largest sigma_max(M), and the frequency (rad/s) where it is."""

    gamma: float
    omega: float


def rate(P, Q, L: LearningOperator, omega) -> Rate:
    """The rate of convergence: the gamma of Lemma 1, max sigma_max(M), and where it is.

    By so much the norm of the error shrinks, at least, from trial to trial. Parameters as for
    :func:`rates`. Of frequencies that are tied, it is the lowest; for several plants, both are
    arrays.
    """
    sigma = rates(P, Q, L, omega)
    where = np.asarray(omega)[tied(sigma.T).argmax(axis=0)]
    return Rate(sigma.max(axis=-1), where)


def rate_within(P, Q, L: LearningOperator, omega, weight: float = WEIGHT) -> Rate:
    """The rate of a law with limits, in whose metric limits make nothing more distant.

    The largest sigma_max(W^(1/2) Q (I - L P) W^(-1/2)) with W = P^H P + weight I: by so much the
    root of ||P d||^2 + weight ||d||^2, d the distance of v from where it ends, shrinks from trial
    to trial, at least. For small weights, the gamma of :func:`rate`. Of one plant, for endless
    trials, and limits that are met as the model says.
    """
    weight = arguments.positive("weight", weight)
    if np.ndim(rate(P, Q, L, omega).gamma):  # which checks them
        raise ValueError("P must be one plant: take each in turn")
    omega = np.asarray(omega)
    (response,), q = on_grid(plants(P), omega, L.Ts)[1], Q_on_grid(Q, omega, L=L.Ts)[1]
    sigma = rates_within(response, q, L.frequency_response(omega), weight)
    return Rate(sigma.max(), omega[tied(sigma).argmax()])


def rates_within(P, Q, L, weight=WEIGHT) -> np.ndarray:
    """The singular values of :func:`rate_within`, shape (n,), from frequency responses."""
    I = np.eye(P.shape[1])  # noqa: E741
    root = (
        np.linalg.cholesky(P.conj().swapaxes(1, 2) @ P + weight * I)
        .conj()
        .swapaxes(1, 2)
    )
    T = Q[:, None, None] * (I - L @ P)
    return largest_singular_values(root @ T @ np.linalg.inv(root))


class SpectralRate(NamedTuple):
    """The largest spectral radius of M, and the frequency (rad/s) where it is."""

    radius: float
    omega: float


def spectral_rate(P, Q, L: LearningOperator, omega) -> SpectralRate:
    """Whether the trials converge at all: the largest spectral radius of M, and where it is.

    Below one the error converges, in the end by that factor from trial to trial; where
    sigma_max(M) is above one, it may grow before. For one channel it is the gamma of Lemma 1.
    Parameters, and what is told of ties and several plants, as for :func:`rate`.
    """
    radius = _at_each(P, Q, L, omega, spectral_radii)
    where = np.asarray(omega)[tied(radius.T).argmax(axis=0)]
    return SpectralRate(radius.max(axis=-1), where)


def mean_rate(P, Q, L: LearningOperator, omega, band=None):
    """The mean of sigma_max(M) over the logarithm of frequency, in the band.

    What the sum in (39) is on a logarithmic grid, but for the number of its terms: designs on
    different grids can be compared. By trapezia, whose corners are `omega` and the ends of the
    band (low, high), in rad/s, by default the first and the last of `omega`. Other parameters as
    for :func:`rates`; a float, or for several plants an array of shape (p,).
    """
    sigma, omega = rates(P, Q, L, omega), np.asarray(omega)
    band = omega[[0, -1]] if band is None else arguments.array("band", band, (2,))
    low, high = band
    if not omega[0] <= low < high <= omega[-1] or low <= 0:
        raise ValueError(
            f"band = {band.tolist()} must be two increasing frequencies above zero, within omega, "
            f"which goes from {omega[0]:.6g} to {omega[-1]:.6g} rad/s"
        )
    return np.apply_along_axis(log_mean, -1, sigma, omega, band)[()]


def log_mean(sigma, omega, band) -> float:
    """Mean over the logarithm of frequency, in the band, of what is known at `omega`."""
    within = omega[(omega > band[0]) & (omega < band[1])]
    place = np.log(np.concatenate([band[:1], within, band[1:]]))
    values = np.interp(place, np.log(np.maximum(omega, band[0] / 2)), sigma)
    return np.trapezoid(values, place) / (place[-1] - place[0])


def rates(P, Q, L: LearningOperator, omega) -> np.ndarray:
    """sigma_max(M) at each frequency, by which the error there shrinks at least.

    Parameters
    ----------
    P : array_like, shape (n, m, m), a model, CurrentTrialLoop, or a list of these
        As for :func:`rodlib.synthesise`; an array of shape (p, n, m, m) is several plants, too.
    Q : ZeroPhaseButterworth or array_like, shape (n,)
    L : LearningOperator
        The learning filter.
    omega : array_like, shape (n,)
        Increasing frequencies, rad/s, up to the Nyquist frequency.

    Returns
    -------
    ndarray, shape (n,); or (p, n) for several plants
    """
    return _at_each(P, Q, L, omega, largest_singular_values)


def _at_each(P, Q, L, omega, size):
    """A size of M at each frequency, for one plant or for several."""
    arguments.instance("L", L, LearningOperator)
    omega = arguments.frequencies("omega", omega, L.Ts)
    given = plants(P)
    _, responses = on_grid(given, omega, L.Ts)
    _, q = Q_on_grid(Q, omega, L=L.Ts)
    check_learning(L, responses[0].shape[1])
    response, together = L.frequency_response(omega), max(1, TOGETHER // len(omega))
    found = []
    for k in range(0, len(responses), together):
        M = convergence_matrix(responses[k : k + together], q, response)
        found.append(size(M.reshape(-1, *M.shape[2:])).reshape(M.shape[:2]))
    return found[0][0] if "P" in given else np.concatenate(found)


def spectral_radii(M) -> np.ndarray:
    """Largest modulus of an eigenvalue of each matrix, shape (n, m, m) to (n,)."""
    if M.shape[1] != 2:
        return np.abs(np.linalg.eigvals(M)).max(axis=1)
    (a, b), (c, d) = np.moveaxis(M, 0, -1)  # in closed form ten times faster
    root = np.sqrt(((a - d) / 2) ** 2 + b * c)
    return np.maximum(np.abs((a + d) / 2 + root), np.abs((a + d) / 2 - root))
