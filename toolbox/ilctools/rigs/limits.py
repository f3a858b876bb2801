"""Limits beyond which an experiment stops."""

from ilctools import arguments
from ilctools.law.limits import UNLIMITED, named_limits
from ilctools.loop.closed import Loop
from ilctools.trials.start import largest_by_unit

# Commands may be beyond the limits of an actuator by this many times its range. The commands of a
# working loop stay far below.
WIDE_COMMAND = 49.5
# Outputs may be beyond all references by this many times the largest reference.
FAR_OUTPUT = 5.0


def stop_limits(stop, reference, loop: Loop, followed) -> dict:
    """Compute limits of outputs and commands beyond which an experiment stops, by name.

    The limits of outputs follow from the reference (..., time, output), for all outputs with the
    same unit together. The limits of commands follow from the limits `followed` of the actuators.
    Limits in `stop` replace the computed limits. None stands for no limit.
    """
    limits = {}
    values = reference.reshape(-1, len(loop.outputs))
    largest = largest_by_unit(values, loop)
    for name, column, size in zip(loop.outputs, values.T, largest, strict=True):
        if size:
            limits[name] = column.min() - FAR_OUTPUT * size, column.max() + FAR_OUTPUT * size
    for name, (low, high) in followed.items():
        beyond = WIDE_COMMAND * (high - low)
        limits[name] = low - beyond, high + beyond
    names = [*loop.outputs, *loop.commands]
    asked = arguments.by_name("stop", stop, names)
    stated = {name: pair for name, pair in asked.items() if pair is not None}
    return limits | dict.fromkeys(asked, UNLIMITED) | named_limits("stop", stated, names)
