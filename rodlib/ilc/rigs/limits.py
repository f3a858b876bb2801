"""Commands that actuators do not follow, and limits beyond which an experiment stops."""

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.law.limits import named_limits
from rodlib.ilc.units import by_unit

FAR = 5.0  # times the largest reference that outputs may be beyond all references
WIDE = 100.0  # times what an actuator follows, that commands may span: no loop that works does


def stop_limits(stop, reference, loop, followed) -> dict:
    """Limits of outputs and commands beyond which an experiment stops, by name.

    `stop` overrides those that follow from the reference (..., time, output), all outputs of a unit
    together, and from what the actuators follow; None stands for no limit.
    """
    outputs, commands, limits = loop.outputs, loop.commands, {}
    for channels in by_unit([loop.units[name] for name in outputs]).values():
        largest = np.abs(reference[..., channels]).max()
        for i in channels if largest else ():
            low, high = reference[..., i].min(), reference[..., i].max()
            limits[outputs[i]] = float(low - FAR * largest), float(high + FAR * largest)
    for name, (low, high, *_) in followed.items():
        middle, half = (low + high) / 2, (high - low) / 2
        if name in commands:
            limits[name] = middle - WIDE * half, middle + WIDE * half
    names = [*outputs, *commands]
    asked = arguments.by_name("stop", stop, names)
    own = named_limits(
        "stop", {n: pair for n, pair in asked.items() if pair is not None}, names
    )
    return {
        n: pair for n, pair in (limits | own).items() if asked.get(n, pair) is not None
    }
