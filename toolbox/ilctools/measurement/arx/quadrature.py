"""The covariance of the unknowns, integrated over the hyperparameters.

Near the likeliest eta, the hyperparameters are taken to be normally distributed with the covariance
S S'. This covariance is the inverse of the curvature (the matrix of second derivatives) of the cost
(4) in `likelihood`. A cubature rule integrates over the hyperparameters with the points

    eta + HEAVY sqrt(d) S_k,    eta - HEAVY sqrt(d) S_k,    k = 1 ... d,                        (5)

where d is the number of entries and S_k are the columns of S (I. Arasaratnam and S. Haykin, IEEE
Trans. Autom. Control 54 (2009) 1254-1269, where HEAVY is one). At each point the unknowns have a
mean and a covariance, by (3) in `posterior`. The covariance over all points is a sum of three
matrices. The first one is the mean of the covariances. The second one is the mean square of the
difference between each mean and the mean at the likeliest eta. The rule uses no random numbers.

The third matrix is for slow parts (see `parts`). The data hardly distinguish the motion of a slow
part from a drift, and the likelihood hardly depends on the size of slow parts. The prior therefore
decides how large they are, and a plant may have larger ones. The third matrix is the square of the
change of the mean if the prior makes all parts `LARGER_PARTS` times as large.
"""

import numpy as np

from ilctools.measurement.arx.posterior import posterior
from ilctools.measurement.arx.prior import LARGEST_LOGARITHM, LOG_C
from ilctools.measurement.arx.regressors import Data
from ilctools.measurement.arx.unknowns import Kind

HEAVY = 1.2  # width of the tails of eta, relative to normal tails, found by counting
# With 2.7, the region of 99 % held 96 % of 200 plants with a slow part of opposite sign. With a
# larger value, radii at rest are wider.
LARGER_PARTS = 3.5


def covariance(eta: np.ndarray, S: np.ndarray, data: Data) -> np.ndarray:
    """Compute the covariance of the unknowns x over the points (5).

    The result has the shape (unknown, unknown).
    """
    apart = HEAVY * np.sqrt(len(S)) * np.concatenate([S, -S])  # (5); S is symmetric
    points = np.clip(eta + apart, -LARGEST_LOGARITHM, LARGEST_LOGARITHM)
    mean, C = posterior(eta, data).mean, 0.0
    for point in points:
        there = posterior(point, data)
        moved = there.mean - mean
        C = C + (there.r / data.n * there.spread + np.outer(moved, moved)) / len(points)
    larger = np.array(eta)
    larger[LOG_C[Kind.PART]] += 2 * np.log(LARGER_PARTS)
    moved = posterior(larger, data).mean - mean
    return C + np.outer(moved, moved)
