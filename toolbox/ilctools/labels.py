"""Labelled arrays, of xarray and of pandas, are matched by name: here is the one rule.

An argument that has axes, such as P with (frequency, output, input), takes a labelled array, too.

- **Dimensions** decide which axis is which, wherever they stand: a DataArray with the dimensions
  (frequency, input, output) is transposed. Other names than those of the argument are refused.
  Dimensions that xarray itself has named (dim_0, dim_1, ...) stand in the order of the argument.
- **Names of channels** decide their order, if the plant, or the design, has names as well: a
  DataArray whose outputs are (T2, T1) is put in the order (T1, T2). Other names are refused.
  Where nobody else has names, those of the array stand as they are. Numbers only count channels.
- **Frequencies** are never put in another order: they must be those of `omega`, in rad/s. Where
  `omega` is left out, the frequencies of P, of Q or of the radius take its place.

Of a DataFrame the index is the first axis and the columns are the second one, unless their names
say otherwise; of a Series the index is the only axis. An index that pandas itself has numbered says
nothing. In signals of trials the channels stand last, after the time, see :mod:`.arguments`.
"""

import re
import reprlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

PLANT, FREQUENCY, OUTPUT, INPUT = "plant", "frequency", "output", "input"
CHANNEL = "channel"  # in the package's datasets the axis whose channels a coordinate names
OF_TRIALS = ("trial", "time")  # axes of their signals, before that of the channels
SAME = 1e-6  # relative distance of two frequencies that are the same: digits of a printed table
UNNAMED = re.compile(r"dim_\d+")  # of xarray
NUMBERED = re.compile(r"[uy]\[\d+\]")  # of python-control, where a model was given no names
RADIANS = {"", "rad/s", "rad s-1", "rad s^-1", "1/s", "s-1", "s^-1", "radian / second"}


class Axis(NamedTuple):
    """An axis of a labelled array."""

    dimension: str | None  # None: it has no name
    labels: np.ndarray | None  # of its entries; None: there are none
    unit: str = ""


def is_labelled(value) -> bool:
    """Whether a value is an array of xarray or pandas with axes."""
    of_xarray = hasattr(value, "dims") and hasattr(value, "coords")
    of_pandas = hasattr(value, "iloc") and hasattr(value, "index")
    return (of_xarray or of_pandas) and getattr(value, "ndim", 0) > 0  # a Dataset has none


def axes_of(value) -> list[Axis]:
    """The axes of a labelled array, in their order."""
    if hasattr(value, "dims"):
        return [_axis_of_xarray(value, dimension) for dimension in value.dims]
    return [_axis_of_pandas(index) for index in value.axes]


def _axis_of_xarray(value, dimension):
    """A dimension, with the coordinate that names its entries."""
    name = None if UNNAMED.fullmatch(str(dimension)) else dimension
    own = [key for key, c in value.coords.items() if c.dims == (dimension,)]
    if dimension not in own and dimension == CHANNEL and len(own) == 1:
        name = own[0]  # as `output` of the package's datasets
    if name not in own and dimension not in own:
        return Axis(name, None)
    coordinate = value.coords[name if name in own else dimension]
    return Axis(name, coordinate.values, str(coordinate.attrs.get("units", "")))


def _axis_of_pandas(index):
    """An index, or columns; that which pandas numbers by itself says nothing."""
    counted = index.name is None and index.dtype.kind in "iu"
    if counted and np.array_equal(index, np.arange(len(index))):
        return Axis(None, None)
    return Axis(index.name, index.to_numpy())


def matched(name: str, value, axes: Mapping[str, Sequence | None]):
    """The values of a labelled array with its axes, and the entries of each, in order of `axes`.

    `axes` has the labels of each axis as far as they are known: frequencies, rad/s, or names.
    What is not labelled, or has more or fewer axes, is returned as it is.
    """
    if not is_labelled(value):
        return value
    own = axes_of(value)
    if len(own) != len(axes):
        return np.asarray(value)
    order = _order_of_axes(name, own, [*axes])
    values = np.asarray(value).transpose(order)
    for place, (axis, known) in enumerate(axes.items()):
        labels, unit = own[order[place]].labels, own[order[place]].unit
        if axis == FREQUENCY:
            _refuse_other_frequencies(name, labels, known, unit)
        elif (entries := _order_of_channels(name, axis, labels, known)) is not None:
            values = np.take(values, entries, axis=place)
    return values


def _order_of_axes(name, own, wanted):
    """Where each axis that is wanted stands."""
    dimensions = [axis.dimension for axis in own]
    if len(own) == 1 and dimensions[0] == CHANNEL:
        dimensions = wanted
    given = [dimension for dimension in dimensions if dimension is not None]
    if not {*given} <= {*wanted} or len({*given}) < len(given):
        raise ValueError(
            f"{name} has the dimensions {_listed(given)}, but must have {_listed(wanted)}: "
            "rename them, or pass an array, whose axes stand in that order"
        )
    others = [axis for axis in wanted if axis not in given]
    filled = [others.pop(0) if d is None else d for d in dimensions]
    return [filled.index(axis) for axis in wanted]


