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
    values = np.array(reference, dtype=float) if _may_hold_numbers(reference) else np.zeros(0)
    absent = np.isnan(values)
    if not absent.any():
        return reference, None
    columns = values if values.ndim > 1 else values[:, None]
    flat = np.moveaxis(columns, -2, -1).reshape(-1, columns.shape[-2])  # a row for each signal
    time = np.arange(flat.shape[1])
    for row in flat:
        if np.isnan(row[0]):
            raise ValueError(
                "reference begins with NaN, but must state where each output is when a trial "
                "begins: give its first sample a number"
            )
        there = ~np.isnan(row)
        row[:] = np.interp(time, time[there], row[there])
    shape = *columns.shape[:-2], columns.shape[-1], columns.shape[-2]
    values = np.moveaxis(flat.reshape(shape), -1, -2).reshape(values.shape)
    return _like(reference, values), _like(reference, (~absent).astype(float))


def _may_hold_numbers(reference):
    try:
        np.asarray(reference, dtype=float)
    except (TypeError, ValueError):  # the check of references refuses this with a message
        return False
    return np.ndim(reference) > 0


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
