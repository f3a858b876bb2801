"""The trial log as text: metadata, a line of titles, and rows; see data/README.md.

A line of metadata is `# key: value`. :func:`columns_of` defines the columns, for writing and for
reading.
"""

import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from reprlib import Repr

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES
from ilctools.files import keep_others, write_pieces
from ilctools.law.notes import is_newer
from ilctools.signals import ASKED, SIGNALS, period_of, points_of, roles_of

# The second format is for an L whose note `is_newer`, the third for a v with channels of inputs.
LOG_FORMATS = ("rodlib trial log 2", "rodlib trial log 3", "rodlib trial log 4")
RESERVED_KEYS = ("format", "Ts", "signals", ASKED)  # keys that free metadata must not have
OPTIONAL = (("reference", "v"), ("applied",), ("delta",))  # a log has a whole group, or none

_message = Repr()
_message.maxlist, _message.maxstring = 18, 80
few = _message.repr  # shortens a list of names for a message


def save_log(trials: xr.Dataset, path) -> None:
    """Save trials as a log.

    A log that is already at this path is replaced as a whole or not at all.

    Parameters
    ----------
    trials : xarray.Dataset
        Trials from :func:`ilctools.run_trials`, :func:`ilctools.record` or :func:`load_log`. The
        error `e` is not written, because e = reference - y. Attributes become metadata. An
        attribute that is a line of text is written unchanged, and any other attribute is written as
        JSON. Other variables, coordinates and attributes of signals are not written.
    path : path-like
        Path of the log.

    Raises
    ------
    ValueError
        If :func:`load_log` would not give back a signal or an attribute unchanged. If the path
        holds a file that does not begin like a log, such as raw data.

    See Also
    --------
    load_log : reads a log
    record : writes a log itself, with `path`

    Examples
    --------
    >>> import control
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, Law, load_log, run_trials, save_log
    >>> from ilctools import zero_phase_butterworth
    >>> law = Law(zero_phase_butterworth(2, 40.0, 0.01), None)
    >>> trials = run_trials(ClosedLoop(P), law, np.ones((100, 1)), trials=2)
    >>> save_log(trials, "log.csv")
    >>> dict(load_log("log.csv").sizes)
    {'trial': 2, 'time': 100, 'channel': 1}
    """
    path = arguments.path("path", path)
    arguments.instance("trials", trials, xr.Dataset)
    keep_others(path, f"# format: {LOG_FORMATS[0][:-1]}")
    write_log(trials, path)


def write_log(trials: xr.Dataset, path) -> None:
    """Write a log, even if the path holds another file."""
    signals, Ts = signals_of(trials), period_of(trials)
    format_number = 2 if "inputs" in signals else is_newer(str(trials.attrs.get("L")))
    metadata = {
        "format": LOG_FORMATS[format_number],
        "Ts": f"{Ts!r} s",
        "signals": json.dumps(signals, ensure_ascii=False),
        **_points_note(trials),
        **_free_metadata(trials.attrs),
    }
    columns = columns_of(signals, trials)
    if missing := columns.keys() - {*trials}:
        raise ValueError(f"trials lack the signals {sorted(missing)}")
    numbers, times = _numbers_and_times(trials)
    trials = trials.transpose("trial", "time", ...)
    values = {
        signal: arguments.array(f"trials.{signal}", trials[signal].values, (...,))
        for signal in columns
    }
    head = "".join(f"# {key}: {value}\n" for key, value in metadata.items())
    titles = ",".join(map(_quoted, ["trial", "time", *chain(*columns.values())]))
    each = (
        rows_as_text(number, times, [signal[k] for signal in values.values()])
        for k, number in enumerate(numbers)
    )
    write_pieces(path, chain([f"{head}{titles}\n".encode()], *each))


def _points_note(trials):
    """Return the samples with a reference, by output.

    If the reference covers all samples, an empty dict is returned.
    """
    points = points_of(trials)
    if points is None:
        return {}
    names = trials.output.values.tolist()
    samples = {n: np.flatnonzero(p).tolist() for n, p in zip(names, points.T, strict=True)}
    return {ASKED: json.dumps(samples, ensure_ascii=False)}


