"""The prior: variances of the unknowns, and the hyperparameters eta on which they depend.

Coefficients decay and neighbours are alike, by the tuned-correlated kernel of their lags i and j,

    cov(g_i, g_j) = s^2 c exp(-max(i, j) / T),

with one c for each kind of unknowns, and one T (T. Chen, H. Ohlsson and L. Ljung, Automatica 48
(2012) 1525-1535; G. Pillonetto and others, Automatica 50 (2014) 657-682). In increments x from lag
to lag it is diagonal,

    x ~ N(0, s^2 D(eta)),    D = c (exp(-i / T) - exp(-(i + gap) / T)),                         (2)

and D = c for slow parts and the steps of a drift. What a start leaves, an input that rested
elsewhere among it, decays from the latest delay on only. e is white with variance s^2.

The hyperparameters are logarithms, and are normal beforehand, each by itself: see `ASSUMED`.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ilctools.measurement.arx.unknowns import Kind, Layout


class Hyperparameters(NamedTuple):
    """eta by name. A search takes it as a vector, np.array(eta)."""

    log_c_A: float
    log_c_B: float
    log_c_start: float
    log_c_drift: float
    log_T: float  # T in samples
    rho: float  # a mean over trials, in which a disturbance may repeat, weighs 1 / (1 + exp(rho))
    log_c_slow: float

    def of_kinds(self) -> np.ndarray:
        """log c of each :class:`Kind`, in its order."""
        by_kind = {
            Kind.A: self.log_c_A,
            Kind.B: self.log_c_B,
            Kind.START: self.log_c_start,
            Kind.DRIFT: self.log_c_drift,
            Kind.SLOW: self.log_c_slow,
        }
        return np.array([by_kind[kind] for kind in Kind])

    @property
    def weight(self) -> float:
        """The weight of means over trials."""
        return expit(-self.rho)


class Assumed(NamedTuple):
    """What is assumed of a hyperparameter before the data: it is normal."""

    centre: float
    width: float  # the standard deviation
    # Whether it is relative to the output: then log(c s^2) has this centre, not log c, where the
    # output is in units of its RMS.
    of_output: bool
    first: tuple[float, float]  # guesses from which searches start: without a drift, and with one


ASSUMED = {
    # Chosen wide: a width of 3 is a factor of 20 in variance either way. The first guesses of c are
    # for noise of 5 % of the output, log s^2 = -6.
    "log_c_A": Assumed(centre=-4.0, width=3.0, of_output=True, first=(2.0, 2.0)),
    "log_c_B": Assumed(centre=-4.0, width=3.0, of_output=True, first=(2.0, 2.0)),
    "log_c_start": Assumed(centre=-4.0, width=3.0, of_output=True, first=(2.0, 2.0)),
    # A drift is no part of what the inputs move: its steps, a quarter of s, are relative to noise.
    # With a guess of a large drift the posterior is up to e^30 higher, in trials under learning.
    "log_c_drift": Assumed(centre=-3.0, width=3.0, of_output=False, first=(-3.0, 6.0)),
    "log_T": Assumed(centre=2.3, width=3.0, of_output=False, first=(2.3, 2.3)),  # ten samples
    # As much of the noise repeats as not.
    "rho": Assumed(centre=0.0, width=3.0, of_output=False, first=(0.0, 0.0)),
    # A twentieth of the size of the output, within a factor of 1.3. The data hardly
    # distinguish the motion of a slow part from a drift.
    "log_c_slow": Assumed(centre=-5.8, width=0.5, of_output=True, first=(-5.8 + 6, -5.8 + 6)),
}


def _by_name(number):
    """One number of each hyperparameter, as a vector."""
    return np.array(Hyperparameters(**{name: number(row) for name, row in ASSUMED.items()}))


CENTRE = _by_name(lambda row: row.centre)
WIDTH = _by_name(lambda row: row.width)
OF_OUTPUT = _by_name(lambda row: float(row.of_output))
FIRST_GUESSES = [_by_name(lambda row, k=k: row.first[k]) for k in range(2)]
# Beyond it a logarithm is as good as infinite: exp(50) is more than a double has digits.
LARGEST_LOGARITHM = 50.0
SHORTEST_LOG_T = -1.5  # a quarter of a sample, from which on all but the first lag are zero
LONGEST_T = 5.0  # longest trials: what is slower is a line in each trial


def bounds_of(longest: int) -> list[tuple[float, float]]:
    """Lower and upper bounds of eta for a search; `longest`: samples of the longest trial."""
    widest = (-LARGEST_LOGARITHM, LARGEST_LOGARITHM)
    every = Hyperparameters(*[widest] * len(Hyperparameters._fields))
    return list(every._replace(log_T=(SHORTEST_LOG_T, np.log(LONGEST_T * longest))))


def standardised(eta: np.ndarray, variance: float) -> np.ndarray:
    """By how many widths eta is away from its centre, where s^2 is this variance."""
    return (eta + OF_OUTPUT * np.log(variance) - CENTRE) / WIDTH


class Prior(NamedTuple):
    """(2) of each unknown."""

    log_D: np.ndarray  # (unknown,)
    slope: np.ndarray  # of log D over log T, (unknown,)


def prior(eta: Hyperparameters, layout: Layout) -> Prior:
    """(2): the variances of the unknowns, relative to s^2."""
    per_T = np.exp(-eta.log_T)  # 1 / T
    lag, gap = layout.lag * per_T, np.minimum(layout.gap * per_T, LARGEST_LOGARITHM)
    log_D = eta.of_kinds()[layout.kind] - lag + np.log(-np.expm1(-gap))  # (2)
    return Prior(log_D, lag - gap / np.expm1(gap))
