"""How fast do the trials converge? The gamma of Lemma 1, on a grid of frequencies."""

from typing import NamedTuple

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningOperator, check_learning
from rodlib.ilc.posing import Q_on_grid, on_grid, plants
from rodlib.ilc.problem import convergence_matrix, largest_singular_values, tied


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
    arguments.instance("L", L, LearningOperator)
    omega = arguments.frequencies("omega", omega, L.Ts)
    given = plants(P)
    _, responses = on_grid(given, omega, L.Ts)
    _, q = Q_on_grid(Q, omega, L=L.Ts)
    check_learning(L, responses[0].shape[1])
    response = L.frequency_response(omega)
    sigma = [largest_singular_values(convergence_matrix(each, q, response)) for each in responses]
    return sigma[0] if "P" in given else np.array(sigma)
