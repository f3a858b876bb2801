"""Notes in the metadata of a log, as JSON: how they are read, and the loop.

The law is noted by :mod:`ilctools.law.io`, an excitation by
:mod:`ilctools.measurement.excitation`.
"""

import json
from collections.abc import Callable
from dataclasses import fields

import control
import xarray as xr

from ilctools.errors import reading
from ilctools.files import read_json
from ilctools.loop.closed import ClosedLoop, CurrentTrialLoop, Loop
from ilctools.signals import Signals, check_match

MATRICES = (*"ABCD", "dt")  # of a model, and its sampling period


def read_note(trials: xr.Dataset, key: str, read: Callable):
    """What `read` makes of the note `key` of a log; None if it is not there."""
    if key not in trials.attrs:
        return None
    with reading(key):
        return read(read_json(trials.attrs[key]))


def loop_of(trials: xr.Dataset) -> Loop | None:
    """The loop noted in the metadata of a log, to the last digit; None if it does not say.

    A LogError if the note cannot be understood, or is that of other signals or units.
    """

    def read(note):
        kind, plant = (CurrentTrialLoop, "plant") if "plant" in note else (ClosedLoop, "P")
        loop = kind(**note | {plant: model_from(note[plant])})
        check_match(loop=loop, log=Signals.of_log(trials))
        return loop

    return read_note(trials, "loop", read)


def loop_note(loop: Loop) -> str:
    """A loop as JSON, to the last digit."""
    parts = {part.name: getattr(loop, part.name) for part in fields(loop)}
    return json.dumps(parts, ensure_ascii=False, default=_plain)


def _plain(part):
    """An array or a model of a loop as what JSON can hold."""
    if not isinstance(part, control.StateSpace):
        return part.tolist()
    values = {name: getattr(part, name) for name in MATRICES}
    return values | {"inputs": part.input_labels, "outputs": part.output_labels}


def model_from(note):
    """A model that :func:`loop_note` noted."""
    if note is None:
        return None
    values = (note[name] for name in MATRICES)
    return control.ss(*values, inputs=note["inputs"], outputs=note["outputs"])