def refuse_other_unit(name: str, unit: str):
    """Refuse frequencies that say that they are not in rad/s."""
    if unit not in RADIANS:
        raise ValueError(
            f"{name} has frequencies in {unit!r}, but they must be in rad/s: convert them (Hz times"
            " 2 pi), and their attribute `units`"
        )


def _refuse_other_frequencies(name, labels, omega, unit):
    """Refuse frequencies that are not those of omega, or in another unit."""
    refuse_other_unit(name, unit)
    if labels is None or omega is None:
        return
    labels, omega = frequencies_in(name, labels), np.asarray(omega, float)
    if len(labels) == len(omega) and np.allclose(labels, omega, rtol=SAME, atol=0):
        return
    raise ValueError(
        f"{name} is labelled with {len(labels)} frequencies from {labels[0]:.6g} to "
        f"{labels[-1]:.6g}, but omega has {len(omega)} from {omega[0]:.6g} to {omega[-1]:.6g} "
        "rad/s: they must be the same, in the same order. Leave omega out, or pass an array"
    )


def frequencies_in(name: str, labels) -> np.ndarray:
    """Labels of a frequency axis as numbers."""
    if labels.dtype.kind not in "iuf":
        raise ValueError(f"{name} has the frequencies {_listed(labels)}, but they must be numbers")
    return labels.astype(float)


def frequencies_of(name: str, value) -> np.ndarray | None:
    """The frequencies with which an array is labelled, rad/s; None if there are none."""
    if not is_labelled(value):
        return None
    own = axes_of(value)
    if len(own) == 1 and own[0].dimension is None:  # a Series, whose index has no name
        own = [own[0]._replace(dimension=FREQUENCY)]
    found = next((axis for axis in own if axis.dimension == FREQUENCY), None)
    if found is None or found.labels is None:
        return None
    refuse_other_unit(name, found.unit)
    return frequencies_in(name, found.labels)


def channels_of(value, axis: str) -> list[str] | None:
    """The names of the channels along an axis, in their order there; None if there are none."""
    if not is_labelled(value):
        return None
    own = axes_of(value)
    if len(own) == 1 and own[0].dimension in (None, CHANNEL):
        own = [own[0]._replace(dimension=axis)]
    found = next((each for each in own if each.dimension == axis), None)
    return None if found is None else _names(found.labels)


def by_channel(name: str, value, outputs, inputs=None):
    """A number for each channel, in the order of the plant's, labelled by outputs or by inputs."""
    axis = INPUT if is_labelled(value) and axes_of(value)[0].dimension == INPUT else OUTPUT
    known, own = (inputs if axis == INPUT else outputs), channels_of(value, axis)
    for names in (outputs, inputs):
        if own and names and sorted(own) == sorted(names):
            known = names
    return matched(name, value, {axis: known})


def _names(labels):
    """Labels that are names; None of numbers, which only count."""
    if labels is None or not all(isinstance(label, str) for label in labels.tolist()):
        return None
    return labels.tolist()


def _order_of_channels(name, axis, labels, known):
    """Where in an array each channel stands; None if it stands in order, or nobody says where."""
    if labels is None:
        return None
    own = _names(labels)
    if own is None:
        if labels.dtype.kind not in "iu" or len(np.unique(labels)) < len(labels):
            raise ValueError(
                f"{name} has the {axis}s {_listed(labels)}, but must have different names, or "
                "numbers that count them"
            )
        return np.argsort(labels)
    if known is None:
        return None
    if sorted(own) != sorted(known):
        raise ValueError(
            f"{name} has the {axis}s {_listed(own)}, but must have {_listed(known)}: rename them, "
            "or pass an array, whose channels stand in that order"
        )
    return [own.index(label) for label in known]


def _listed(labels):
    """Some labels in words."""
    return reprlib.repr([label.item() if hasattr(label, "item") else label for label in labels])


def paired(outputs, inputs):
    """Names of inputs in the order of the outputs, if they are the same: v adds to references."""
    if outputs and inputs and sorted(outputs) == sorted(inputs):
        return outputs
    return inputs


def given_names(names) -> list[str] | None:
    """Names that somebody has given, not those by which python-control numbers signals."""
    names = list(names or ())
    return None if not names or any(map(NUMBERED.fullmatch, names)) else names


def time_first(signal):
    """A DataArray of trials with its axes in order, trial, time, channel; others as they are."""
    dimensions = list(getattr(signal, "dims", ()))
    known = [dimension for dimension in OF_TRIALS if dimension in dimensions]
    if "time" not in dimensions or len(dimensions) - len(known) > 1:
        return signal
    return signal.transpose(*known, *(d for d in dimensions if d not in known))
