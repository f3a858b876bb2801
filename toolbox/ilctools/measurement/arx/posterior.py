"""The posterior of the unknowns, for given hyperparameters.

With the regressors X, the output y and the variances D of the prior, all in units of the standard
deviation s of the noise,

    U' U = I + D^(1/2) X' X D^(1/2),    x = D^(1/2) U^-1 h,    U' h = D^(1/2) X' y,             (3)
    s^2 = r / n,    r = y' y - h' h,

x is the mean of the unknowns, and s^2 D^(1/2) (U' U)^-1 D^(1/2) is their covariance. If the
products X' X, X' y and y' y come from means over trials, they are multiplied by a weight, because a
disturbance may repeat in these means.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.special import expit

from ilctools.measurement.arx.prior import RHO, prior
from ilctools.measurement.arx.regressors import Data

# Added to the diagonal of U' U, relative to the diagonal. Rounding in Cholesky's method is a few
# hundred times 1e-16 of the diagonal. U' U thus stays positive definite even without noise.
CHOLESKY_ROUNDING = 1e-12
# Smallest r, relative to y' y with a weight of one for means: a smaller r would be rounding.
LEAST_RESIDUE = 1e-14


class Posterior(NamedTuple):
    """The quantities of (3), for unknowns in units of D^(1/2)."""

    root_D: np.ndarray
    U: np.ndarray
    h: np.ndarray
    r: float  # a residual sum of squares
    weight: float  # of means over trials, in which a disturbance may repeat

    @property
    def z(self) -> np.ndarray:
        """The mean D^(-1/2) x of the unknowns in units of D^(1/2)."""
        return solve_triangular(self.U, self.h, check_finite=False)

    @property
    def mean(self) -> np.ndarray:
        """The mean x of the unknowns."""
        return self.root_D * self.z

    def inverse(self) -> np.ndarray:
        """Compute (U' U)^-1."""
        upper = dpotri(self.U)[0]  # below its diagonal there is what U has there: zeros
        return upper + np.triu(upper, 1).T

    @property
    def spread(self) -> np.ndarray:
        """The matrix (X' X + D^-1)^-1, which maps an error of X' y to the resulting error of x."""
        return self.inverse() * np.outer(self.root_D, self.root_D)

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Compute W = U'^-1 D^(1/2) Z for columns Z.

        The covariance of Z' x is then s^2 W' W.
        """
        return solve_triangular(self.U, self.root_D[:, None] * columns, trans=1)


def posterior(eta: np.ndarray, data: Data) -> Posterior:
    """Compute the posterior (3) at one vector of hyperparameters."""
    weight = expit(-eta[RHO]) if data.n_1 else 1.0
    root_D = np.exp(prior(eta, data.layout).log_D / 2)
    G = data.weighted(weight)  # of [X, y]
    XX, Xy, yy = G[:-1, :-1], G[:-1, -1], G[-1, -1]
    UU = root_D[:, None] * XX * root_D
    UU[np.diag_indices_from(UU)] = UU.diagonal() * (1 + CHOLESKY_ROUNDING) + 1
    U = cholesky(UU, check_finite=False)
    h = solve_triangular(U, root_D * Xy, trans=1, check_finite=False)
    least = LEAST_RESIDUE * data.weighted(1.0)[-1, -1]
    return Posterior(root_D, U, h, max(yy - h @ h, 0.0) + least, weight)
