"""The regression of records, written out: every row of the regressors at once."""

import numpy as np
from scipy.signal import detrend, lfilter

from ilctools.measurement.arx.regressors import regressors
from ilctools.measurement.arx.trials import Trials, series_of


def trials_of(trials, N=60, m=2, noise=0.1, seed=0):
    """A group of trials of a lag to each of m inputs."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((trials, N, m))
    y = sum(lfilter([0, j + 1.0], [1, -0.6], u[..., j]) for j in range(m))
    y = y + noise * rng.standard_normal((trials, N))
    return Trials(u=u, y=y[..., None], names=tuple(f"trial {k}" for k in range(trials)))


def dense(groups, layout):
    """[X, y], without offset and slope, and which rows are of means."""
    rows, means = [], []
    for series in series_of(groups):
        columns = np.vstack([regressors(series, layout), series.y]).T
        rows.append(detrend(columns[layout.skipped :], axis=0))
        means += [series.is_mean] * len(rows[-1])
    return np.concatenate(rows), np.array(means)
