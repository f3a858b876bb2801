"""The scale of the channels: which sizes of signals count as equally large.

A singular value adds up channels that may have different units. Each output and each learned input
is therefore divided by its scale, the size that counts as one. Let S_y and S_v be the diagonal
matrices of the scales of the outputs and of the learned inputs. Then

    P in these units = S_y^-1 P S_v,    L = S_v (L in these units) S_y^-1.

If P is square, each v is added to the reference of an output, and has the unit of this output. If
no scale is stated for such an input, the input has the scale of this output.
"""

import reprlib
from typing import NamedTuple

import numpy as np

from ilctools import arguments


class Scale(NamedTuple):
    """The size that counts as one in each output and in each learned input."""

    y: np.ndarray  # (p,)
    v: np.ndarray  # (m,)

    @property
    def of_P(self) -> np.ndarray:
        """The factors on P in its own units that give P in scaled units, (p, m)."""
        return self.v / self.y[:, None]

    @property
    def is_one(self) -> bool:
        """Whether all scales are one, so that the units do not change."""
        return bool(np.all(self.y == 1) and np.all(self.v == 1))

    @property
    def inverse(self) -> "Scale":
        """The scale that converts scaled units back to the plant's own units."""
        return Scale(1 / self.y, 1 / self.v)


def scale_of(scale, outputs, inputs) -> Scale:
    """Check a scale that is given by name or by channel.

    By default, all scales are one.
    """
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
    """Make a scale from a dict by names.

    If P is square, the default for an input is the scale of its output. All other defaults are one.
    """
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
    """Check that scales are positive numbers."""
    arguments.representable("scale", units, "in other units")
    if units.min() <= 0:
        raise ValueError(f"scale = {units.tolist()} must be positive numbers")
    return units
