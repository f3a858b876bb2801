"""Do a loop, a law, a plant, a log or a rig fit together? Their periods, channels and units."""

from dataclasses import dataclass, field
from itertools import combinations
from math import isclose

import numpy as np

from ilctools import arguments

LATE = 1e-3  # of Ts, by which rounding may move a sample


@dataclass(frozen=True)
class Signals:
    """Sampling period (s), names and units of the signals of something; None: not known.

    Outputs and controls are the same wherever they are known. Labels are those of models: two
    may have other ones, but not the same ones in another order.
    """

    Ts: float | None = None
    outputs: list[str] | None = None
    controls: list[str] | None = None
    units: dict[str, str] = field(default_factory=dict)
    labels: list[str] | None = None

    @classmethod
    def of_log(cls, trials) -> "Signals":
        """Those of a log, or of what :func:`ilctools.run_trials` returns."""
        names, units = {}, {}
        for role in ("output", "control", "source"):
            if role in trials.coords:
                names[role] = trials[role].values.tolist()
                labels = trials[f"{role}_unit"].values.tolist()
                units |= dict(zip(names[role], labels, strict=True))
        Ts = period_of(trials) if "Ts" in trials.attrs else None
        return cls(Ts, names.get("output"), names.get("control"), units)

    @classmethod
    def of_plant(cls, plant) -> "Signals":
        """Labels and units of a plant in any form; an array has none."""
        plant = getattr(plant, "loop", plant)  # of a measured response
        return cls(units=getattr(plant, "units", {}), labels=_labels_of(plant))


def period_of(trials) -> float:
    """Sampling period of trials, s, which their time must not contradict."""
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    steps = np.diff(trials.time.values) if "time" in trials.coords else np.empty(0)
    if not np.allclose(steps, Ts, rtol=0, atol=LATE * Ts):
        raise ValueError(
            f"trials.time has steps from {steps.min():.6g} to {steps.max():.6g} s, but "
            f"trials.attrs['Ts'] is {Ts:.6g} s: correct the one that is wrong"
        )
    return Ts


def check_match(**parties) -> None:
    """Refuse parties that differ in sampling period, channels, their order, or units.

    Each keyword is what an error calls the party: a loop, a law, a filter, a rig, a model,
    :class:`Signals`, ... Of their periods, channels, names and units those are compared that two
    parties have. An empty unit is not known, and fits all others.
    """
    properties = {  # how each is read, and compared
        "Ts": (_period_of, _same),
        "channels": (_channels_of, _same),
        "outputs": (lambda party: getattr(party, "outputs", None), _same),
        "controls": (lambda party: getattr(party, "controls", None), _same),
        "labels": (_labels_of, _aligned),
    }
    for name, (value_of, fit) in properties.items():
        values = {whose: value_of(party) for whose, party in parties.items()}
        values = {whose: value for whose, value in values.items() if value is not None}
        distinct = []  # of thousands of plants nearly all have the same
        for value in values.values():
            if value not in distinct:
                distinct.append(value)
        if not all(fit(one, other) for one, other in combinations(distinct, 2)):
            words = ", ".join(f"{whose}.{name} = {v}" for whose, v in values.items())
            raise ValueError(f"{words}: they must be the same, in the same order")
    units = {}
    for whose, party in parties.items():
        for signal, unit in getattr(party, "units", {}).items():
            first, other = units.setdefault(signal, (unit and whose, unit))
            if unit and other and unit != other:
                raise ValueError(f"{first} has {signal} in {other!r}, but {whose} in {unit!r}")
            if not other:
                units[signal] = whose, unit


def _period_of(party):
    return getattr(party, "Ts", getattr(party, "dt", None))


def _channels_of(party):
    outputs = getattr(party, "outputs", None)
    return getattr(party, "channels", None if outputs is None else len(outputs))


def _labels_of(party):
    """Of a model or a loop, the outputs', then the inputs'."""
    if isinstance(party, Signals):
        return party.labels
    outputs = getattr(party, "output_labels", getattr(party, "outputs", None))
    inputs = getattr(party, "input_labels", getattr(party, "references", None))
    return [*(outputs or ()), *(inputs or ())]


def _same(one, other):
    if isinstance(one, float):
        return isclose(one, other, rel_tol=1e-12)
    return one == other


def _aligned(one, other):
    """Whether each name that stands in both lists has the same place."""
    return all(one.index(name) == other.index(name) for name in {*one} & {*other})
