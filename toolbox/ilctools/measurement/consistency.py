"""Is it one linear plant? Score tests of what a linear plant that stays as it is cannot do.

To the regression are added, one set after the other: the simulated output and its derivative in one
trial only, or in one of four quarters of a single trial; and squares and cubes of the inputs, as
the plant passes them on, and of the simulated output. Each has an F statistic, of what it explains
of the residual, given all that the regression itself may explain.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from ilctools.measurement.regression import Regression, Trials, contrasts, convolved, records

QUARTERS = ("first", "second", "third", "last")  # of a single trial
FALSE_ALARM = 1e-3  # probability for each output
SEEN = 0.01  # of P: what is smaller is not said
CURVED = "the response to large inputs differs from that to small ones"


def contradictions(fit: Regression, groups: Sequence[Trials]) -> Iterator[tuple[str, float]]:
    """What contradicts one linear plant, in words, and by how much of P."""
    names = [name for group in groups for name in _parts(group)]
    parts, inverse_of = len(names), fit.posterior.size[:, None]
    products, scores, across, first = 0.0, 0.0, 0.0, 0
    regressors = records(groups, fit.data.layout)
    for group in groups:
        added = contrasts(_alternatives(fit, group, first, parts))
        added = convolved(added, fit.denominator)
        first += len(_parts(group))
        for Z, (X, y, line, mean) in zip(added, regressors, strict=False):
            Z = Z[-len(y) :]
            Z = Z - line @ (line.T @ Z)
            weight = fit.posterior.ratio if mean else 1.0
            products = products + weight * Z.T @ Z
            scores = scores + weight * Z.T @ (y - X @ fit.posterior.mean)
            across = across + weight * X.T @ Z
    explained = solve_triangular(fit.posterior.U, across * inverse_of, trans=1)
    left = products - explained.T @ explained
    count = fit.data.count.sum()
    sets = [(name, [k, parts + k]) for k, name in enumerate(names)]
    sets.append((CURVED, [*range(2 * parts, len(scores))]))
    for name, columns in sets:
        among = np.ix_(columns, columns)
        unit = np.sqrt(np.maximum(products[among].diagonal(), 1e-300))
        inverse = np.linalg.pinv(left[among] / np.outer(unit, unit), 1e-9, hermitian=True)
        explained = scores[columns] / unit @ inverse @ (scores[columns] / unit)
        statistic = explained / len(columns) * count / fit.posterior.rest
        if fdtrc(len(columns), count, statistic) * len(sets) > FALSE_ALARM:
            continue
        where = np.s_[:parts, :parts] if name == CURVED else (columns[0], columns[0])
        off = np.sqrt(explained / products[where].sum())
        if off > SEEN:
            yield name, off


def _parts(group):
    """Names of the trials, or of the quarters of a single one."""
    if len(group.y) > 1:
        return group.names
    return [f"the {quarter} quarter of {group.names[0]}" for quarter in QUARTERS]


def _alternatives(fit, group, first, parts):
    """Simulated outputs in each part, their slopes, and powers, (trial, time, column)."""
    K, N, _ = group.u.shape
    u, response = np.moveaxis(group.u, 2, 0), fit.impulse(N)[:, None]
    simulated = _passed(u, response).sum(axis=0)
    outputs = np.stack([simulated, np.gradient(simulated, axis=1)], axis=2)
    rows = np.repeat(np.arange(K), N)
    if K == 1:
        rows = np.arange(N) * len(QUARTERS) // N
    inside = (rows[:, None] == np.arange(-first, parts - first)).reshape(K, N, parts)
    alone = [inside * signal[..., None] for signal in np.moveaxis(outputs, 2, 0)]
    u, middle = u - u.mean(axis=(1, 2), keepdims=True), simulated - simulated.mean()
    powers = [*_passed(u**2, response), *_passed(u**3, response), middle**2, middle**3]
    columns = np.concatenate([*alone, np.stack(powers, axis=2)], axis=2)
    return columns - columns[:, :1]


def _passed(u, response):
    """Inputs (m, trial, time) as each passes the plant."""
    return fftconvolve(u, response, axes=2)[..., : u.shape[2]]
