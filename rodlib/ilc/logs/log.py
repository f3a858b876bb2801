"""The trial log, a plain-text table: loaded and saved, with checks; see data/README.md."""

import json
import re
import reprlib
import warnings
from collections.abc import Sequence
from datetime import date
from itertools import pairwise

import numpy as np
import xarray as xr

from rodlib.ilc import arguments, units
from rodlib.ilc.files import write_pieces
from rodlib.ilc.logs import sampling, stated, tables
from rodlib.ilc.logs.stated import OPTIONAL, ROLES, SIGNALS
from rodlib.ilc.logs.tables import few
from rodlib.ilc.trials.run import dataset

FORMAT = "rodlib trial log 2"
READ = ("y", "delta", "measured")  # what sensors show at a moment; all else is held
FOREIGN = "rodlib.read_table reads other tables, by the names of their columns"
OWN = ("format", "Ts", "signals")  # metadata that are no attributes


class LogError(ValueError):
    """A log that cannot be used; the message lists what is wrong with it."""


def load_log(path, resample: bool = False) -> xr.Dataset:
    """Load a trial log and check it.

    Parameters
    ----------
    path : path-like
        Of a file of :func:`save_log`; :func:`read_table` reads any other table.
    resample : bool
        As in :func:`read_table`, which says what a clock may show.

    Returns
    -------
    xarray.Dataset
        As :func:`rodlib.run_trials` gives it, in the units and with the numbers of the trials of
        the file; of ``reference``, ``v`` and ``e``, ``u``, ``delta``, ``disturbance`` and
        ``measured`` what it has. The metadata are attributes, and ``clock``, if that is not exact.

    Raises
    ------
    LogError
        With all that is wrong, each problem with its trial or row.

    Warns
    -----
    UserWarning
        If a trial is missing between others, or was resampled.
    """
    path = arguments.path("path", path)
    trials = _load(path, resample=arguments.flag("resample", resample))
    if resample and "resampled" in trials.attrs:
        warnings.warn(f"{path}: {trials.attrs['resampled']}", stacklevel=2)
    if missing := _missing_between(trials.trial.values.tolist()):
        warnings.warn(f"path = '{path}': {missing}", stacklevel=2)
    return trials


def _missing_between(numbers: Sequence[int]) -> str | None:
    """Which trials are not there between others, in words; in another order they are a choice."""
    gaps = [range(a + 1, b) for a, b in pairwise(numbers)]
    if not any(gaps) or any(b <= a for a, b in pairwise(numbers)):
        return None
    which = ", ".join(
        f"{g[0]} to {g[-1]}" if len(g) > 1 else f"{g[0]}" for g in few(gaps) if g
    )
    return (
        f"trial {which} is missing between others: whether the trials follow from each other by "
        "the law, and converge, cannot be told across a gap"
    )


def load_ended(path) -> xr.Dataset:
    """The trials in a log that have ended: without a last one that is shorter than the first."""
    return _load(path, ended=True)


def save_log(trials: xr.Dataset, path) -> None:
    """Save trials as a log; the file is replaced as a whole or not at all.

    Parameters
    ----------
    trials : xarray.Dataset
        From :func:`rodlib.run_trials`, :func:`rodlib.record` or :func:`load_log`. Attributes are
        written as metadata: a line of text as it is, a time as ISO 8601 has it, all else as JSON.
    path : path-like

    Raises
    ------
    ValueError
        If a signal, a coordinate or an attribute is not what :func:`load_log` would give back.
    """
    path = arguments.path("path", path)
    arguments.instance("trials", trials, xr.Dataset)
    Ts = arguments.sampling_period("trials.attrs['Ts']", trials.attrs.get("Ts"))
    metadata = {"format": FORMAT, "Ts": f"{Ts!r} s"}
    metadata["signals"] = json.dumps(signals_of(trials), ensure_ascii=False)
    metadata |= _notes(trials.attrs)
    columns = _counters(trials, Ts)
    for signal, role in SIGNALS.items():
        if signal in trials:
            values = trials[signal].transpose("trial", "time", ...).values.astype(float)
            values = values.reshape(len(columns["time"]), -1).T
            names = [f"{signal}_{name}" for name in trials[role].values]
            columns |= dict(zip(names, values, strict=True))
    for title, values in columns.items():
        if not np.isfinite(values).all():
            raise ValueError(f"trials have values that are not finite in {title!r}")
    lines = [f"# {key}: {value}\n" for key, value in metadata.items()]
    header = ",".join(tables.quoted(title) for title in columns)
    write_pieces(
        path,
        ["".join([*lines, header, "\n"]).encode(), tables.rows([*columns.values()])],
    )


def signals_of(trials: xr.Dataset, *needed: str) -> dict[str, dict[str, str]]:
    """Names and units of the signals, by role, as the metadata say it, if all are there."""
    roles = dict.fromkeys(role for signal, role in SIGNALS.items() if signal in trials)
    needed += (
        "y",
        "trial",
        "time",
        *(role + end for role in roles for end in ("", "_unit")),
    )
    together = next(group for group in OPTIONAL if "v" in group)
    needed += together if any(name in trials for name in together) else ()
    missing = [name for name in dict.fromkeys(needed) if name not in trials.variables]
    if missing:
        raise ValueError(f"trials lack {missing}: see rodlib.ilc.trials.run.dataset")
    signals = {}
    for role in roles:
        names, own = (
            trials[role].values.tolist(),
            trials[f"{role}_unit"].values.tolist(),
        )
        signals[ROLES[role]] = dict(zip(names, own, strict=True))
        plain = all(
            isinstance(name, str) and name.isprintable() and name for name in names
        )
        if not plain or len(set(names)) < len(names):
            raise ValueError(
                f"{role} = {few(names)} must be different names, all printable"
            )
    for name, unit in stated.units_of(signals).items():
        units.understood(name, unit)
    _check_errors(trials)
    return signals


