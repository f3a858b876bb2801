"""Split recorded trials into parts: each trial, or all samples from one rest to the next."""

import numpy as np
import xarray as xr

from ilctools.law.notes import RESET
from ilctools.signals import SIGNALS
from ilctools.trials.learn import Part, joined


def parts_of(trials: xr.Dataset) -> list[Part]:
    """Return the signals of each trial."""
    names = [name for name in SIGNALS if name in trials]
    return [{name: trials[name].values[k] for name in names} for k in range(len(trials.trial))]


def from_rest_to_rest(trials: xr.Dataset) -> list[Part]:
    """Return the signals from one rest to the next: each trial, or all joined without reset."""
    parts = parts_of(trials)
    return [joined(parts)] if RESET in trials.attrs else parts


def successions(trials: xr.Dataset) -> np.ndarray:
    """Return, for each trial, the index of the trial with which its reference began.

    Trials with one reference are a succession. Without reset, the first trial is a succession by
    itself, because only the first trial starts from rest.
    """
    changes = np.any(np.diff(trials.reference.values, axis=0), axis=(1, 2))
    changes[:1] |= RESET in trials.attrs
    first = np.arange(trials.sizes["trial"]) * np.append(True, changes)
    return np.maximum.accumulate(first)
