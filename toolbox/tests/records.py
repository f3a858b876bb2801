"""The regression of records, written out: every row of the regressors at once."""

import numpy as np
from scipy.signal import detrend

from ilctools.measurement import regression


def dense(groups, layout):
    """[X, y], without offset and slope, and which rows are of means."""
    rows, means = [], []
    for dynamics, others, y, mean in regression._regressors(groups, layout):
        columns = np.vstack([*(part(slice(None)) for part in dynamics), others, y]).T
        rows.append(detrend(columns[layout.skipped :], axis=0))
        means += [mean == 1] * len(rows[-1])
    return np.concatenate(rows), np.array(means)