def _check_errors(trials):
    """Refuse an e that is likely another signal; one that is left from before is not used."""
    if not {"e", "v"} <= {*trials} or not trials.e.size:
        return
    e, v, y, reference = (trials[name] for name in ("e", "v", "y", "reference"))
    near = 1e-6 * max(abs(y).max(), abs(reference).max())
    with np.errstate(over="ignore", invalid="ignore"):
        due = reference - y
        if abs(e - due).max() <= near:
            return
        for likely, other in (
            ("it has the wrong sign", -e),
            ("it is exchanged with v", v),
        ):
            if abs(other - due).max() <= near:
                raise ValueError(f"trials.e is not reference - y: likely {likely}")


def _load(path, ended=False, resample=False):
    """As :func:`load_log`, or :func:`load_ended`."""
    content = content_of(path)
    try:
        table = tables.read(content[: content.rfind(b"\n") + 1] if ended else content)
    except UnicodeError as error:
        raise LogError(f"{path}: cannot be read as text: {error}") from None
    problems, metadata = table.problems, table.metadata
    if metadata.get("format") != FORMAT:
        hint = (
            "rodlib.load_law reads laws"
            if content.lstrip().startswith(b"{")
            else FOREIGN
        )
        found = metadata.get("format")
        problems.append(
            f"metadata: format is {found!r}, but must be {FORMAT!r}: {hint}"
        )
    refuse(path, problems)  # all further ones would follow from these
    signals, titles = stated.columns_of(table)
    refuse(path, problems)
    for name, unit in stated.units_of(signals).items():
        try:
            units.understood(name, unit)
        except ValueError as error:
            problems.append(f"metadata: {error}")
    Ts, tick = stated.period(metadata, problems)
    problems += stated.problems_of_titles(table.header, ["trial", "time", *titles])
    problems += table.problems_of(["trial", "time", *titles])
    problems += [] if table.columns.size else ["the table has no rows"]
    refuse(path, problems)
    if ended:
        _drop_short_last_trial(table)
    table.columns[table.header.index("time")] *= tick
    notes = {key: value for key, value in metadata.items() if key not in OWN}
    return trials_of(path, table, signals, Ts, notes, resample)


def content_of(path) -> bytes:
    """What stands in a file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}") from None


def trials_of(
    source, table, signals, Ts, notes, resample=False, anywhere=False
) -> xr.Dataset:
    """The trials in a table with the columns of a log, and the time in s."""
    titles, notes = stated.titles_of(signals, table.header), dict(notes)
    if resample:
        between = [title for title, signal in titles.items() if signal in READ]
        if done := sampling.resample(table, Ts, between):
            notes["resampled"] = done
    numbers, problems = sampling.check_trials(table, Ts, anywhere)
    refuse(source, problems)
    if clock := sampling.about_clock(table, Ts):
        notes["clock"] = clock
    read = {}
    for title, signal in titles.items():
        read.setdefault(signal, []).append(
            table.column(title).reshape(len(numbers), -1)
        )
    read = {signal: np.stack(each, 2) for signal, each in read.items()}
    *names, sensors = ([*signals.get(key, {})] for key in ROLES.values())
    trials = dataset(Ts, *names, stated.units_of(signals), sensors, **read)
    return trials.assign_coords(trial=numbers.astype(int)).assign_attrs(notes)


def refuse(path, problems) -> None:
    """A LogError with all problems, if there are any."""
    if problems:
        listed = "".join(f"\n- {text}" for text in few(problems))
        raise LogError(f"{path}: {len(problems)} problem(s){listed}")


def _drop_short_last_trial(table):
    """What a killed process has left of a trial."""
    starts = sampling.starts_of(table.column("trial"))
    if len(starts) > 1 and table.columns.shape[1] - starts[-1] < starts[1]:
        table.columns = table.columns[:, : starts[-1]]


def _notes(attributes):
    """The attributes as metadata: a line of text or a time as it is, all else as JSON."""
    notes = {}
    for key, value in attributes.items():
        if key == "Ts":
            continue
        plain = isinstance(key, str) and re.fullmatch(r"[^\s:#]([^:]*[^\s:])?", key)
        if not (plain and key.isprintable()) or key in OWN:
            raise ValueError(
                f"attribute {key!r} cannot be a line of the log: rename it"
            )
        value = _as_text(value) if isinstance(value, date | np.datetime64) else value
        line = isinstance(value, str) and value.isprintable() and value == value.strip()
        try:
            notes[key] = value if line else json.dumps(value, default=_as_text)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"attribute {key!r} cannot be a line of the log: {error}"
            ) from None
    return notes


def _as_text(value):
    """What JSON has no word for: times in the words of ISO 8601, arrays as lists."""
    if isinstance(value, np.datetime64):
        return str(value)
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(
        f"{reprlib.repr(value)} is neither text, a number, a time nor a list of them"
    )


def _counters(trials, Ts):
    """The columns trial and time."""
    numbers = [
        arguments.whole("trials.trial", k, 1, 2**31) for k in trials.trial.values
    ]
    if not numbers or not trials.sizes["time"]:
        raise ValueError("trials have no samples")
    if len(set(numbers)) < len(numbers):
        raise ValueError(
            f"trials.trial = {few(numbers)} must be numbers, none of them twice"
        )
    time = np.asarray(trials.time.values, dtype=float)
    if sampling.off(time, Ts).any():
        raise ValueError(f"trials.time must be 0, Ts, 2 Ts, ... with Ts = {Ts} s")
    return {"trial": np.repeat(numbers, len(time)), "time": np.tile(time, len(numbers))}
