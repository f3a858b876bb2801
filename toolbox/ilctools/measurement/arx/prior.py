"""The prior: variances of the unknowns, and the hyperparameters eta on which they depend.

By the prior, coefficients decay with the lag, and neighbouring coefficients are similar. The prior
is the tuned-correlated kernel of their lags i and j,

    cov(g_i, g_j) = s^2 c exp(-max(i, j) / T),

with one c for each kind of unknowns, and one T (T. Chen, H. Ohlsson and L. Ljung, Automatica 48
(2012) 1525-1535; G. Pillonetto and others, Automatica 50 (2014) 657-682). For the increments x from
lag to lag, the covariance is diagonal,

    x ~ N(0, s^2 D(eta)),    D = c (exp(-i / T) - exp(-(i + gap) / T)),                         (2)

where gap is the distance to the next lag. For parts (see `parts`) and the steps of a drift,
D = c. For the response to the initial condition, D decays only from the longest delay of an input
on, because this response includes the effect of an input that had another value before the trial.
The noise e is white with variance s^2.

The hyperparameters are logarithms. In the prior they are normal and independent, see `ASSUMED`.
"""

from typing import NamedTuple

import numpy as np

from ilctools.measurement.arx.unknowns import Kind, Layout


class Hyperparameters(NamedTuple):
    """The entries of the hyperparameters eta, by name; elsewhere eta is a vector."""

    log_c_A: float
    log_c_B: float
    log_c_START: float
    log_c_DRIFT: float
    log_T: float  # T in samples
    rho: float  # a mean over trials, in which a disturbance may repeat, weighs 1 / (1 + exp(rho))
    log_c_PART: float


NAMES = Hyperparameters._fields
# Where eta has the log c of each kind, log T and rho.
LOG_C = np.array([NAMES.index(f"log_c_{kind.name}") for kind in Kind])
LOG_T, RHO = NAMES.index("log_T"), NAMES.index("rho")


class Assumed(NamedTuple):
    """The normal prior of one hyperparameter."""

    centre: float
    # The standard deviation. It is wide: 3 is a factor of 20 in variance either way.
    width: float = 3.0
    # Whether the hyperparameter is relative to the output: then log(c s^2) has this centre, and not
    # log c. The output is in units of its RMS.
    of_output: float = False


ASSUMED = Hyperparameters(
    log_c_A=Assumed(-4.0, of_output=True),
    log_c_B=Assumed(-4.0, of_output=True),
    log_c_START=Assumed(-4.0, of_output=True),
    # The inputs do not cause a drift: its steps, a quarter of s, are therefore relative to noise.
    log_c_DRIFT=Assumed(-3.0),
    log_T=Assumed(2.3),  # ten samples
    rho=Assumed(0.0),  # as much of the noise repeats as not
    # A twentieth of the size of the output, within a factor of 1.3. The data hardly
    # distinguish the motion of a slow part from a drift.
    log_c_PART=Assumed(-5.8, width=0.5, of_output=True),
)
CENTRE, WIDTH, OF_OUTPUT = np.array(ASSUMED).T
# Searches start from these guesses, without a drift and with one. log s^2 = -6 is noise of 5 % of
# the output. With a guess of a large drift the posterior is up to e^30 higher, in trials under
# learning.
LOG_NOISE, LARGE_DRIFT = -6, 6.0
WITHOUT_DRIFT = Hyperparameters(*(CENTRE - LOG_NOISE * OF_OUTPUT))
FIRST_GUESSES = np.array([WITHOUT_DRIFT, WITHOUT_DRIFT._replace(log_c_DRIFT=LARGE_DRIFT)])
# A larger logarithm is as good as infinite: exp(50) is more than a double has digits.
LARGEST_LOGARITHM = 50.0


def standardised(eta: np.ndarray, variance: float) -> np.ndarray:
    """Compute the distance of eta from the centre of its prior, in units of the width.

    The argument `variance` is s^2.
    """
    return (eta + OF_OUTPUT * np.log(variance) - CENTRE) / WIDTH


class Prior(NamedTuple):
    """The prior variances (2) of the unknowns, and their derivatives."""

    log_D: np.ndarray  # (unknown,)
    slopes: np.ndarray  # derivatives of log D over eta, (unknown, entry)
    # Second derivative of log D over log T, (unknown,). All other second derivatives are zero.
    curvature: np.ndarray


def prior(eta: np.ndarray, layout: Layout) -> Prior:
    """Compute (2), the variances of the unknowns relative to s^2."""
    per_T = np.exp(-eta[LOG_T])  # 1 / T
    lag, gap = layout.lag * per_T, np.minimum(layout.gap * per_T, LARGEST_LOGARITHM)
    log_D = np.take(eta, LOG_C[layout.kind]) - lag + np.log(-np.expm1(-gap))  # (2)
    falls = gap / np.expm1(gap)
    slopes = np.eye(len(NAMES))[LOG_C[layout.kind]]
    slopes[:, LOG_T] = lag - falls
    return Prior(log_D, slopes, falls * (1 - gap - falls) - lag)
