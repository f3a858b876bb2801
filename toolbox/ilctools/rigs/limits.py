"""Limits beyond which an experiment stops."""

from ilctools import arguments
from ilctools.law.limits import UNLIMITED, named_limits
from ilctools.loop.closed import Loop
from ilctools.trials.start import largest_by_unit

# Times what an actuator spans, that commands may be beyond: a loop that works is not.
WIDE_COMMAND = 49.5
FAR_OUTPUT = 5.0  # times the largest reference that outputs may be beyond all references


def stop_limits(stop, reference, loop: Loop, followed) -> dict:
    """Limits of outputs and commands beyond which an experiment stops, by name.

    `stop` overrides those that follow from the reference (..., time, output), all outputs of a unit
    together, and from what the actuators follow; None stands for no limit.
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
