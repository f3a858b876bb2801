"""What counts as equally large in each channel: the units in which singular values are compared.

With S_y and S_v for diagonal matrices of the scale of each output and of each learned input,

    P in these units = S_y^-1 P S_v,    L = S_v (L in these units) S_y^-1.

Where v is added to the reference of an output, the input has the unit of that output, and so its
scale, if it has none of its own.
"""

import reprlib
from typing import NamedTuple

import numpy as np

from ilctools import arguments


class Scale(NamedTuple):
    """What counts as equally large in each output and in each learned input."""

    y: np.ndarray  # (p,)
    v: np.ndarray  # (m,)

    @property
    def of_P(self) -> np.ndarray:
        """The factors that turn P in its own units into P in these units, (p, m)."""
        return self.v / self.y[:, None]

    @property
    def is_one(self) -> bool:
        """Whether all scales are one, so that the scale changes nothing."""
        return bool(np.all(self.y == 1) and np.all(self.v == 1))

    @property
    def inverse(self) -> "Scale":
        """The scale that undoes this one."""
        return Scale(1 / self.y, 1 / self.v)


def scale_of(scale, outputs, inputs) -> Scale:
    """Check a scale of outputs and learned inputs, by name or by channel; the default is one."""
    p, m = len(outputs), len(inputs)
    if isinstance(scale, Scale):
        return scale
    if scale is None:
        return Scale(np.ones(p), np.ones(m))
    if isinstance(scale, dict):
        return _by_name(scale, outputs, inputs)
    if p != m:
        raise ValueError(
            f"scale = {reprlib.repr(scale)} must be a dict by the names of outputs, {outputs}, "
            f"and of learned inputs, {inputs}, because their numbers differ"
        )
    scale = arguments.by_channel("scale", scale, outputs)
    units = _positive(arguments.array("scale", scale, (m,)))
    return Scale(units, units)


def _by_name(scale, outputs, inputs):
    """A scale by names; an input of a square plant defaults to the scale of its output."""
    arguments.by_name("scale", scale, [*outputs, *inputs])
    sizes = {
        name: arguments.number(f"scale[{name!r}]", size, "a positive number")
        for name, size in scale.items()
    }
    y = np.array([sizes.get(name, 1.0) for name in outputs])
    own = y if len(outputs) == len(inputs) else np.ones(len(inputs))
    v = np.array([sizes.get(name, size) for name, size in zip(inputs, own, strict=True)])
    return Scale(_positive(y), _positive(v))


def _positive(units):
    """Check units, which must be positive numbers."""
    arguments.representable("scale", units, "in other units")
    if units.min() <= 0:
        raise ValueError(f"scale = {units.tolist()} must be positive numbers")
    return units
