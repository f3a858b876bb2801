"""The marginal likelihood of the hyperparameters, and its maximum with the prior.

After integration over the unknowns x, the output y is normally distributed. Equation (3) in
`posterior` defines r and U. Among the n samples, n_1 samples belong to means over trials, which
have the weight w. The negative logarithm of the density of y times the prior of eta is

    n / 2 log r + log |U| - n_1 / 2 log w + |(eta - centre) / width|^2 / 2 -> min,              (4)

where the variance s^2 of the noise has its likeliest value, r / n. Some entries of eta are relative
to the output, see `prior`. For these entries, eta + log s^2 replaces eta in the last term.

The gradient and the curvature (the matrix of second derivatives) are exact. Let J_k and w_k be the
derivatives of log D and of w with respect to entry k of eta, z = D^(-1/2) x and V = (U' U)^-1. For
means over trials, let e_1 = y_1 - X_1 x, g = D^(1/2) X_1' e_1 and K = D^(1/2) X_1' X_1 D^(1/2). If
the scaling by D^(1/2) is held fixed, the derivative of U' U is M_k = w_k K - diag(J_k). The
derivative of the product of U' U with z is q_k = w_k g + diag(J_k) z. The derivatives are

    dr = w_k e_1' e_1 - z' diag(J_k) z,          d^2 r = -2 q_k' V q_l + ...,
    d log |U| = (tr V M_k + sum of J_k) / 2,     d^2 log |U| = -tr(V M_k V M_l) / 2 + ...,     (4a)

where the dots stand for terms with second derivatives of log D and of w.

The cost (4) may have one minimum with a drift and another minimum without a drift. The search
starts near both minima.
"""

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import (
    FIRST_GUESSES,
    LOG_T,
    OF_OUTPUT,
    RHO,
    WIDTH,
    prior,
    standardised,
)
from ilctools.measurement.arx.regressors import Data

# Options of Newton's method with a trust region: eta may move by the largest radius at once, which
# is a factor of 400 in variance. If the gradient is below gtol, `NEWTON_STEPS` more steps are exact
# up to rounding.
SEARCH = {"initial_trust_radius": 2.0, "max_trust_radius": 6.0, "gtol": 1e-2, "maxiter": 60}
NEWTON_STEPS = 3
LONGEST_NEWTON_STEP = 1.0  # of each hyperparameter
# A search ends if (4) exceeds the least value by more than PATIENCE times what a Newton step gains.
PATIENCE = 4.0


class Likelihood:
    """The function (4) at one eta, with its gradient and its curvature."""

    def __init__(self, eta: np.ndarray, data: Data):
        self.eta, self.data = np.array(eta), data
        self._at = posterior(self.eta, data)
        self._away = standardised(self.eta, self._at.r / data.n)
        log_U = np.log(np.diag(self._at.U)).sum()
        of_means = -data.n_1 / 2 * np.log(self._at.weight)
        of_eta = self._away @ self._away / 2
        self.value = data.n / 2 * np.log(self._at.r) + log_U + of_means + of_eta  # (4)

    @cached_property
    def _slopes(self):
        """The gradient and the curvature of (4)."""
        r, log_U = self._of_parts()
        of_r = r.first / self._at.r  # the slopes of log r
        curved = r.second / self._at.r - np.outer(of_r, of_r)
        # n' = n + 2 sum (eta - centre) / width^2 over what is relative to the output
        n = self.data.n + 2 * OF_OUTPUT @ (self._away / WIDTH)
        moved = np.diag(1 / WIDTH) + np.outer(OF_OUTPUT / WIDTH, of_r)  # of what is standardised
        gradient = n / 2 * of_r + log_U.first + self._away / WIDTH
        return Slopes(gradient, n / 2 * curved + log_U.second + moved.T @ moved)

    @property
    def gradient(self) -> np.ndarray:
        """The gradient of (4) with respect to eta, shape (entry,)."""
        return self._slopes.first

    @property
    def curvature(self) -> np.ndarray:
        """The second derivatives of (4) with respect to eta, shape (entry, entry)."""
        return self._slopes.second

    def _of_parts(self):
        """Compute by (4a) the derivatives of r, and those of log |U| - n_1 / 2 log w."""
        data, at, z = self.data, self._at, self._at.z
        _, J, curved = prior(self.eta, data.layout)
        V = at.inverse()
        of_r, of_log_U = -(z**2), (1 - np.diag(V)) / 2  # over log D
        r = Slopes(J.T @ of_r, J.T @ (z[:, None] ** 2 * J))
        log_U = Slopes(J.T @ of_log_U, J.T @ (np.diag(V)[:, None] * J) / 2)
        r.second[LOG_T, LOG_T] += of_r @ curved
        log_U.second[LOG_T, LOG_T] += of_log_U @ curved
        q, traces = z[:, None] * J, J.T @ (V * V) @ J  # tr(V M_k V M_l)
        if data.n_1:
            self._add_means(V, J, r, log_U, q, traces)
        r.second[:] -= 2 * q.T @ V @ q
        log_U.second[:] -= traces / 2
        return r, log_U

    def _add_means(self, V, J, r, log_U, q, traces):
        """Add to the derivatives the terms of rho, which determines the weight of means."""
        data, at, w = self.data, self._at, self._at.weight
        residual = np.append(-at.root_D * at.z, 1.0)
        products = data.means @ residual  # [X_1, y_1]' e_1
        VK = V @ (at.root_D[:, None] * data.means[:-1, :-1] * at.root_D)
        slope, curved = -w * (1 - w), w * (1 - w) * (1 - 2 * w)  # of w over rho
        by_w = residual @ products, np.trace(VK) / 2 - data.n_1 / (2 * w)
        for part, over_w in zip((r, log_U), by_w, strict=True):
            part.first[RHO] = slope * over_w
            part.second[RHO, RHO] += curved * over_w
        log_U.second[RHO, RHO] += slope**2 * data.n_1 / (2 * w**2)
        mixed = J.T @ np.sum(VK * V, axis=1)
        q[:, RHO] = slope * at.root_D * products[:-1]
        traces[RHO] -= slope * mixed
        traces[:, RHO] -= slope * mixed
        traces[RHO, RHO] += slope**2 * np.sum(VK * VK.T)


