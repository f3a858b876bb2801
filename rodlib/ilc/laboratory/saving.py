"""Saving trials as a log, at once or trial by trial; loading.py reads it."""

import json
import re
from collections.abc import Iterator

import numpy as np
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.files import append_whole, write_pieces
from rodlib.ilc.laboratory import units as pints
from rodlib.ilc.laboratory.layout import FORMAT, OWN, REQUIRED, ROLES, SIGNALS, limits_of
from rodlib.ilc.laboratory.tables import few, rows

BLOCK = 2**17  # rows written at a time


def save_log(trials: xr.Dataset, path) -> None:
    """Save trials as a log; the file is replaced as a whole or not at all.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`rodlib.run_trials`, :func:`rodlib.record` or :func:`load_log`. Attributes are
        written as metadata: a line of text as it is, all else as JSON. With ``limits``, a JSON
        object of the lowest and highest plausible value by column, implausible values are not
        saved.
    path : path-like

    Raises
    ------
    ValueError
        If a signal, a coordinate or an attribute is not what :func:`load_log` would give back.
    """
    path = arguments.path("path", path)
    head = head_of(trials)
    write_pieces(path, (piece for part in ([head], _blocks(trials)) for piece in part))


def append_log(trials: xr.Dataset, path) -> None:
    """Append further trials to a log of the same signals; on the disk when this returns."""
    append_whole(path, b"".join(_blocks(trials)))


def head_of(trials: xr.Dataset) -> bytes:
    """The metadata and the header of a log; checks all that is to be written."""
    arguments.instance("trials", trials, xr.Dataset)
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    metadata = {"format": FORMAT, "Ts": f"{Ts!r} s"}
    metadata["signals"] = json.dumps(signals_of(trials), ensure_ascii=False)
    metadata |= _notes(trials.attrs)
    numbers = [arguments.whole("trials.trial", k, 1, 2**31) for k in trials.trial.values]
    if not numbers or not trials.sizes["time"]:
        raise ValueError("trials have no samples")
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"trials.trial = {few(numbers)} must be numbers, none of them twice")
    time = np.asarray(trials.time.values, dtype=float)
    if np.any(~(np.abs(time - Ts * np.arange(len(time))) <= 1e-3 * Ts)):
        raise ValueError(f"trials.time must be 0, Ts, 2 Ts, ... with Ts = {Ts} s")
    columns = {
        f"{signal}_{name}": column
        for signal, values in _values(trials).items()
        for name, column in zip(trials[SIGNALS[signal]].values, values.T, strict=True)
    }
    limits = limits_of(metadata.get("limits", "{}"), columns)
    for title, values in columns.items():
        low, high = limits[title]
        if not np.isfinite(values).all():
            raise ValueError(f"trials have values that are not finite in {title!r}")
        if values.min() < low or values.max() > high:
            raise ValueError(
                f"trials have values of {title!r} that are not from {low:g} to {high:g}"
            )
    lines = [f"# {key}: {value}\n" for key, value in metadata.items()]
    header = ",".join(["trial", "time", *(quoted(title) for title in columns)])
    return "".join([*lines, header, "\n"]).encode()


def quoted(title: str) -> str:
    """A title as csv has it; # as well, which others take for the start of a comment."""
    return '"' + title.replace('"', '""') + '"' if re.search('[,"#]', title) else title


def signals_of(trials) -> dict[str, dict[str, str]]:
    """Names and units of the signals, by role, as the metadata say it, if all are there."""
    missing = [name for name in REQUIRED if name not in trials]
    if missing:
        raise ValueError(f"trials lack {missing}: a log needs {REQUIRED}")
    roles = {SIGNALS[name]: ROLES[SIGNALS[name]] for name in SIGNALS if name in trials}
    needed = ["trial", "time", *(role + end for role in roles for end in ("", "_unit"))]
    missing = [name for name in needed if name not in trials.coords]
    if missing:
        raise ValueError(f"trials lack the coordinates {missing}: see rodlib.ilc.trials.dataset")
    signals, units = {}, {}
    for role, key in roles.items():
        names, own = trials[role].values.tolist(), trials[f"{role}_unit"].values.tolist()
        signals[key] = dict(zip(names, own, strict=True))
        for name, unit in signals[key].items():
            if not (isinstance(name, str) and name.isprintable() and name):
                raise ValueError(f"{role} {name!r} must have a name of printable characters")
            pints.unit(name, unit)
            if units.setdefault(name, unit) != unit:
                raise ValueError(f"{name!r} has two units, {units[name]!r} and {unit!r}")
        if len(signals[key]) < len(names):
            raise ValueError(f"{role} = {few(names)} must be different names")
    return signals


def _notes(attributes):
    """The attributes as metadata: a line of text as it is, all else as JSON."""
    notes = {}
    for key, value in attributes.items():
        if key == "Ts":
            continue
        plain = isinstance(key, str) and re.fullmatch(r"[^\s:#]([^:]*[^\s:])?", key)
        if not (plain and key.isprintable()) or key in OWN:
            raise ValueError(f"attribute {key!r} cannot be a line of the log: rename it")
        line = isinstance(value, str) and value.isprintable() and value == value.strip()
        notes[key] = value if line else json.dumps(value, default=str)
    return notes


def _values(trials):
    """The signals of a log in its order, shape (row, channel) each."""
    return {
        signal: np.asarray(
            trials[signal].transpose("trial", "time", ...).values, dtype=float
        ).reshape(trials.sizes["trial"] * trials.sizes["time"], -1)
        for signal in SIGNALS
        if signal in trials
    }


def _blocks(trials) -> Iterator[bytes]:
    """The rows as text, some at a time."""
    samples, values = trials.sizes["time"], _values(trials)
    numbers, time = trials.trial.values, np.asarray(trials.time.values, dtype=float)
    for start in range(0, len(numbers) * samples, BLOCK):
        row = np.arange(start, min(start + BLOCK, len(numbers) * samples))
        counters = (numbers[row // samples], time[row % samples])
        yield rows(counters, [signal[row[0] : row[-1] + 1] for signal in values.values()])
