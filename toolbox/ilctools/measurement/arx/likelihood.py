"""The marginal likelihood of the hyperparameters, and its maximum with the prior.

Without unknowns, which are integrated over, y is normal. With (3), n_1 samples of means over trials
of the weight w among n, the negative logarithm of its density times the prior of eta is

    n / 2 log r + log |U| - n_1 / 2 log w + |(eta - centre) / width|^2 / 2 -> min,              (4)

as s^2 = r / n is the likeliest. Some entries of eta are relative to the output, see `prior`: their
distance from the centre is that of eta + log s^2.

The gradient and the curvature are exact. With t = log D, z = D^(-1/2) x and V = (U' U)^-1,

    dr / dt_i = -z_i^2,               d^2 r / dt_i dt_j = -2 z_i V_ij z_j  (+ z_i^2 if i = j),
    dlog|U| / dt_i = (1 - V_ii) / 2,  d^2 log|U| / dt_i dt_j = -V_ij^2 / 2  (+ V_ii / 2),      (4a)

and with X_1 and y_1 of means over trials, e_1 = y_1 - X_1 x, g = D^(1/2) X_1' e_1 and
K = D^(1/2) X_1' X_1 D^(1/2),

    dr / dw = e_1' e_1,             d^2 r / dw^2 = -2 g' V g,            d^2 r / dw dt = -2 z V g,
    dlog|U| / dw = tr(V K) / 2,     d^2 log|U| / dw^2 = -tr(V K V K) / 2,
    d^2 log|U| / dw dt_i = (V K V)_ii / 2.                                                     (4b)

With a drift and without one (4) may have a minimum each: the search starts near both.
"""

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import (
    FIRST_GUESSES,
    OF_OUTPUT,
    WIDTH,
    Hyperparameters,
    prior,
    standardised,
)
from ilctools.measurement.arx.regressors import Data
from ilctools.measurement.arx.unknowns import Kind

# Of Newton's method with a trust region: eta may move by as much at once, a factor of 400 in
# variance. From where the gradient is that small, `NEWTON_STEPS` lead to rounding.
SEARCH = {"initial_trust_radius": 2.0, "max_trust_radius": 6.0, "gtol": 1e-2, "maxiter": 60}
NEWTON_STEPS = 3
LONGEST_NEWTON_STEP = 1.0  # of each hyperparameter
# A search ends where (4) is above the least by more than so many times of what a Newton step gains.
PATIENCE = 4.0
NAMES = Hyperparameters._fields
LOG_T, RHO = NAMES.index("log_T"), NAMES.index("rho")


