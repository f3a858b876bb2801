"""Is it one linear plant? Score tests of what a linear plant that stays as it is cannot do.

Of y = X x + Z delta + e, with x ~ N(0, s^2 D) and e ~ N(0, s^2 W^-1), the regression supposes
delta = 0. At its estimate x the score of delta and its information are, without fitting another,

    q = Z' W (y - X x),    J = Z' W Z - Z' W X (X' W X + D^-1)^-1 X' W Z,                       (1)
    F = (n - k) q' J^-1 q / (k (n s^2 - q' J^-1 q)),                                            (2)

and F of k columns has an F(k, n - k) distribution if delta = 0 (C. R. Rao, Proc. Cambridge Phil.
Soc. 44 (1948) 50-57). One set of columns Z after the other, each passed by A:

- of one trial only, or of one of four quarters of a single trial, the simulated output and its
  slope: another gain, another delay;
- the sign of the last move of each input, as the plant passes it on: of an input through backlash,
  u less half the gap times this sign comes out;
- squares and cubes of the inputs, likewise, and of the simulated output: a curve, a dead zone.

Signs and powers count by what no line in u explains: nothing, if u has two levels.

Without a reference in the record u may follow y: then residuals e(t) move later inputs. So u(t + 1)
to u(t + 16), not passed by A, is a fourth set (L. Ljung, System Identification, 1999, section
16.6). It is blind where u = -C y, and nothing else moves u: B / A = -1 / C leaves no residual, and
no test can distinguish this loop from a plant -1 / C. But plants in which something lags answer at
once by a part of what they answer in the end, a sampled one by nothing. So it is said as well where
u(t) explains y(t), by the same F (one column, which is left out), and the first coefficient of the
impulse response is not between 0 and 1.1 times their sum; from 0.5 on, where u(t) explains a
million times what is left: a proportional controller, or a plant without lags and almost without
noise. The share of P that is lost without u(t), 1 at most, is how far off P may be.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import helmert, solve_triangular
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from ilctools.measurement.regression import Regression, Trials, contrasts, convolved, records

QUARTERS = ("first", "second", "third", "last")  # of a single trial
FALSE_ALARM = 1e-3  # probability for each output
SEEN = 0.01  # of P: what is smaller is not said
LINEAR = 1e-6  # of a power: what a line in u leaves of it, and is nothing
LATER = (1, 2, 5, 17)  # samples, between which later inputs are added
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
    parts, m = len(names), groups[0].u.shape[2]
    score = _score(fit, groups, _added(fit, groups, parts))
    sets = {name: [k, parts + k] for k, name in enumerate(names)}
    ends = 2 * parts + np.cumsum([0, m, 2 * m + 2, len(LATER) * m - m])
    others = (PLAY, CURVED, FOLLOWS)[: 2 if reference else 3]
    sets |= {name: [*range(*ends[i : i + 2])] for i, name in enumerate(others)}
    level, simulated = FALSE_ALARM / len(sets), score.power[:parts, :parts].sum()
    for name, columns in sets.items():
        explained, certain = score.statistic(columns, fit)
        size = score.power[columns[0], columns[0]] if name in names else simulated
        off, inverse = np.sqrt(explained / max(size, 1e-300)), False
        if name == FOLLOWS:
            inverse, lost = _at_once(fit, m, level)
            off = min(max(off, lost), 1.0)
        if (certain < level or inverse) and off > SEEN:
            yield name, off


class _Score(NamedTuple):
    """(1), and what its columns have of power, Z' W Z."""

    q: np.ndarray
    J: np.ndarray
    power: np.ndarray

    def statistic(self, columns, fit):
        """What columns explain of n s^2, and how probably as much if delta = 0."""
        among, k, count = np.ix_(columns, columns), len(columns), fit.data.count.sum()
        unit = np.sqrt(np.maximum(self.power[among].diagonal(), 1e-300))
        inverse = np.linalg.pinv(self.J[among] / np.outer(unit, unit), 1e-9, hermitian=True)
        explained = self.q[columns] / unit @ inverse @ (self.q[columns] / unit)
        left = max(fit.posterior.rest - explained, 1e-12 * fit.posterior.rest)
        freedom = max(count - k, 1)
        return explained, fdtrc(k, freedom, freedom * explained / (k * left))  # (2)


