"""What follows from the signals of trials: their RMS, commands, and outputs of a model."""

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.law.limits import Actuators
from ilctools.law.notes import RESET
from ilctools.loop.closed import Loop
from ilctools.models import state_sequence


def rms(e: xr.DataArray | xr.Dataset) -> xr.DataArray:
    """RMS(e_k) of Section IV: root of the mean over time of e'e, summed over the channels.

    `e` is a DataArray with the dimensions time and channel, or a dataset of trials or a log with
    reference and y, whose error it is; anything else, or a gap in it, raises a ValueError.

    See Also
    --------
    run_trials : trials with an error e

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from ilctools import rms
    >>> e = xr.DataArray(np.ones((2, 9, 2)), dims=("trial", "time", "channel"))
    >>> rms(e).values.round(4)
    array([1.4142, 1.4142])
    """
    if isinstance(e, xr.Dataset):
        if not {"reference", "y"} <= set(e):
            raise ValueError(f"e has no reference and y, but {[*e]}: pass one of them, as e.y")
        e = e.reference - e.y
    arguments.instance("e", e, xr.DataArray)
    if not {"time", "channel"} <= set(e.dims):
        raise ValueError(f"e has dimensions {e.dims}, but must have 'time' and 'channel'")
    arguments.array("e", e.values, (...,))
    return rms_of(e)


def rms_of(e: xr.DataArray) -> xr.DataArray:
    """RMS(e_k), also of what is not finite."""
    return np.sqrt((e**2).sum("channel").mean("time"))


def commands(
    trials: xr.Dataset, loop: Loop, actuators: Actuators | None = None
) -> dict[str, np.ndarray]:
    """What was asked of the actuators, u, and what was applied, shape (trial, time, m)."""
    recorded = trials.u.values if "u" in trials else None
    u = applied = loop.asked((trials.reference + trials.v).values, recorded)
    if "applied" in trials:
        applied = trials.applied.values
    elif actuators is not None:
        applied = actuators.follow(runs(u, trials)).reshape(u.shape)
    return {"u": u, "applied": applied}


def runs(signals, trials: xr.Dataset) -> np.ndarray:
    """Signals (trial, time, m) of trials; without reset, as of one trial."""
    return np.concatenate(signals)[None] if RESET in trials.attrs else signals


def outputs_of(model: control.StateSpace, inputs, trials: xr.Dataset) -> np.ndarray:
    """Outputs of a model from rest, before each trial of inputs (trial, time, m) or the first."""
    rest, outputs = np.zeros(model.nstates), []
    for run in runs(inputs, trials):
        x = state_sequence(model.A, run @ model.B.T, rest)
        outputs.append(x @ model.C.T + run @ model.D.T)
    return np.reshape(outputs, (*inputs.shape[:2], -1))
