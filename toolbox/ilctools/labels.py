"""Labelled arrays of xarray and pandas: find axes by name, and refuse contradictory labels.

If an argument has axes, such as P with the axes (frequency, output, input), a labelled array may be
passed. Its labels are used as follows.

- **Dimensions** decide which axis is which: a DataArray with the dimensions (frequency, input,
  output) is transposed. Other names of dimensions are refused. If no dimension has a name, the axes
  must have the order that the argument prescribes.
- **Frequencies** must be the values of `omega`, in rad/s and in the same order. If `omega` is left
  out, the frequencies of P, of Q or of the radius take its place.
- **Names of channels** are compared like the names of a model. If a plant has the same names as
  another plant, or as the design, but in another order, the plant is refused. If the inputs have
  the names of the outputs, they are put in the order of the outputs. If a scale has names, it is
  put in the order of the outputs of P, see :func:`.arguments.by_channel`.

If an index has whole numbers and no name, it only numbers the entries, and is ignored.
"""

import re

import control
import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments

PLANT, FREQUENCY, OUTPUT, INPUT = "plant", "frequency", "output", "input"
UNNAMED = re.compile(r"dim_\d+")  # names that xarray gives to dimensions without a name


def is_labelled(value) -> bool:
    """Whether a value is an array of xarray or pandas that has axes."""
    return isinstance(value, xr.DataArray | pd.Series | pd.DataFrame) and value.ndim > 0


def with_axes(name: str, value, axes):
    """Return a labelled array with its axes in the order of `axes`.

    Other values are returned unchanged.
    """
    if not is_labelled(value):
        return value
    array = xr.DataArray(value)
    if array.ndim == len(axes) and all(UNNAMED.fullmatch(str(own)) for own in array.dims):
        counts = [own for own in array.dims if array.get_index(own).dtype.kind in "iu"]
        array = array.drop_vars(counts, errors="ignore")
        array = array.rename(dict(zip(array.dims, axes, strict=True)))
    if {*array.dims} != {*axes}:
        raise ValueError(
            f"{name} has the dimensions {[*array.dims]}, but must have {[*axes]}: rename them, "
            "or pass an array whose axes are in that order"
        )
    return array.transpose(*axes)


def on(name: str, value, omega, axes=(FREQUENCY,)):
    """Return an array with its axes in the order of `axes`, and its frequencies.

    An array whose frequencies differ from omega is refused. If omega is None, any frequencies are
    accepted. If the array has no frequencies, omega itself is returned, which may be None.
    """
    array = with_axes(name, value, axes)
    if not is_labelled(array) or FREQUENCY not in array.coords:
        return array, omega
    own = in_radians(f"{name}.frequency", array[FREQUENCY])
    if omega is None:
        return array, own
    if len(own) != len(omega) or not np.allclose(own, omega, rtol=arguments.LATE, atol=0):
        raise ValueError(
            f"{name} is labelled with {len(own)} frequencies from {own[0]:.6g} to "
            f"{own[-1]:.6g} rad/s, but omega has {len(omega)} from {omega[0]:.6g} to "
            f"{omega[-1]:.6g} rad/s: they must be the same, in the same order. Leave omega "
            "out, or pass an array without labels"
        )
    return array, omega


def in_radians(name: str, omega) -> np.ndarray:
    """Check frequencies in rad/s; refuse frequencies whose unit is Hz."""
    if "Hz" in (unit := str(getattr(omega, "attrs", {}).get("units"))):
        raise ValueError(
            f"{name} is in {unit!r}, but must be in rad/s: convert it, and correct its "
            "attribute `units`"
        )
    return arguments.array(name, omega, (FREQUENCY,))


def table_of(name: str, P, omega):
    """Convert a labelled P to python-control's response data.

    The frequencies are checked as in `on`.
    """
    array, omega = on(name, P, omega, (FREQUENCY, OUTPUT, INPUT))
    if not is_labelled(array) or omega is None:
        return array, omega
    outputs, inputs = (_channels(name, array, axis) for axis in (OUTPUT, INPUT))
    if outputs and inputs and {*outputs} == {*inputs}:  # v adds to the references of the outputs
        array = array.isel({INPUT: [inputs.index(output) for output in outputs]})
        inputs = outputs
    values = arguments.array(name, array, (len(omega), "outputs", "inputs"), complex)
    values = np.moveaxis(values, 0, -1)
    return control.frd(values, omega, True, outputs=outputs, inputs=inputs), omega


def _channels(name, array, axis):
    """Return the names of the channels along an axis; None if the channels have no names."""
    if axis not in array.coords:
        return None
    return arguments.different(f"{name}.{axis}", [str(label) for label in array[axis].values])