def _score(fit, groups, added):
    power, q, across = 0.0, 0.0, 0.0
    for Z, (X, y, line, mean) in zip(added, records(groups, fit.data.layout), strict=True):
        Z = Z[-len(y) :]
        Z = Z - line @ (line.T @ Z)
        weight = fit.posterior.ratio if mean else 1.0
        power = power + weight * Z.T @ Z
        q = q + weight * Z.T @ (y - X @ fit.posterior.mean)
        across = across + weight * X.T @ Z
    explained = solve_triangular(fit.posterior.U, fit.posterior.size[:, None] * across, trans=1)
    return _Score(q, power - explained.T @ explained, power)  # (1)


def _at_once(fit, m, level):
    """Whether y answers at once as by -1 / C, and what P loses without u(t), of P."""
    size, U, n = fit.posterior.size, fit.posterior.U, 2 * fit.data.layout.knots[-1]
    count, g, x, inverse = fit.data.count.sum(), fit.impulse(n), fit.mean, False
    for j in range(m):
        first = solve_triangular(U, size * (fit.data.layout.kind == 1 + j), trans=1)
        gain, share = g[j, 0] / (first @ first), g[j, 0] / g[j].sum()
        x = x - gain * size * solve_triangular(U, first)
        explained = gain * g[j, 0] / fit.posterior.rest
        apart = not 0 < share < WHOLE or (share > HALF and explained > EXACT)
        inverse |= apart and fdtrc(1, count, count * explained) < level
    other = replace(fit, mean=x)
    lost = np.linalg.norm(other.impulse(n) - g) / np.linalg.norm(g) if other.stable else 1.0
    return inverse, min(lost, 1.0)


def _parts(group):
    """Names of the trials, or of the quarters of a single one."""
    if len(group.y) > 1:
        return group.names
    return [f"the {quarter} quarter of {group.names[0]}" for quarter in QUARTERS]


def _added(fit, groups, parts):
    """Z of each record, (time, column)."""
    first = 0
    for group in groups:
        K, N, _ = group.u.shape
        u = np.moveaxis(group.u, 2, 0)
        response = fit.impulse(N)[:, None] if fit.stable else np.zeros((len(u), 1, N))
        simulated = _passed(u, response).sum(axis=0)
        outputs = np.stack([simulated, np.gradient(simulated, axis=1)], axis=2)
        if K == 1:
            quarter = np.arange(N) * len(QUARTERS) // N
            outputs = outputs * (quarter == np.arange(len(QUARTERS))[:, None])[..., None]
        outputs = convolved(outputs - outputs[:, :1], fit.denominator)
        middle = simulated - simulated.mean()
        curves = _passed(_nonlinear(u), np.tile(response, (3, 1, 1)))
        curves = np.stack([*curves, middle**2, middle**3], axis=2)
        curves = convolved(curves - curves[:, :1], fit.denominator)
        shared = contrasts(np.concatenate([curves, *map(_later, u)], axis=2))
        alone, last = np.zeros((N, 2, parts)), first + len(outputs)
        for weights, Z in zip(helmert(K, full=True), shared, strict=True):
            alone[:, :, first:last] = np.moveaxis(weights[:, None, None] * outputs, 0, 2)
            yield np.hstack([alone.reshape(N, -1), Z])
        first = last


def _nonlinear(u):
    """Signs of the last moves, squares and cubes of u, less a line in it, (3 m, trial, time)."""
    moves = np.sign(np.diff(u, axis=2, prepend=0))
    since = np.maximum.accumulate(np.where(moves, np.arange(u.shape[2]), 0), axis=2)
    u = u - u.mean(axis=(1, 2), keepdims=True)
    signals = np.stack([np.take_along_axis(moves, since, 2), u**2, u**3])
    known = np.stack([np.ones_like(u), u], axis=-1).reshape(len(u), -1, 2)
    flat = signals.reshape(3, *known.shape[:2], 1)
    left = flat - known @ (np.linalg.pinv(known) @ flat)
    nothing = np.abs(left).max(axis=2) <= LINEAR * np.abs(flat).max(axis=2)
    return np.where(nothing[..., None], 0, left).reshape(-1, *u.shape[1:])


def _later(u):
    """Sums of u (trial, time) over ranges of later samples, (trial, time, range)."""
    N, total = u.shape[1], np.pad(u, ((0, 0), (1, LATER[-1])), mode="edge").cumsum(axis=1)
    sums = [total[:, b : b + N] - total[:, a : a + N] for a, b in pairwise(LATER)]
    return np.stack(sums, axis=2)


def _passed(u, response):
    """Inputs (m, trial, time) as each passes the plant."""
    return fftconvolve(u, response, axes=2)[..., : u.shape[2]]
