"""The marginal likelihood of the hyperparameters, and its maximum with the prior.

Without unknowns, which are integrated over, y is normal. With (3), n_1 samples of means over trials
of the weight w among n, the negative logarithm of its density times the prior of eta is

    n / 2 log r + log |U| - n_1 / 2 log w + |(eta - centre) / width|^2 / 2 -> min,              (4)

as s^2 = r / n is the likeliest. Some entries of eta are relative to the output, see `prior`: their
distance from the centre is that of eta + log s^2. The gradient is exact.

With a drift and without one (4) may have a minimum each: the search starts near both. BFGS leaves
eta some way off, so Newton steps follow: what is estimated does not depend on where a search ends.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import (
    FIRST_GUESSES,
    OF_OUTPUT,
    WIDTH,
    Hyperparameters,
    bounds_of,
    prior,
    standardised,
)
from ilctools.measurement.arx.regressors import Data
from ilctools.measurement.arx.unknowns import Kind

SEARCH = {"maxiter": 60, "ftol": 1e-7}  # of BFGS: Newton steps do what is left
CURVATURE_STEP = 1e-3  # of eta, for differences of the gradient
NEWTON_STEPS = 4  # after which eta is known to rounding
LONGEST_NEWTON_STEP = 1.0  # of each hyperparameter


def negative_log_posterior(eta: np.ndarray, data: Data) -> tuple[float, np.ndarray]:
    """(4) and its gradient over eta."""
    at, n = posterior(eta, data), data.n
    away = standardised(eta, at.r / n)
    log_U = np.log(np.diag(at.U)).sum()  # log |U|
    value = n / 2 * np.log(at.r) + log_U + away @ away / 2 - data.n_1 / 2 * np.log(at.weight)  # (4)
    return value, _gradient(Hyperparameters(*eta), data, at, away)


def _gradient(eta, data, at, away):
    """The gradient of (4).

    With z = D^(-1/2) x and n' = n + 2 sum (eta - centre) / width^2 over all entries that are
    relative to the output, as they move with log r,

        d / d log D_i = (1 - (U' U)^-1_ii - n' z_i^2 / r) / 2.                                 (4a)
    """
    z, inverse = at.z, at.inverse()
    n = data.n + 2 * OF_OUTPUT @ (away / WIDTH)  # n'
    by_log_D = (1 - np.diag(inverse) - n * z**2 / at.r) / 2  # (4a)
    by_kind = np.bincount(data.layout.kind, by_log_D, len(Kind))
    of_likelihood = Hyperparameters(
        **{kind.hyperparameter: by_kind[kind] for kind in Kind},
        log_T=by_log_D @ prior(eta, data.layout).slope,
        rho=_by_rho(data, at, z, inverse, n),
    )
    return np.array(of_likelihood) + away / WIDTH


def _by_rho(data, at, z, inverse, n):
    """The slope of (4) over rho. With X_1 and y_1 of means over trials, and their weight w,

    d / d w = (n' |y_1 - X_1 x|^2 / r + tr((U' U)^-1 D^(1/2) X_1' X_1 D^(1/2)) - n_1 / w) / 2,
    d w / d rho = -w (1 - w).                                                              (4b)
    """
    if not data.n_1:
        return 0.0
    G_1, w, residual = data.means, at.weight, np.append(-at.root_D * z, 1.0)
    whole = inverse + np.triu(inverse, 1).T
    trace = at.root_D @ (whole * G_1[:-1, :-1]) @ at.root_D
    by_w = (n * (residual @ G_1 @ residual) / at.r + trace - data.n_1 / w) / 2
    return -w * (1 - w) * by_w  # (4b)


class Fit(NamedTuple):
    """The likeliest hyperparameters for some delays."""

    eta: np.ndarray
    cost: float  # (4)
    data: Data


def likeliest(data: Data, longest: int, first=FIRST_GUESSES) -> Fit:
    """The minimum of (4) that is found from the first guesses."""
    searches = [
        minimize(
            negative_log_posterior, eta, (data,), jac=True, method="L-BFGS-B",
            bounds=bounds_of(longest), options=SEARCH,
        )
        for eta in first
    ]  # fmt: skip
    found = min(searches, key=lambda search: search.fun)
    return Fit(found.x, found.fun, data)


def polished(fit: Fit) -> tuple[Fit, np.ndarray]:
    """The fit to rounding, and S, by which the curvature of (4) is (S S)^-1."""
    eta, data = fit.eta.copy(), fit.data

    def gradient(eta):
        return negative_log_posterior(eta, data)[1]

    steps = CURVATURE_STEP * np.eye(len(eta))
    H = np.array([gradient(eta + e) - gradient(eta - e) for e in steps])
    values, vectors = np.linalg.eigh((H + H.T) / (4 * CURVATURE_STEP))
    # No less curved than the prior, and symmetric, so that S has no signs to choose.
    S = vectors / np.sqrt(np.maximum(values, WIDTH.max() ** -2)) @ vectors.T
    for _ in range(NEWTON_STEPS):
        eta -= np.clip(S @ S @ gradient(eta), -LONGEST_NEWTON_STEP, LONGEST_NEWTON_STEP)
    return fit._replace(eta=eta), S
