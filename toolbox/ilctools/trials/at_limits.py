"""Warnings about limits of outputs: a limit was exceeded, or learning stands still at a limit."""

import numpy as np
import xarray as xr

from ilctools.law.law import Law
from ilctools.trials.learn import next_step
from ilctools.trials.parts import parts_of

STILL = 3  # learning stands still after so many successive trials,
LITTLE = 0.01  # each with this share of the law's own change or less,
WORTH_IT = 1.2  # if the law's own change would divide the error by more than this


def limits_not_kept(trials: xr.Dataset, law: Law, first: int) -> str:
    """Return a warning if an output was beyond its limit.

    The trial before trial `first` and all later trials are examined.
    """
    kept = law.output_limits
    if kept is None:
        return ""
    for k, y in enumerate(trials.y.values):
        distance = kept.distance(y)
        if k >= first - 2 and distance.min() < 0:
            name, number = kept.region.outputs[distance.argmin()], trials.trial.values[k]
            return (
                f"{name} was beyond its limit by {-distance.min():.3g} in trial {number}, and "
                f"the next trial steps back. From rest, {kept.safe_share(y):.2f} times the "
                "signal that drove this trial would have kept the limit. If this was trial 1, "
                "begin with a smaller share of the reference (pilot). Otherwise a disturbance "
                "came, or the plant is not linear, or is not within the radius"
            )
    return ""


def stands_still(trials: xr.Dataset, law: Law) -> str:
    """Return a warning if the last trials applied almost none of the law's change of v.

    The warning states the reason.
    """
    kept, parts = law.output_limits, parts_of(trials)[-STILL - 1 :]
    alike = all(np.array_equal(part["reference"], parts[0]["reference"]) for part in parts)
    if kept is None or law.L is None or len(parts) <= STILL or not alike:
        return ""
    v = [*map(law.applied_v, parts)]
    for k, part in enumerate(parts[:-1]):
        e = part["reference"] - part["y"]
        wanted = law.unlimited(v[k], e) - v[k]
        made = np.sum((v[k + 1] - v[k]) * wanted) > LITTLE * np.sum(wanted**2)
        after = e - kept.region.output(wanted)
        if made or np.linalg.norm(e) <= WORTH_IT * np.linalg.norm(after):
            return ""
    _, step = next_step(law, "law", parts[:-1])
    if step is None:
        return ""
    return (
        f"learning stands still at the limit of {kept.region.outputs[step.output]}, because "
        f"the error of the model may add {step.error:.3g}, and the room is {step.room:.3g}: "
        "keep the reference farther from the limit, or make the radius smaller, by a longer "
        "excitation"
    )
