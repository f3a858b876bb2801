"""Do a loop, a law, a plant, a log or a rig fit together? Their periods, channels and units."""

from dataclasses import dataclass, field
from math import isclose


@dataclass(frozen=True)
class Signals:
    """Sampling period (s), names and units of the signals of something; None: not known."""

    Ts: float | None = None
    outputs: list[str] | None = None
    controls: list[str] | None = None
    units: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_log(cls, trials) -> "Signals":
        """Those of a log, or of what :func:`rodlib.run_trials` returns."""
        names, units = {}, {}
        for role in ("output", "control", "source"):
            names[role] = trials[role].values.tolist() if role in trials.coords else []
            if names[role]:
                labels = trials[f"{role}_unit"].values.tolist()
                units |= dict(zip(names[role], labels, strict=True))
        return cls(trials.attrs.get("Ts"), names["output"], names["control"], units)


def check_match(**parties) -> None:
    """Refuse parties that differ in sampling period, channels, their order, or units.

    Each keyword is what an error calls the party: a loop, a law, a filter, a rig, a model,
    :class:`Signals`, ... Of its attributes Ts, channels, outputs, controls and units those are
    compared that two parties have. An empty unit is not known, and fits all others.
    """
    properties = {
        "Ts": lambda party: getattr(party, "Ts", getattr(party, "dt", None)),
        "channels": _channels,
        "outputs": lambda party: getattr(party, "outputs", None),
        "controls": lambda party: getattr(party, "controls", None),
    }
    for name, value_of in properties.items():
        values = {whose: value_of(party) for whose, party in parties.items()}
        values = {whose: value for whose, value in values.items() if value is not None}
        first = next(iter(values.values()), None)
        if not all(_same(value, first) for value in values.values()):
            words = ", ".join(f"{whose}.{name} = {v}" for whose, v in values.items())
            raise ValueError(f"{words}: they must be the same, in the same order")
    units = {}
    for whose, party in parties.items():
        for signal, unit in getattr(party, "units", {}).items():
            first, other = units.setdefault(signal, (unit and whose, unit))
            if unit and other and unit != other:
                raise ValueError(
                    f"{first} has {signal} in {other!r}, but {whose} in {unit!r}"
                )
            if not other:
                units[signal] = whose, unit


def _channels(party):
    outputs = getattr(party, "outputs", None)
    return getattr(party, "channels", None if outputs is None else len(outputs))


def _same(one, other):
    if isinstance(one, float):
        return isclose(one, other, rel_tol=1e-12)
    return one == other
