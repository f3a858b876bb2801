"""Is it one linear plant? Score tests of what a linear plant that stays as it is cannot do.

Of y = X x + Z delta + e, with x ~ N(0, s^2 D) and e ~ N(0, s^2 W^-1), the regression supposes
delta = 0. At its estimate x the score of delta and its information are, without fitting another,

    q = Z' W (y - X x),    J = Z' W Z - Z' W X (X' W X + D^-1)^-1 X' W Z,                       (1)
    F = q' J^-1 q / (k s^2),                                                                    (2)

and F of k columns has an F(k, n) distribution if delta = 0 and n is large (C. R. Rao, Proc.
Cambridge Phil. Soc. 44 (1948) 50-57). One set of columns Z after the other, each passed by A:

- of one trial only, or times the time in a single trial, the simulated output and its slope:
  another gain, another delay;
- the sign of the last move of each input, as the plant passes it on: of an input through backlash,
  u less half the gap times this sign comes out;
- squares and cubes of the inputs, likewise, and of the simulated output: a curve, a dead zone.

What one gain more of each input explains is taken off beforehand: the prior makes gains too small,
and of two levels squares and cubes are gains.

Without a reference in the record u may follow y: then residuals e(t) move later inputs. So
u(t + 1), u(t + 3), u(t + 9), not passed by A, are a fourth set (L. Ljung, System Identification,
1999, section 16.6). It is blind where u = -C y, and nothing else moves u: B / A = -1 / C leaves no
residual, and no test can distinguish this loop from a plant -1 / C. But plants in which something
lags answer at once by a part of what they answer in the end, a sampled one by nothing. So it is
said as well where u(t) explains y(t), by the same F, and the first coefficient of the impulse
response is not between 0 and 1.1 times their sum; from 0.5 on, where u(t) explains a million times
what is left: a proportional controller, or a plant without lags and almost without noise. How far
off P is cannot be known then: by all of it.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg import helmert, solve_triangular
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from ilctools.measurement.regression import Regression, Trials, contrasts, records

FALSE_ALARM = 1e-3  # probability for each output
SEEN = 0.02  # of P: what is smaller is not said
RANK = 1e-9  # of J, relative: columns that others explain but for this are nothing
LATER = (1, 3, 9)  # samples by which inputs are later
# Of the first coefficient of an impulse response to their sum: what plants do not have, and what
# they do not have where u(t) explains EXACT times the power that is left.
WHOLE, HALF, EXACT = 1.1, 0.5, 1e6
CURVED = "the response to large inputs differs from that to small ones"
PLAY = "the response differs after moves up and down, as with backlash"
FOLLOWS = (
    "u follows y, as in a loop whose reference is not in the log: what is estimated may be -1/C "
    "of its controller. Add the reference, or record with the loop open"
)


def contradictions(
    fit: Regression, groups: Sequence[Trials], reference: bool = True
) -> Iterator[tuple[str, float]]:
    """What contradicts one linear plant, in words, and by how much of P.

    `reference`: whether the reference is in the record, or else u may follow y.
    """
    names = [name for group in groups for name in _parts(group)]
    gains, sets = _sets(names, groups[0].u.shape[2], reference)
    q, J, power = _score(fit, groups, _added(fit, groups, len(names)))
    unit, level = np.sqrt(power.diagonal()), FALSE_ALARM / len(sets)

    def explained(columns):
        scores, among = (q / unit)[columns], np.ix_(columns, columns)
        return scores @ np.linalg.pinv((J / unit / unit[:, None])[among], RANK, True) @ scores

    count, by_gains = fit.data.count.sum(), explained(gains)
    for name, columns in sets:
        more, k = max(explained(gains + columns) - by_gains, 0), len(columns)
        within = columns[:1] if name in names else gains
        off = 1.0 if name == FOLLOWS else np.sqrt(more / power[np.ix_(within, within)].sum())
        certain = fdtrc(k, count, count * more / k / fit.posterior.rss) < level  # (2)
        if off > SEEN and (certain or (name == FOLLOWS and _at_once(fit, level))):
            yield name, off


def _sets(names, m, reference):
    """Columns of gains, and of each test."""
    parts = len(names)
    ends = m + 2 * parts + np.array([0, m, 3 * m + 2, (3 + len(LATER)) * m + 2])
    others = ([*range(a, b)] for a, b in pairwise(ends))
    sets = [(name, [m + k, m + parts + k]) for k, name in enumerate(names)]
    said = (PLAY, CURVED, FOLLOWS)[: 2 if reference else 3]
    return [*range(m)], [*sets, *zip(said, others, strict=False)]


def _score(fit, groups, added):
    """q and J, (1), and Z' W Z."""
    layout, mean = fit.data.layout, fit.posterior.mean
    power, q, across, p = 0.0, 0.0, 0.0, len(mean)
    gains = mean[:, None] * (layout.kind[:, None] == 1 + np.arange(groups[0].u.shape[2]))
    for columns, repeats in records(groups, layout, added):
        X, y, Z = columns[:, :p], columns[:, p], columns[:, p + 1 :]
        Z = np.hstack([X @ gains, Z])
        weight = fit.posterior.weight if repeats else 1.0
        power = power + weight * Z.T @ Z
        q = q + weight * Z.T @ (y - X @ mean)
        across = across + weight * X.T @ Z
    known = solve_triangular(fit.posterior.U, fit.posterior.size[:, None] * across, trans=1)
    return q, power - known.T @ known, power + 1e-300


