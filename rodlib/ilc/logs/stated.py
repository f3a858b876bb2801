"""What the metadata of a log state: signals, their units, and the sampling period."""

import difflib

from rodlib.ilc import arguments, units
from rodlib.ilc.files import read_json
from rodlib.ilc.logs.tables import NUMBER, few

SIGNALS = {  # and what the channels of each are; u only if the commands are known
    "reference": "output", "v": "output", "u": "control", "y": "output", "applied": "control",
    "delta": "control", "disturbance": "source", "measured": "sensor",
}  # fmt: skip
OPTIONAL = (
    ("reference", "v"),
    ("applied",),
    ("delta",),
)  # which a log has together, or not at all
ROLES = {  # in the metadata
    "output": "outputs", "control": "controls", "source": "disturbances", "sensor": "measured",
}  # fmt: skip


def columns_of(table):
    """Signals by role, and what each column is of; notes problems."""
    try:
        stated = read_json(table.metadata.get("signals", "{}"))
        signals = arguments.instance("signals", stated, dict)
        m = len(arguments.instance("outputs", signals.get("outputs"), dict))
        for key in signals:
            arguments.instance(key, signals[key], dict)
        controls = len(signals.get("controls", range(m)))  # those that are named
        if not {*signals} <= {*ROLES.values()} or not m or m != controls:
            words = ", ".join(ROLES.values())
            raise ValueError(
                f"it must have {words} and one control for each output, or none; what else is "
                "measured stands there as 'measured', other inputs as 'disturbances'"
            )
        units_of(signals)
        return signals, titles_of(signals, table.header)
    except (ValueError, RecursionError) as error:
        table.problems.append(
            f"metadata: signals must be a JSON object of names by role: {error}"
        )
        return {}, {}


def titles_of(signals, header):
    """The columns that a log of these signals has beside trial and time, and the signal of each."""
    there = {title.partition("_")[0] for title in header}
    absent = {
        signal for group in OPTIONAL if there.isdisjoint(group) for signal in group
    }
    return {
        f"{signal}_{name}": signal
        for signal, role in SIGNALS.items()
        for name in signals.get(ROLES[role], ())
        if signal not in absent
    }


def units_of(signals):
    """The unit of each signal, by its name."""
    found = {}
    for own in signals.values():
        for name, unit in own.items():
            if found.setdefault(name, unit) != unit:
                raise ValueError(
                    f"{name!r} has two units, {found[name]!r} and {unit!r}"
                )
    return found


def period(metadata, problems):
    """The sampling period in s, and the unit of it and of the time in s."""
    try:
        number, unit = metadata.get("Ts", "").split()
        if not NUMBER.fullmatch(number):  # as in the rows: float takes more
            raise ValueError(number)
        tick = units.seconds(unit)
        return arguments.sampling_period("Ts", float(number) * tick), tick
    except ValueError:
        stated = metadata.get("Ts")
        problems.append(
            f"metadata: Ts is {stated!r}, but must be a period such as '1.0 s'"
        )
        return None, None


def problems_of_titles(header, titles) -> list[str]:
    """Columns that are not known, and those that are missing."""
    problems = []
    for title in header:
        if title not in titles:
            close = difflib.get_close_matches(title, titles[:100], n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            problems.append(f"unknown column {title!r}{hint}")
    missing = [title for title in titles if title not in header]
    return problems + ([f"missing columns {few(missing)}"] if missing else [])
