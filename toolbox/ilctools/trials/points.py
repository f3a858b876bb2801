"""References that are given at some samples only; NaN stands for no reference."""

from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr

from ilctools.law.law import Law
from ilctools.norm_optimal import NormOptimal


def filled(reference):
    """Replace NaN in a reference by numbers, and mark where numbers were given.

    The reference has the shape (..., time, p). Points are the samples with numbers. Between points,
    the reference follows straight lines, and is constant after the last point. A loop whose v is
    added to the reference is driven by these numbers. Labels are kept. The function returns the
    reference with numbers everywhere, and a mark. The mark is one where a number was given, and
    zero elsewhere. A reference without NaN is returned unchanged, with None as mark.
    """
    try:
        values = np.asarray(reference, dtype=float)
    except (TypeError, ValueError):  # the check of references refuses this with a message
        return reference, None
    given = ~np.isnan(values)
    if given.all() or values.ndim == 0:
        return reference, None
    time_axis = 0 if values.ndim == 1 else -2
    if not given.take(0, time_axis).all():
        raise ValueError(
            "reference begins with NaN, but must state where each output is when a trial "
            "begins: give its first sample a number"
        )
    lines = np.apply_along_axis(_between_points, time_axis, values)
    return _like(reference, lines), _like(reference, given.astype(float))


def _between_points(signal):
    """Replace NaN in a signal (time,) by values on straight lines."""
    time, given = np.arange(len(signal)), ~np.isnan(signal)
    return np.interp(time, time[given], signal[given])


def _like(labelled, values):
    """Give values the labels of a signal."""
    if isinstance(labelled, pd.DataFrame):
        return pd.DataFrame(values, labelled.index, labelled.columns)
    return labelled.copy(data=values) if isinstance(labelled, xr.DataArray) else values


def one_mask(asked) -> np.ndarray:
    """Return the samples with a reference, shape (time, p).

    The argument has the shape (trial, time, p). All trials must have a reference at the same
    samples.
    """
    if np.any(asked != asked[0]):
        raise ValueError("reference must have NaN at the same samples of all trials")
    return asked[0] > 0


def asking(law: Law, asked: np.ndarray) -> Law:
    """Return the law with an L that learns only from the samples in `asked`.

    The argument `asked` has the shape (time, p).
    """
    if law.L is None:
        return law
    if not isinstance(law.L, NormOptimal):
        raise ValueError(
            f"reference has NaN at {np.mean(~asked):.0%} of the samples, where no output is "
            "prescribed, but L learns from all samples: take L = NormOptimal(P, weight, "
            "samples)"
        )
    errors = asked if law.L.errors is None else law.L.errors * asked
    return replace(law, L=replace(law.L, errors=errors))
