"""Read logs: the metadata, the rows (by pandas), and trials whose clock is checked."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from itertools import chain, takewhile
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES
from ilctools.errors import LogError, reading, shortened
from ilctools.files import regular
from ilctools.logs.clock import check_trials, seconds
from ilctools.logs.contents import text_in
from ilctools.logs.format import LOG_FORMATS, RESERVED_KEYS, check_signals, columns_of, few
from ilctools.signals import ASKED, dataset, with_points
from ilctools.warn import warn

# With these options pandas warns of rows that are longer than the titles, and shifts no column.
OPTIONS = {"skipinitialspace": True, "index_col": False}


def load_log(path) -> xr.Dataset:
    """Load a trial log and check it.

    Parameters
    ----------
    path : path-like
        A file of :func:`save_log`; :func:`read_table` reads other tables.

    Returns
    -------
    xarray.Dataset
        Trials as from :func:`ilctools.run_trials`, in the units of the file and with the trial
        numbers of the file. The signals ``reference``, ``v`` and ``e``, ``u``, ``delta``,
        ``disturbance`` and ``measured`` are there if the file has them. The metadata are
        attributes. If the clock was inexact, the attribute ``clock`` describes it, see
        :func:`read_table`.

    Raises
    ------
    LogError
        If something is wrong with the file. The error names the first mistake, and the line of
        metadata or the row in which the mistake is. Row 0 is the first row below the titles. If the
        file is not text in UTF-8, the error says what to do.

    Warns
    -----
    UserWarning
        If the last trial is shorter than the first, or if the last line has no line feed. A power
        cut during the recording may have these effects. The incomplete trial or line is left out.

    See Also
    --------
    save_log : writes a log
    read_table : reads tables of other programs
    replay : compares a log with its law

    Examples
    --------
    >>> import control
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, Law, load_log, run_trials, save_log
    >>> from ilctools import zero_phase_butterworth
    >>> law = Law(zero_phase_butterworth(2, 40.0, 0.01), None)
    >>> save_log(run_trials(ClosedLoop(P), law, np.ones((100, 1)), trials=2), "log.csv")
    >>> log = load_log("log.csv")
    >>> log.attrs["Ts"], log.y.dims
    (0.01, ('trial', 'time', 'channel'))
    """
    return read_log(arguments.path("path", path))


def read_log(path: Path, ended: bool = False) -> xr.Dataset:
    """Read a log as :func:`load_log` does; if `ended`, do not warn of an incomplete last line."""
    with about(path):
        # a complete line ends with a line feed
        file = regular(path)
        remedy = (
            "a program that opened the log may have saved it in another encoding. Save it as UTF-8"
        )
        with text_in("utf-8", remedy):
            *lines, torn = file.read_text(encoding="utf-8-sig").split("\n")
        metadata = _metadata(lines)
        if metadata.get("format") not in LOG_FORMATS:
            raise LogError(
                f"metadata: format is {few(metadata.get('format'))}, but must be one of "
                f"{LOG_FORMATS}. Read other tables by ilctools.read_table, and save the result "
                "by save_log to make a log. Read laws by ilctools.load_law"
            )
        Ts, second = _period(metadata)
        with reading("signals"):
            signals = json.loads(metadata["signals"])
            check_signals(signals)
        text = StringIO("\n".join(lines))
        entries = pd.read_csv(text, comment="#", dtype=str, keep_default_na=False, **OPTIONS)
        check_titles([*entries], signals)
        if entries.empty:
            raise LogError("there are no rows below the column titles")
        table = entries.apply(numbers_in)
        table["time"] *= second
        number = table["trial"]
        counts = number.value_counts(sort=False)
        if counts.iloc[-1] < counts.iloc[0]:
            warn(f"{path}: the last trial is shorter than the first, and was left out")
            table = table[number != counts.index[-1]]
        elif torn.strip() and not ended:
            warn(f"{path}: the last line does not end with a line feed, and was left out")
        notes = {key: value for key, value in metadata.items() if key not in RESERVED_KEYS}
        trials = trials_of(table, signals, Ts, notes)
        return trials if ASKED not in metadata else _with_points_from(metadata[ASKED], trials)


def _with_points_from(note, trials):
    """Mark the points of trials at which the error counts, as the metadata state them."""
    points = np.zeros(trials.y.shape[1:], dtype=bool)
    with reading(ASKED):
        for name, samples in json.loads(note).items():
            points[samples, trials.output.values.tolist().index(name)] = True
    return with_points(trials, points)


@contextmanager
def about(path) -> Iterator[None]:
    """Turn an error in this block into a short, printable LogError that names the file `path`."""
    try:
        yield
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}") from None
    except ValueError as error:
        text = shortened(f"{path}: {error}")
        raise LogError("".join(c if c.isprintable() else "?" for c in text)) from None


def _metadata(lines):
    """Read the metadata above the titles."""
    metadata = {}
    for line in takewhile(lambda line: line.startswith("#") or not line.strip(), lines):
        key, mark, value = map(str.strip, line[1:].partition(":"))
        if key in metadata:
            raise LogError(f"metadata: {key!r} appears twice")
        if mark and key:
            metadata[key] = value
    return metadata


def _period(metadata):
    """Read the sampling period and the unit of time, both in s."""
    note = metadata.get("Ts", "")
    value, *unit = note.split() or [note]
    if len(unit) != 1:
        raise LogError(
            f"metadata: Ts is {few(note)}, but must be a number with a unit, as in '# Ts: 0.5 s'"
        )
    with reading("Ts"):
        second = seconds(*unit)
        return arguments.sampling_period("Ts", value_of(value) * second), second


def value_of(entry) -> float:
    """Return an entry as a number.

    If the entry is not a plain number in ASCII, such as 1_000 or ٣, the result is NaN.
    """
    try:
        text = str(entry)
        return float(entry) if text.isascii() and "_" not in text else np.nan
    except (TypeError, ValueError):
        return np.nan


def numbers_in(column: pd.Series) -> pd.Series:
    """Return the numbers in a column; refuse an entry that is not a finite number."""
    numbers = column.map(value_of).astype(float)
    wrong = column[~np.isfinite(numbers)]
    if len(wrong):
        first = wrong.iloc[0]
        remedy = "If the file has decimal commas or dates, read it by read_table, which has "
        remedy += "options for them"
        if pd.isna(first) or not str(first).strip():
            remedy = "The entry is missing: interpolate it, or leave its trial out"
        raise LogError(
            f"{column.name}: entry {str(first)[:40]!r} in row {wrong.index[0]} must be "
            f"a finite number (number of such entries: {len(wrong)}). {remedy}"
        )
    return numbers


def check_titles(header: Sequence[str], signals: Mapping) -> dict[str, list[str]]:
    """Return the column titles of each signal.

    Raise an error if a column of the log is missing or unknown.
    """
    columns = columns_of(signals, [title.partition("_")[0] for title in header])
    titles = ["trial", "time", *chain(*columns.values())]
    if sorted(header) != sorted(titles):
        raise LogError(
            f"columns must be {few(titles)}, each once, but "
            f"{few([title for title in titles if title not in header])} are missing, and "
            f"{few([title for title in header if title not in titles])} are unknown"
        )
    return columns


def trials_of(table: pd.DataFrame, signals: Mapping, Ts: float, notes: dict) -> xr.Dataset:
    """Make trials from a table with the columns of a log and the time in s."""
    columns = check_titles([*table], signals)
    notes |= check_trials(table, Ts)
    trial = table["trial"].unique().astype(int)
    arrays = {
        signal: table[titles].to_numpy().reshape(len(trial), -1, len(titles))
        for signal, titles in columns.items()
    }
    *channels, sensors, learned = ([*signals.get(role, ())] for role in ROLES.values())
    trials = dataset(Ts, *channels, check_signals(signals), sensors, learned, **arrays)
    return trials.assign_coords(trial=trial).assign_attrs(notes)