def _at_once(fit, level):
    """Whether y answers an input at once, as by -1 / C."""
    (share, explained), n = _first(fit), fit.data.count.sum()
    odd = (share < 0) | (share > WHOLE) | (share > HALF) & (explained > EXACT)
    return np.any(odd & (fdtrc(1, n, n * explained) < level))


def _first(fit):
    """First coefficient of each impulse response: relative to their sum, and what it explains."""
    layout = fit.data.layout
    lags = (layout.c == 1)[:, None]  # slow parts answer later
    inputs = lags & (layout.kind[:, None] == 1 + np.arange(len(layout.knots) - 1))
    first = solve_triangular(fit.posterior.U, fit.posterior.size[:, None] * inputs, trans=1)
    g = fit.impulse(2 * layout.knots[0][-1])
    explained = g[:, 0] ** 2 / np.sum(first**2, axis=0) / fit.posterior.rss
    return g[:, 0] / g.sum(axis=1), explained


def _parts(group):
    """Names of the trials, or of the course of a single one."""
    return group.names if len(group.y) > 1 else [f"the course of {group.names[0]}"]


def _added(fit, groups, parts):
    """Z of each record, (time, column)."""
    first = 0
    for group in groups:
        alone, shared = _signals(fit, group)
        last, N = first + len(alone), alone.shape[1]
        columns = np.zeros((N, 2, parts))
        for weights, Z in zip(helmert(len(shared), full=True), contrasts(shared), strict=True):
            columns[..., first:last] = np.moveaxis(weights[:, None, None] * alone, 0, 2)
            yield np.hstack([columns.reshape(N, -1), Z])
        first = last


def _signals(fit, group):
    """Columns of one part each, (part, time, 2), and of all, (trial, time, column)."""
    K, N, m = group.u.shape
    response = fit.impulse(N) if fit.stable else np.zeros((m, N))
    bent = np.concatenate([group.u, _last_move(group.u), group.u**2, group.u**3], axis=2)
    passed = fftconvolve(bent, np.tile(response.T, 4)[None], axes=1)[:, :N]
    simulated, passed = passed[..., :m].sum(axis=2, keepdims=True), passed[..., m:]
    alone = np.concatenate([simulated, np.gradient(simulated, axis=1)], axis=2)
    if K == 1:
        alone = alone * np.linspace(-1, 1, N)[:, None]
    passed = np.concatenate([passed, simulated**2, simulated**3], axis=2)
    alone, passed = (
        fftconvolve(z - z[:, :1], fit.denominator[None, :, None], axes=1)[:, :N]
        for z in (alone, passed)
    )
    later = [group.u[:, np.minimum(np.arange(k, N + k), N - 1)] for k in LATER]
    return alone, np.concatenate([passed, *later], axis=2)


def _last_move(u):
    """Its sign, less that at the beginning, opposite to the first move, (trial, time, m)."""
    moves = np.sign(np.diff(u, axis=1, prepend=0))
    first = np.argmax(moves != 0, axis=1)[:, None]
    moves[:, :1] = -np.take_along_axis(moves, first, 1)
    last = np.maximum.accumulate(np.where(moves, np.arange(u.shape[1])[:, None], 0), axis=1)
    return np.take_along_axis(moves, last, 1) - moves[:, :1]
