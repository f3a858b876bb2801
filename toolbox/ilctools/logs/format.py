"""The trial log as text: lines `# key: value`, a line of titles, rows; see data/README.md."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.files import write_pieces

FORMAT = "rodlib trial log 2"
KEYS = ("format", "Ts", "signals")  # of the metadata that are not free
ROLES = {  # of signals, in a dataset and in the metadata
    "output": "outputs",
    "control": "controls",
    "source": "disturbances",
    "sensor": "measured",
}
SIGNALS = {  # and the role of their channels
    "reference": "output",
    "v": "output",
    "u": "control",
    "y": "output",
    "applied": "control",
    "delta": "control",
    "disturbance": "source",
    "measured": "sensor",
}
OPTIONAL = (("reference", "v"), ("applied",), ("delta",))  # a log has all of a group
LISTED = 18  # names in a message


def few(words: Sequence[str]) -> list[str]:
    """The first of them, and how many more there are."""
    more = [f"and {len(words) - LISTED} more"] if len(words) > LISTED else []
    return [*words[:LISTED], *more]


def save_log(trials: xr.Dataset, path) -> None:
    """Save trials as a log; the file is replaced as a whole or not at all.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`ilctools.run_trials`, :func:`ilctools.record` or :func:`load_log`. `e` is not
        written: it is reference - y. Attributes become metadata: a line of text as it is, all else
        as JSON.
    path : path-like

    Raises
    ------
    ValueError
        If a signal, a coordinate or an attribute is not what :func:`load_log` would give back.

    See Also
    --------
    load_log : to read it
    record : what writes one itself, by `path`

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
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    signals = json.dumps(signals_of(trials), ensure_ascii=False)
    metadata = {"format": FORMAT, "Ts": f"{Ts!r} s", "signals": signals}
    metadata |= _free_metadata(trials.attrs)
    columns = _trial_and_time(trials, Ts)
    for signal, role in SIGNALS.items():
        if signal not in trials:
            continue
        values = trials[signal].transpose("trial", "time", ...).astype(float).values
        for k, name in enumerate(trials[role].values):
            columns[f"{signal}_{name}"] = values[..., k].ravel()
    for title, values in columns.items():
        if not np.isfinite(values).all():
            raise ValueError(f"trials have values that are not finite in {title!r}")
    head = "".join(f"# {key}: {value}\n" for key, value in metadata.items())
    write_pieces(path, chain([head.encode()], lines_of(columns)))


def signals_of(trials: xr.Dataset, *needed: str) -> dict[str, dict[str, str]]:
    """Names and units of the signals by role, as in the metadata; refuses incomplete trials."""
    roles = dict.fromkeys(SIGNALS[signal] for signal in SIGNALS if signal in trials)
    together = {"reference", "v"} if {"reference", "v"} & {*trials} else ()
    labels = [label for role in roles for label in (role, f"{role}_unit")]
    needed = {"y", "trial", "time", *needed, *together, *labels}
    if missing := sorted(needed - {*trials.variables}):
        raise ValueError(f"trials lack {missing}: see ilctools.trials.run.dataset")
    signals = {}
    for role in roles:
        names, units = (trials[role].values.tolist(), trials[f"{role}_unit"].values.tolist())
        printable = all(isinstance(name, str) and name.isprintable() for name in names)
        if not printable or "" in names or len(set(names)) < len(names):
            raise ValueError(f"{role} = {few(names)} must be different names, all printable")
        signals[ROLES[role]] = dict(zip(names, units, strict=True))
    units_of(signals)
    return signals


def units_of(signals: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """The unit of each signal by its name; a ValueError if a name has two."""
    units = {}
    for role in signals.values():
        for name, unit in role.items():
            arguments.instance(f"unit of {name}", unit, str)
            if units.setdefault(name, unit) != unit:
                raise ValueError(f"{name!r} has two units, {units[name]!r} and {unit!r}")
    return units


def titles_of(signals: Mapping, header: Sequence[str]) -> dict[str, str]:
    """Titles of the columns beside trial and time, each with its signal."""
    present = {title.partition("_")[0] for title in header}
    absent = [name for group in OPTIONAL if present.isdisjoint(group) for name in group]
    return {
        f"{signal}_{name}": signal
        for signal, role in SIGNALS.items()
        if signal not in absent
        for name in signals.get(ROLES[role], ())
    }


def lines_of(columns: Mapping[str, np.ndarray]) -> Iterator[bytes]:
    """Comma-separated lines, each number with the fewest digits that give it back exactly."""
    yield ",".join(_quoted(title) for title in columns).encode()
    texts = [map(repr, values.tolist()) for values in columns.values()]
    for row in zip(*texts, strict=True):
        yield f"\n{','.join(row)}".encode()
    yield b"\n"


def _quoted(title):
    """A title as csv has it; with # as well, which pandas takes for the start of a comment."""
    return '"' + title.replace('"', '""') + '"' if re.search('[,"#]', title) else title


def _free_metadata(attributes):
    """All attributes but Ts, as the text of a line each."""
    metadata = {}
    for key, value in attributes.items():
        if key == "Ts":
            continue
        plain = isinstance(key, str) and re.fullmatch(r"[^\s:#]([^:]*[^\s:])?", key)
        if not plain or not key.isprintable() or key in KEYS:
            raise ValueError(f"attribute {key!r} cannot be a line of the log: rename it")
        line = isinstance(value, str) and value.isprintable() and value == value.strip()
        try:
            text = value if line else json.dumps(value, default=_as_list)
        except (TypeError, ValueError) as error:
            raise ValueError(f"attribute {key!r} cannot be JSON: {error}") from None
        metadata[key] = text
    return metadata


def _as_list(value):
    return np.asarray(value).tolist()


def _trial_and_time(trials, Ts):
    """The columns trial and time."""
    numbers = [arguments.whole("trials.trial", k, 1, 2**31) for k in trials.trial.values]
    time = trials.time.values.astype(float)
    if len(set(numbers)) < len(numbers) or trials.y.size == 0:
        raise ValueError(f"trials.trial = {few(numbers)} must differ, and have samples")
    if not np.allclose(time, Ts * np.arange(len(time)), rtol=1e-12, atol=1e-3 * Ts):
        raise ValueError(f"trials.time must be 0, Ts, 2 Ts, ... with Ts = {Ts} s")
    return {"trial": np.repeat(numbers, len(time)), "time": np.tile(time, len(numbers))}
