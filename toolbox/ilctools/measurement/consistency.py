"""Score tests of whether the records come from one linear plant that does not change.

The model is y = X x + Z delta + e, with x ~ N(0, s^2 D) and e ~ N(0, s^2 W^-1). X and x are the
regressors and the unknowns of the regression in :mod:`.arx.regression`. The noise has the variance
s^2, x has the prior covariance s^2 D, and W holds the weights of the samples. A hypothesis adds the
columns Z with the coefficients delta. The regression supposes that delta is zero. At the estimate x
of the regression, the score q of delta and its information J need no further fit:

    q = Z' W (y - X x),    J = Z' W Z - Z' W X (X' W X + D^-1)^-1 X' W Z,                       (1)
    F = q' J^-1 q / (k s^2),                                                                    (2)

If delta = 0 and the number n of samples is large, F has an F(k, n) distribution, where k is the
number of columns of Z (C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50-57). The hypotheses are
tested one after the other. Each hypothesis is a set of columns Z, filtered by A, which is the
denominator of the estimated plant:

- The simulated output of one trial, and its derivative, stand for another gain or another delay in
  this trial. If there is a single trial, these two columns are multiplied by the time. They then
  stand for a gain or a delay that changes during the trial.
- The sign of the last change of each input, filtered by the plant, stands for backlash. Backlash
  transmits u minus half the gap times this sign.
- Squares and cubes of signals stand for a curved characteristic, a dead zone or a nonlinear spring.
  The squares and cubes of the inputs and of the measured output are filtered by the plant. The
  squares and cubes of the simulated output are used as they are.

All these hypotheses are about P, which is the response to the commanded inputs. In the first
hypothesis, the simulated output is therefore the response to the commanded inputs alone. Backlash,
squares and cubes of inputs are also tested for commanded inputs alone, and not for inputs that are
known disturbances. Only the simulated output whose squares and cubes are tested includes the effect
of known disturbances.

Every test first subtracts what another gain of each input would explain, for two reasons. First,
the prior makes the estimated gains too small. Second, if an input has only two levels, its squares
and cubes act like another gain.

*Feedback.* If the record has no reference, u may follow y, because a controller C computes u from
y. Then -1 / C is estimated, and no test of residuals can distinguish this loop from a plant -1 / C.
But a plant with a lag and without a lead responds within the same sample with only a part of its
final response. A sampled plant does not respond at all within the same sample. A contradiction is
therefore reported under two conditions. First, u(t) must explain a part of y(t) by the F test (2).
Second, the first coefficient of the impulse response must not be between 0 and 1.1 times the sum of
all coefficients. The factor is 0.5 instead of 1.1 if u(t) explains a million times the power of the
residual. This is the case for a proportional controller, or for a plant without lags and almost
without noise. If this contradiction is reported, the error of P is unknown, and is taken to be as
large as P.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, helmert
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from ilctools.measurement.arx.regression import Regression
from ilctools.measurement.arx.regressors import products
from ilctools.measurement.arx.trials import Series, Trials, contrasts, longest_of
from ilctools.measurement.arx.unknowns import Kind

FALSE_ALARM = 1e-3  # probability of a false contradiction, for each output
# The first coefficient of an impulse response, relative to the sum of all: no plant has more than
# WHOLE. No plant has more than HALF if u(t) explains ALMOST_ALL times the power of the rest. The
# numbers were found by counting.
WHOLE, HALF, ALMOST_ALL = 1.1, 0.5, 1e6
EXPLAINED = 1e-9  # relative: a smaller part of a column that others do not explain is rounding
CURVED = "the response to large inputs differs from that to small ones"
PLAY = "the response differs after moves up and down, as with backlash"
FOLLOWS = (
    "u follows y, as in a loop whose reference is not in the log, or the plant responds "
    "before its input. The estimate may be -1/C of a controller C: add the reference (if "
    "nothing is fed back, the reference is u itself)"
)


class Hypothesis(NamedTuple):
    """A behaviour that no linear plant has, expressed by columns of Z."""

    words: str
    columns: int
    # Whether the hypothesis is about a part of the records. The first column is then the output of
    # this part, whose power stands for P. For other hypotheses, the power of the gains of all
    # commanded inputs stands for P.
    of_part: bool


class Contradiction(NamedTuple):
    """A contradiction of the records with one linear plant."""

    words: str
    by: float  # size of the contradiction, relative to P


class Score(NamedTuple):
    """The score q and its information J, equation (1), for columns Z."""

    q: np.ndarray  # (column,)
    J: np.ndarray  # (column, column)
    power: np.ndarray  # Z' W Z

    def explained(self, columns: list[int]) -> float:
        """Compute q' J^-1 q of some columns.

        If a column is a linear combination of other columns, this column adds nothing.
        """
        unit, among = np.sqrt(self.power.diagonal()), np.ix_(columns, columns)
        z, J = (self.q / unit)[columns], (self.J / unit / unit[:, None])[among]
        return z @ np.linalg.pinv(J, EXPLAINED, True) @ z


def contradictions(
    fit: Regression, groups: Sequence[Trials], reference: bool = True
) -> Iterator[Contradiction]:
    """Find what contradicts one linear plant.

    Each contradiction is stated in words, with its size relative to P. `reference` says whether the
    reference is in the record. If the reference is missing, u may follow y.
    """
    asked, n = hypotheses(groups), fit.data.n
    level = FALSE_ALARM / len(asked)
    if fit.stable:
        found, gains = score(fit, groups, columns_of(fit, groups)), [*range(groups[0].u.shape[2])]
        of_gains = found.explained(gains)
        first = len(gains)  # of the columns of a hypothesis
        for words, k, of_part in asked:
            columns, first = [*range(first, first + k)], first + k
            more = max(found.explained(gains + columns) - of_gains, 0)
            F = n * more / k / fit.posterior.r  # (2)
            if fdtrc(k, n, F) < level:
                of_P = columns[:1] if of_part else gains[: fit.commanded]
                yield Contradiction(words, np.sqrt(more / found.power[np.ix_(of_P, of_P)].sum()))
    if not reference and _at_once(fit, level):
        yield Contradiction(FOLLOWS, 1.0)


def hypotheses(groups: Sequence[Trials]) -> list[Hypothesis]:
    """List all hypotheses that are tested, in the order of their columns in `columns_of`."""
    m, asked = groups[0].commanded, []
    for group in groups:
        alone = len(group.y) == 1
        asked += [Hypothesis(f"the course of {k}" if alone else k, 2, True) for k in group.names]
    return [*asked, Hypothesis(PLAY, m, False), Hypothesis(CURVED, 4 * m + 2, False)]


def score(
    fit: Regression, groups: Sequence[Trials], added: Callable[[Series], np.ndarray]
) -> Score:
    """Compute the score and its information, equation (1).

    The columns Z are one column for a change in the gain of each input, and the columns that
    `added` makes.
    """
    at, layout, mean, p = fit.posterior, fit.data.layout, fit.mean, len(fit.mean)
    G = products(groups, layout, added).weighted(at.weight)  # of [X, y, columns]
    gains = np.zeros((p, len(layout.delays)))
    for j in range(len(layout.delays)):
        where = layout.where_B(j)
        gains[where, j] = mean[where]
    Z = block_diag(gains, np.eye(len(G) - p)[:, 1:])
    across, power = G[:p] @ Z, Z.T @ G @ Z  # X' W Z and Z' W Z
    known = at.whitened(across)
    return Score(
        q=Z.T @ G[p] - mean @ across,  # (1)
        J=power - known.T @ known,  # (1)
        power=power + 1e-300,
    )


def columns_of(fit: Regression, groups: Sequence[Trials]) -> Callable[[Series], np.ndarray]:
    """Return a function that computes the transpose of Z, (column, time), for a series of trials.

    A series is the mean of trials or a difference between them, see :mod:`.arx.trials`. Z has first
    the columns of each trial, and then the columns of the other hypotheses. The columns of single
    trials are made only when they are needed, because 90 trials have 180 such columns in each
    series.
    """
    g = fit.impulse(longest_of(groups)).T
    made = [_of_group(fit, g, group) for group in groups]
    ends = np.cumsum([len(group.y) for group in groups])

    def of(series):
        of_group, end, N = made[series.key.group], ends[series.key.group], len(series.y)
        weights = helmert(series.trials, full=True)[series.key.contrast]
        of_trials = np.zeros((ends[-1], 2, N))
        of_trials[end - series.trials : end] = weights[:, None, None] * of_group.own
        return np.vstack([of_trials.reshape(-1, N), of_group.shared[series.key.contrast].T])

    return of


class _OfGroup(NamedTuple):
    """The columns of the trials of a group."""

    own: np.ndarray  # columns of each trial alone, (trial, 2, time)
    shared: np.ndarray  # columns of all hypotheses on all trials, (contrast, time, column)


def _of_group(fit, g, group):
    """Make the columns of a group of trials.

    The argument `g` holds the impulse responses to all inputs, shape (time, m + d).
    """
    K, N, _ = group.u.shape
    of_P, u = g[:, : group.commanded], group.u[..., : group.commanded]
    answer = _through(of_P, u).sum(axis=2, keepdims=True)
    y = _through(g, group.u).sum(axis=2, keepdims=True)
    own = np.concatenate([answer, np.gradient(answer, axis=1)], axis=2)  # other gain or delay
    own *= np.linspace(-1, 1, N)[:, None] if K == 1 else 1.0
    columns = own, _through(of_P, _last_move(u)), _powers(of_P, u, y, group.y)
    own, *shared = (_through(fit.denominator[:, None], z - z[:, :1]) for z in columns)  # A Z
    return _OfGroup(own.swapaxes(1, 2), contrasts(np.concatenate(shared, axis=2)))


def _powers(of_P, u, y, measured):
    """Make the columns of squares and cubes, which show a nonlinearity.

    The nonlinearity may act before the plant, behind the plant, or in a feedback. A nonlinear
    spring feeds back the output. The columns for a spring use the output that was measured one
    sample earlier, because the noise of the present sample is independent of that output.
    """
    earlier = np.pad(measured, [(0, 0), (1, 0), (0, 0)])[:, :-1]
    before = (_through(of_P, z**k) for z in (u, np.repeat(earlier, u.shape[2], 2)) for k in (2, 3))
    return np.concatenate([*before, y**2, y**3], axis=2)


def _through(g, z):
    """Filter signals by impulse responses.

    The signals have the shape (trial, time, column). The impulse responses have the shape
    (time, column), or (time, 1) if all columns have the same impulse response.
    """
    return fftconvolve(z, g[None], axes=1)[:, : z.shape[1]]


def _last_move(u):
    """Compute the sign of the last change of each input, minus an initial sign.

    The initial sign is opposite to the sign of the first change.
    """
    signs = np.sign(np.diff(u, axis=1, prepend=0))
    first = np.argmax(signs != 0, axis=1, keepdims=True)  # when the first move was
    signs[:, :1] = -np.take_along_axis(signs, first, 1)
    samples = np.arange(u.shape[1])[:, None]
    last = np.maximum.accumulate(np.where(signs, samples, 0), axis=1)  # when the last move was
    return np.take_along_axis(signs, last, 1) - signs[:, :1]


def _at_once(fit, level):
    """Whether y responds to a command within the same sample.

    This happens if the estimate shows -1 / C of the controller C instead of P.
    """
    layout, n = fit.data.layout, fit.data.n
    for j, g in enumerate(fit.impulse(2 * layout.lags)[: fit.commanded]):  # slow parts answer later
        lags = np.zeros((layout.size, 1))
        lags[layout.where(Kind.B, j)] = 1.0  # g at once is the sum of the increments
        # how much of y(t) u_j(t) explains, relative to r: g squared, by its variance
        explained = g[0] ** 2 / np.sum(fit.posterior.whitened(lags) ** 2) / fit.posterior.r
        share = g[0] / g.sum()
        most = HALF if explained > ALMOST_ALL else WHOLE
        if (share < 0 or share > most) and fdtrc(1, n, n * explained) < level:
            return True
    return False
