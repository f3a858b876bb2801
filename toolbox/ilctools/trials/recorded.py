"""What trials were: their commands, what was applied of v, and what a model makes of inputs."""

import control
import numpy as np
import xarray as xr

from ilctools.law.law import Law
from ilctools.law.limits import Actuators
from ilctools.law.notes import RESET
from ilctools.loop.closed import Loop
from ilctools.models import state_sequence


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


def applied_v(trials: xr.Dataset, law: Law) -> np.ndarray:
    """v (trial, time, m) as far as it was applied."""
    if not law.limits:
        return trials.v.values
    v, _ = law.applied(trials.v.values, **commands(trials, law.loop, law.actuators))
    return v


def successions(trials: xr.Dataset) -> np.ndarray:
    """Index of the first of the trials in succession that have each trial's reference.

    Without reset, not of the first: it is the only one that starts from rest.
    """
    changes = np.any(np.diff(trials.reference.values, axis=0), axis=(1, 2))
    changes[:1] |= RESET in trials.attrs
    first = np.arange(trials.sizes["trial"]) * np.append(True, changes)
    return np.maximum.accumulate(first)
