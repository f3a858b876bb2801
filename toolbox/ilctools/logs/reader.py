"""Reading text and logs: rows known by their line, trials with the clock that they need."""

import csv
import gzip
import re
import warnings
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES
from ilctools.files import read_json, regular
from ilctools.logs import clock
from ilctools.logs.format import FORMATS, KEYS, check_signals, columns_of, few, units_of
from ilctools.loop.notes import LogError, reading, shortened
from ilctools.signals import dataset
from ilctools.units import seconds

# what a terminal would obey, as it is or as JSON writes it
CONTROL = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f\x9b]|\\u00([01]|7f|[89])", re.I)
LARGEST = 2**28  # bytes in a compressed file: a small one may hold any number
GZIP = b"\x1f\x8b"  # with which compressed files begin
MARKS = "#%/!"  # with which comments begin
SENSED = ("y", "delta", "measured")  # valid at a moment; other signals are held


def load_log(path, resample: bool = False) -> xr.Dataset:
    """Load a trial log and check it.

    Parameters
    ----------
    path : path-like
        A file of :func:`save_log`; :func:`read_table` reads other tables.
    resample : bool
        As in :func:`read_table`, which says what a clock may show.

    Returns
    -------
    xarray.Dataset
        As :func:`ilctools.run_trials` gives it, in the units and with the numbers of the trials of
        the file; of ``reference``, ``v`` and ``e``, ``u``, ``delta``, ``disturbance`` and
        ``measured`` what it has. The metadata are attributes; ``clock`` says how an inexact clock
        ran, ``resampled`` what was interpolated.

    Raises
    ------
    LogError
        The first thing that is wrong, with its row or metadata.

    Warns
    -----
    UserWarning
        If the last trial is shorter than the first, or the last line has no line feed, as a power
        cut leaves them: they are left out.

    See Also
    --------
    save_log : to write it
    read_table : of other programs
    replay : what it says of the law

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
    return read_log(arguments.path("path", path), arguments.flag("resample", resample))


def read_log(path: Path, resample: bool = False, ended: bool = False) -> xr.Dataset:
    """As :func:`load_log`; if `ended`, without a warning of a last line that is torn."""
    with about(path):
        lines = lines_of(path)
        metadata, header, first = _head(lines)
        if metadata.get("format") not in FORMATS:
            raise LogError(
                f"metadata: format is {few(metadata.get('format'))}, but must be one of {FORMATS}: "
                "ilctools.read_table reads other tables, of which save_log makes logs, and "
                "ilctools.load_law laws"
            )
        with reading("Ts"):
            value, unit = metadata["Ts"].split()
            second = seconds(unit)
            Ts = arguments.sampling_period("Ts", value_of(value) * second)
        with reading("signals"):
            signals = check_signals(read_json(metadata["signals"]))
        check_titles(header, signals)
        torn = lines.pop().strip()  # as far as one sees: a line that is whole has a line feed
        entries = rows_of(lines[first:], first, len(header))
        table = numbers_of(entries.set_axis(header, axis=1))
        table["time"] *= second
        notes = {key: value for key, value in metadata.items() if key not in KEYS}
        number = table["trial"]
        counts = number.value_counts(sort=False)
        if counts.iloc[-1] < counts.iloc[0]:
            warnings.warn(
                f"{path}: the last trial is shorter than the first, and left out", stacklevel=3
            )
            table = table[number != number.iloc[-1]]
        elif torn and not ended:
            warnings.warn(f"{path}: the last line has no line feed, and is left out", stacklevel=3)
        return trials_of(table, signals, Ts, notes, resample)


@contextmanager
def about(path) -> Iterator[None]:
    """Turn what is wrong with a file into a LogError that names it, in a few printable words."""
    try:
        yield
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error}") from None
    except (ValueError, ArithmeticError, RecursionError, EOFError, csv.Error, zlib.error) as error:
        text = shortened(f"{path}: {error}")
        raise LogError("".join(c if c.isprintable() else "?" for c in text)) from None


def lines_of(path: Path) -> list[str]:
    """The lines of a text in UTF-8, UTF-16 or, as old spreadsheets write it, Latin-1; or of .gz.

    What is compressed is unpacked up to LARGEST bytes.
    """
    content = regular(path).read_bytes()
    if content.startswith(GZIP):
        with gzip.open(path) as file:
            content = file.read(LARGEST)
            if file.read(1):
                raise LogError(f"holds more than {LARGEST} bytes: decompress it, if you trust it")
    try:
        text = content.decode(
            "utf-16" if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
        )
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if found := CONTROL.search(text):
        raise LogError(
            f"is not text, it has {found[0]!r}: save a spreadsheet as CSV; a .mat or .npz pass to "
            "read_table as pandas.DataFrame({name: numpy.ravel(file[name]) for name in (...)}) "
            "with file = scipy.io.loadmat(path) or numpy.load(path)"
        )
    return re.split(r"\r\n?|\n", text)


def split(lines: Iterable[str], delimiter: str = ",") -> csv.reader:
    """The entries of each line; a row of blanks is one delimiter."""
    if delimiter == " ":
        lines = (" ".join(line.split()) for line in lines)
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter != " ")


def rows_of(
    lines: Sequence[str], above: int, width: int, delimiter: str = ",", gaps: bool = False
) -> pd.DataFrame:
    """The text of each entry, a row each, indexed by its line in the file.

    Comments and empty lines are skipped; with `gaps`, so are rows of another width.
    """
    reader = split(("" if line.lstrip()[:1] in MARKS else line for line in lines), delimiter)
    rows = {}
    for row in reader:
        line = above + reader.line_num
        if len(row) == width:
            rows[line] = row
        elif any(map(str.strip, row)) and not gaps:
            raise LogError(f"row {line} has {len(row)} entries, but must have {width}")
    if not rows:
        raise LogError(f"there are no rows of {width} entries")
    return pd.DataFrame.from_dict(rows, "index", dtype=object)


def value_of(entry) -> float:
    """The number that an entry is, to the last digit; NaN if it is none, such as 1_000 or ٣."""
    try:
        text = str(entry)
        return float(entry) if text.isascii() and "_" not in text else np.nan
    except (TypeError, ValueError):
        return np.nan


def numbers_of(
    entries: pd.DataFrame, gaps: bool = False, titles: Mapping[str, str] | None = None
) -> pd.DataFrame:
    """The numbers in all columns; with `gaps`, only of the rows that have them all.

    `titles` are those of the file, if they are others.
    """
    table = entries.map(value_of)
    finite = np.isfinite(table)
    for title in () if gaps else entries:
        wrong = entries[title][~finite[title]]
        if len(wrong):
            raise LogError(
                f"{(titles or {}).get(title, title)}: entry {str(wrong.iloc[0])[:40]!r} in row "
                f"{wrong.index[0]} must be a finite number ({len(wrong)} such entries)"
            )
    whole, some = finite.all(axis=1), finite.any(axis=1)
    if whole.sum() <= clock.MISSING * some.sum():
        raise LogError(
            f"{whole.sum()} of {some.sum()} rows have a number in each column: fill in what is "
            "logged less often before, as pandas.DataFrame.ffill holds an input"
        )
    return table[whole]


def check_titles(header: Sequence[str], signals: Mapping) -> dict[str, list[str]]:
    """The columns by signal; a LogError if a log of these signals has others."""
    columns = columns_of(signals, [title.partition("_")[0] for title in header])
    titles = ["trial", "time", *chain(*columns.values())]
    if sorted(header) != sorted(titles):
        raise LogError(
            f"columns must be {few(titles)}, each once, but missing are "
            f"{few([title for title in titles if title not in header])} and unknown "
            f"{few([title for title in header if title not in titles])}"
        )
    return columns


def trials_of(
    table: pd.DataFrame, signals: Mapping, Ts: float, notes: dict, resample: bool
) -> xr.Dataset:
    """Trials from a table with the columns of a log, and the time in s."""
    columns = check_titles([*table], signals)
    if resample:
        between = [title for signal in SENSED for title in columns.get(signal, ())]
        table, note = clock.resampled(table, Ts, between)
        notes |= note
    clock.check_trials(table, Ts)
    notes |= clock.jitter(table, Ts)
    trial = table["trial"].unique().astype(int)
    arrays = {
        signal: table[titles].to_numpy().reshape(len(trial), -1, len(titles))
        for signal, titles in columns.items()
    }
    *channels, sensors = ([*signals.get(role, ())] for role in ROLES.values())
    trials = dataset(Ts, *channels, units_of(signals), sensors, **arrays)
    return trials.assign_coords(trial=trial).assign_attrs(notes)


def _head(lines):
    """The metadata, the titles, and how many lines stand above the rows."""
    metadata = {}
    for count, line in enumerate(lines, 1):
        key, mark, value = map(str.strip, line[1:].partition(":"))
        if line.startswith("#") and mark and key:
            if key in metadata:
                raise LogError(f"metadata: {key!r} stands twice, again in line {count}")
            if not (key + value).isprintable():
                raise LogError(f"metadata: line {count} has characters that are not printable")
            metadata[key] = value
        elif line.strip() and not line.startswith("#"):
            return metadata, next(split([line])), count
    raise LogError("there is no line with the titles of columns")