class Likelihood:
    """(4) at one eta, with its gradient and its curvature."""

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
        r, log_U = self._of_variances()
        if self.data.n_1:
            r, log_U = self._with_means(r, log_U)
        of_r = r.first / self._at.r  # those of log r
        curved = r.second / self._at.r - np.outer(of_r, of_r)
        # n' = n + 2 sum (eta - centre) / width^2 over what is relative to the output
        n = self.data.n + 2 * OF_OUTPUT @ (self._away / WIDTH)
        moved = np.diag(1 / WIDTH) + np.outer(OF_OUTPUT / WIDTH, of_r)  # of what is standardised
        gradient = n / 2 * of_r + log_U.first + self._away / WIDTH
        return gradient, n / 2 * curved + log_U.second + moved.T @ moved

    @property
    def gradient(self) -> np.ndarray:
        """Of (4) over eta, (entry,)."""
        return self._slopes[0]

    @property
    def curvature(self) -> np.ndarray:
        """Of (4) over eta, (entry, entry)."""
        return self._slopes[1]

    @cached_property
    def _V(self):
        half = self._at.inverse()
        return np.triu(half) + np.triu(half, 1).T

    @cached_property
    def _of_log_D(self):
        """The slopes of t = log D over eta, (unknown, entry), and its curvature over log T."""
        layout = self.data.layout
        of_D = prior(Hyperparameters(*self.eta), layout)
        kinds = [NAMES.index(kind.hyperparameter) for kind in Kind]
        slopes = np.zeros((layout.size, len(NAMES)))
        slopes[np.arange(layout.size), np.take(kinds, layout.kind)] = 1.0
        slopes[:, LOG_T] = of_D.slope
        return slopes, of_D.curvature

    def _of_variances(self):
        """(4a) of r and of log |U|, by the slopes J of t."""
        (J, curved), z2, V = self._of_log_D, self._at.z**2, self._V
        of_r, of_log_U = -z2, (1 - np.diag(V)) / 2
        zJ = self._at.z[:, None] * J
        r = Slopes(J.T @ of_r, 2 * (zJ.T @ zJ / 2 - zJ.T @ V @ zJ))
        alone = J.T @ (np.diag(V)[:, None] * J)
        log_U = Slopes(J.T @ of_log_U, (alone - J.T @ (V * V) @ J) / 2)
        r.second[LOG_T, LOG_T] += of_r @ curved
        log_U.second[LOG_T, LOG_T] += of_log_U @ curved
        return r, log_U

    def _with_means(self, r, log_U):
        """(4b) in addition, where d w / d rho = -w (1 - w)."""
        (J, _), z, V, w = self._of_log_D, self._at.z, self._V, self._at.weight
        G_1, root_D = self.data.means, self._at.root_D
        rest = G_1 @ np.append(-root_D * z, 1.0)  # [X_1, y_1]' e_1
        g, Vg = root_D * rest[:-1], V @ (root_D * rest[:-1])
        VK = V @ (root_D[:, None] * G_1[:-1, :-1] * root_D)
        n_1 = self.data.n_1
        by_w = Slopes(
            np.array([np.append(-root_D * z, 1.0) @ rest, np.trace(VK) / 2 - n_1 / (2 * w)]),
            np.array([-2 * g @ Vg, -np.sum(VK * VK.T) / 2 + n_1 / (2 * w**2)]),
        )
        mixed = -2 * J.T @ (z * Vg), J.T @ np.sum(VK * V, axis=1) / 2
        slope, curved = -w * (1 - w), w * (1 - w) * (1 - 2 * w)
        for one, first, second, both in zip((r, log_U), *by_w, mixed, strict=True):
            one.first[RHO] += first * slope
            one.second[RHO] += both * slope
            one.second[:, RHO] += both * slope
            one.second[RHO, RHO] += second * slope**2 + first * curved
        return r, log_U


class Slopes(NamedTuple):
    """First and second derivatives over eta."""

    first: np.ndarray  # (entry,)
    second: np.ndarray  # (entry, entry)


class Fit(NamedTuple):
    """The likeliest hyperparameters for some delays."""

    eta: np.ndarray
    cost: float  # (4)
    data: Data


def likeliest(data: Data, first=FIRST_GUESSES, least: float = np.inf) -> Fit:
    """The minimum of (4) that is found from the first guesses.

    A search that will not come below `least` ends early, somewhere above.
    """
    found = [_search(data, eta, least) for eta in first]
    best = min(found, key=lambda likelihood: likelihood.value)
    return Fit(best.eta, best.value, data)


def _search(data, first, least):
    """The likelihood where Newton's method leads to from a first guess."""

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
    """A Newton step, where (4) is taken to be no less curved than the prior."""

    step: np.ndarray  # (entry,)
    gain: float  # by how much a parabola falls
    S: np.ndarray  # by which the curvature is (S S)^-1, (entry, entry)


def newton(at: Likelihood) -> Newton:
    """The Newton step from a point."""
    values, vectors = np.linalg.eigh(at.curvature)
    # Symmetric, so that S has no signs to choose.
    S = vectors / np.sqrt(np.maximum(values, WIDTH.max() ** -2)) @ vectors.T
    step = -S @ S @ at.gradient
    return Newton(step, -step @ at.gradient / 2, S)


def polished(fit: Fit) -> tuple[Fit, np.ndarray]:
    """The fit to rounding, and S, by which the curvature of (4) is (S S)^-1.

    What is estimated does not depend on where a search ends.
    """
    at = Likelihood(fit.eta, fit.data)
    for _ in range(NEWTON_STEPS):
        step = np.clip(newton(at).step, -LONGEST_NEWTON_STEP, LONGEST_NEWTON_STEP)
        at = Likelihood(at.eta + step, fit.data)
    return fit._replace(eta=at.eta, cost=at.value), newton(at).S