def rows_as_text(number: int, times, signals: Sequence[np.ndarray]) -> Iterator[bytes]:
    """Yield the rows of a trial in a log.

    The signals of the trial have the shape (time, channel).
    """
    for row in np.column_stack([times, *signals]).tolist():
        time.sleep(0)  # lets another thread continue, in which a sample of a rig may be due
        # repr gives each number the fewest digits that restore the number exactly
        yield f"{number},{','.join(map(repr, row))}\n".encode()


def signals_of(trials: xr.Dataset, *needed: str) -> dict[str, dict[str, str]]:
    """Return the names and units of the signals by role, as the metadata state them.

    If a signal is missing, the trials are refused.
    """
    role_of = roles_of("input" in trials.coords)
    roles = dict.fromkeys(role_of[signal] for signal in SIGNALS if signal in trials)
    needed = {"y", "trial", "time", *needed, *roles, *(f"{role}_unit" for role in roles)}
    if missing := sorted(needed - {*trials.variables}):
        raise ValueError(
            f"trials lack {missing}, which the results of run_trials, record and load_log "
            "contain: pass such trials, or call read_table with the columns of reference and "
            "v"
        )
    signals = {}
    for role in roles:
        names = arguments.different(role, trials[role].values.tolist())
        signals[ROLES[role]] = dict(zip(names, trials[f"{role}_unit"].values.tolist(), strict=True))
    check_signals(signals)
    return signals


def check_signals(signals: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the unit of each signal by name; refuse signals that a log cannot have."""
    units = {}
    for role, names in arguments.instance("signals", signals, dict).items():
        arguments.choice("a key of signals", role, [*ROLES.values()])
        for name, unit in arguments.instance(role, names, dict).items():
            if not (name and name.isprintable() and isinstance(unit, str) and unit.isprintable()):
                raise ValueError(
                    f"unit of {few(name)} = {few(unit)} must be text, and so must the name; "
                    "both must be printable"
                )
            if units.setdefault(name, unit) != unit:
                raise ValueError(
                    f"{name!r} has two units, {units[name]!r} and {unit!r}: state one of them"
                )
    outputs, controls = (signals.get(role, ()) for role in ("outputs", "controls"))
    if not outputs or ("controls" in signals and len(controls) != len(outputs)):
        raise ValueError(
            f"outputs are {few([*outputs])} and controls are {few([*controls])}, but there "
            "must be as many controls as outputs, one or more, or no controls: name other "
            "inputs as disturbances, and other outputs as measured"
        )
    return units


def columns_of(signals: Mapping, present: Iterable[str]) -> dict[str, list[str]]:
    """Return the titles of all columns except trial and time, grouped by signal.

    The signals and their columns have the order of a log. If one signal of an optional group is
    present, a log has all signals of this group.
    """
    absent = [name for group in OPTIONAL if {*group}.isdisjoint(present) for name in group]
    return {
        signal: [f"{signal}_{name}" for name in signals[ROLES[role]]]
        for signal, role in roles_of("inputs" in signals).items()
        if signals.get(ROLES[role]) and signal not in absent
    }


def _quoted(title):
    """Quote a title for CSV if needed.

    If a title contains # without quotes, pandas takes what follows for a comment.
    """
    return '"' + title.replace('"', '""') + '"' if re.search('[,"#]', title) else title


def _free_metadata(attributes):
    """Convert all attributes except Ts to text, one line for each."""
    metadata = {}
    for key, value in attributes.items():
        if key == "Ts":
            continue
        if key in RESERVED_KEYS or not re.fullmatch(r"[^\s:#]([^:]*[^\s:])?", str(key)):
            raise ValueError(f"attribute {key!r} cannot be a line of the log: rename the attribute")
        line = isinstance(value, str) and value.isprintable() and value == value.strip()
        default = lambda part: np.asarray(part).tolist()  # noqa: E731
        metadata[key] = value if line else json.dumps(value, default=default)
    return metadata


def _numbers_and_times(trials):
    """Return the numbers of the trials and the times of the samples, both checked."""
    numbers = [arguments.whole("trials.trial", k, 1, 2**31) for k in trials.trial.values]
    times = trials.time.values.astype(float)
    if len(set(numbers)) < len(numbers) or not trials.y.size or times[0] != 0:
        raise ValueError(
            f"trials.trial = {few(numbers)} must be different numbers, and trials.time must be "
            "0, Ts, 2 Ts, ..."
        )
    return numbers, times
