"""Signals of trials, and checks that a loop, a law, a plant, a log or a rig fit together.

The checks compare sampling periods, channels and units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isclose

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES

ASKED = "asked"  # the coordinate that says at which points the error counts
TRIAL_AXES = ("trial", "time", "channel")  # of outputs and controls
# Signals of trials, in their order in a log, and the role of their channels. If v is not added to
# the references, one for each output, the channels of v are inputs.
SIGNALS = {
    "reference": "output",
    "v": "output",
    "u": "control",
    "y": "output",
    "applied": "control",
    "delta": "control",
    "disturbance": "source",
    "measured": "sensor",
}


@dataclass(frozen=True)
class Signals:
    """Sampling period (s), names and units of signals.

    If a property is None, it is not known. Outputs, learned inputs and controls must be the same
    for any two parties that know them, see :func:`check_match`. Labels are the names of the signals
    of models. Two models may have different labels, but not the same labels in another order.
    """

    Ts: float | None = None
    outputs: list[str] | None = None
    controls: list[str] | None = None
    units: dict[str, str] = field(default_factory=dict)
    labels: list[str] | None = None
    learned: list[str] | None = None  # inputs that v drives, if v is not added to references

    @classmethod
    def of_log(cls, trials) -> "Signals":
        """Read the signals of a log, or of the result of :func:`ilctools.run_trials`."""
        names, units = {}, {}
        for role in ROLES:
            if role in trials.coords:
                names[role] = trials[role].values.tolist()
                labels = trials[f"{role}_unit"].values.tolist()
                units |= dict(zip(names[role], labels, strict=True))
        Ts = period_of(trials) if "Ts" in trials.attrs else None
        learned = names.get("input")
        return cls(Ts, names.get("output"), names.get("control"), units, learned=learned)

    @classmethod
    def of_plant(cls, plant, Ts: float) -> "Signals":
        """Read labels and units of a plant in any form.

        If the plant is an array, only the period Ts is known.
        """
        plant = getattr(plant, "loop", plant)  # of a measured response
        Ts, units = getattr(plant, "Ts", Ts), getattr(plant, "units", {})
        learned = None if getattr(plant, "one_for_one", True) else plant.learned
        return cls(Ts, units=units, labels=_labels_of(plant), learned=learned)

    def channels(self, p: int, m: int) -> tuple[list, list]:
        """Return the labels of p outputs and m inputs, or their numbers if they have no labels."""
        labels = self.labels or [*range(p), *range(m)]
        return labels[:p], labels[p:]


def period_of(trials) -> float:
    """Return the sampling period of trials, in seconds.

    If the times of the samples contradict this period, the trials are refused.
    """
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    if "time" in trials.coords:
        arguments.check_times("trials", trials.time.values, Ts)
    return Ts


def dataset(
    Ts: float,
    outputs: Sequence[str],
    controls: Sequence[str],
    sources: Sequence[str],
    units: Mapping[str, str],
    sensors: Sequence[str] = (),
    learned: Sequence[str] = (),
    **signals,
) -> xr.Dataset:
    """Make a dataset of trials from their signals, with coordinates and units.

    The signals have the shape (trial, time, channel). If the channels of v are not added one by one
    to the references, `learned` names the inputs to which these channels are added.
    """
    trials, samples, p = signals["y"].shape
    if "reference" in signals:
        signals["e"] = signals["reference"] - signals["y"]
    coordinates = {
        "trial": np.arange(1, trials + 1),
        "time": ("time", Ts * np.arange(samples), {"units": "s"}),
        "channel": np.arange(1, p + 1),
    }
    of_role = dict(zip(ROLES, (outputs, controls, sources, sensors, learned), strict=True))
    variables = {}
    for signal, role in (roles_of(bool(learned)) | {"e": "output"}).items():
        names = [*of_role[role]]
        if names and signal in signals:
            dimension = "channel" if role in ("output", "control") else role
            labels = [units.get(name, "") for name in names]
            coordinates |= {role: (dimension, names), f"{role}_unit": (dimension, labels)}
            attributes = {"units": ", ".join(dict.fromkeys(labels))}
            variables[signal] = ("trial", "time", dimension), signals[signal], attributes
    return xr.Dataset(variables, coordinates, {"Ts": float(Ts)})


def with_points(trials: xr.Dataset, points) -> xr.Dataset:
    """Mark the points of trials at which the error counts.

    The marks `points` have the shape (time, p). If `points` is None, the error counts everywhere.
    The coordinate `asked` holds the points. At all other points, the error is set to zero.
    """
    if points is None:
        return trials
    axes = trials.y.dims[-2:]
    trials = trials.assign_coords({ASKED: (axes, np.asarray(points))})
    return trials.assign(e=trials.e.where(trials[ASKED], 0.0)) if "e" in trials else trials


def points_of(trials: xr.Dataset) -> np.ndarray | None:
    """Return the points of trials at which the error counts, shape (time, p).

    If the error counts everywhere, None is returned.
    """
    return trials[ASKED].values if ASKED in trials.coords else None


def roles_of(of_inputs: bool) -> dict[str, str]:
    """Return the role of each signal's channels.

    If `of_inputs` is true, the channels of v are inputs.
    """
    return SIGNALS | {"v": "input"} if of_inputs else SIGNALS


def check_match(**parties) -> None:
    """Refuse objects that differ in sampling period, channels, order of channels, or units.

    The objects are called parties here. They are loops, laws, filters, rigs, models or
    :class:`Signals`. Each keyword is the name that error messages use for a party. Periods,
    channels, names and units are compared if two parties have them. An empty unit means that the
    unit is not known, and agrees with all other units.
    """
    compared = {}
    for whose, party in parties.items():
        for part, (value, words) in _parts(whose, party).items():
            first, first_words = compared.setdefault(part, (value, words))
            number = isinstance(value, float)  # a sampling period, which may be rounded
            if not (isclose(value, first, rel_tol=1e-12) if number else value == first):
                raise ValueError(
                    f"{first_words}, but {words}: they must be the same, in the same order"
                )


def _parts(whose, party):
    """Return each known property of a party, as a value and in words for an error message."""
    outputs, learned = getattr(party, "outputs", None), getattr(party, "learned", None)
    labels = _labels_of(party)
    values = {
        "Ts": getattr(party, "Ts", getattr(party, "dt", None)),
        "outputs": outputs,
        "learned": None if getattr(party, "one_for_one", False) else learned,
        "controls": getattr(party, "controls", None),
    }
    counts = {
        "outputs": getattr(party, "columns", None if outputs is None else len(outputs)),
        "learned inputs": getattr(party, "rows", None if learned is None else len(learned)),
    }
    parts = {
        ("number", what): (count, f"{whose} has {count} {what}")
        for what, count in counts.items()
        if count is not None
    }
    for name, value in values.items():
        if value is not None:
            parts[name] = value, f"{whose}.{name} = {value}"
    for place, label in enumerate(labels):
        parts.setdefault(("place", label), (place, f"{whose}.labels = {labels}"))
    for signal, unit in getattr(party, "units", {}).items():
        if unit:
            parts["unit", signal] = unit, f"{whose}.units[{signal!r}] = {unit!r}"
    return parts


def _labels_of(party):
    """Return the labels of the outputs, and then of the inputs, of a model or a loop."""
    if isinstance(party, Signals):
        return party.labels or []
    outputs = getattr(party, "output_labels", getattr(party, "outputs", None))
    inputs = getattr(party, "input_labels", getattr(party, "learned", None))
    return [*(outputs or ()), *(inputs or ())]