class Slopes(NamedTuple):
    """First and second derivatives with respect to eta."""

    first: np.ndarray  # (entry,)
    second: np.ndarray  # (entry, entry)


class Fit(NamedTuple):
    """The likeliest hyperparameters for some delays."""

    eta: np.ndarray
    cost: float  # (4)
    data: Data


def likeliest(data: Data, first=FIRST_GUESSES, least: float = np.inf) -> Fit:
    """Search for the minimum of (4), once from each first guess.

    If a search is not expected to come below `least`, the search ends early, at a value above
    `least`.
    """
    found = [_search(data, eta, least) for eta in first]
    best = min(found, key=lambda likelihood: likelihood.value)
    return Fit(best.eta, best.value, data)


def _search(data, first, least):
    """Compute the likelihood at the point to which Newton's method leads from a first guess."""

    @lru_cache(maxsize=2)  # scipy asks for value, gradient and curvature one by one
    def kept(entries):
        return Likelihood(np.array(entries), data)

    def at(eta):
        return kept(tuple(eta))

    def hopeless(intermediate_result):
        here = at(intermediate_result.x)
        if here.value - PATIENCE * newton(here).gain > least:
            raise StopIteration

    found = minimize(
        lambda eta: at(eta).value, first, method="trust-exact", jac=lambda eta: at(eta).gradient,
        hess=lambda eta: at(eta).curvature, options=SEARCH, callback=hopeless,
    )  # fmt: skip
    return at(found.x)


class Newton(NamedTuple):
    """A Newton step, computed from the curvature of (4).

    Curvatures below the smallest curvature of the prior are replaced by this smallest curvature.
    """

    step: np.ndarray  # (entry,)
    gain: float  # by how much a parabola falls in this step
    S: np.ndarray  # (entry, entry): the curvature is (S S)^-1


def newton(at: Likelihood) -> Newton:
    """Compute the Newton step from a point."""
    values, vectors = np.linalg.eigh(at.curvature)
    # S is symmetric, so that no signs have to be chosen.
    S = vectors / np.sqrt(np.maximum(values, WIDTH.max() ** -2)) @ vectors.T
    step = -S @ S @ at.gradient
    return Newton(step, -step @ at.gradient / 2, S)


def polished(fit: Fit) -> tuple[Fit, np.ndarray]:
    """Refine a fit up to rounding; return the fit and a symmetric matrix S.

    The curvature of (4) is (S S)^-1. After the refinement, the estimate does not depend on the
    point at which a search ends.
    """
    at = Likelihood(fit.eta, fit.data)
    for _ in range(NEWTON_STEPS):
        step = np.clip(newton(at).step, -LONGEST_NEWTON_STEP, LONGEST_NEWTON_STEP)
        at = Likelihood(at.eta + step, fit.data)
    return fit._replace(eta=at.eta, cost=at.value), newton(at).S
