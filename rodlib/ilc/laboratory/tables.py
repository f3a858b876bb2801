"""The table beneath a log: lines of metadata, a header, rows of numbers, all checked by their line.

pyarrow reads and writes the numbers, piece by piece: exactly, fast, and strict about what a number
is and how many a row has. A piece that it refuses is read again by hand, to say what is wrong.
"""

import csv
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

PIECE = 2**24  # bytes read at a time
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*", re.ASCII | re.IGNORECASE)
SEPARATORS = {";": "semicolons", "\t": "tabs"}
NO_ROW = (b"\n#", b"\n\n", b"\n ", b"\n\t")  # what may begin a line that is none
LISTED = 18  # problems, and names in a message


class LogError(ValueError):
    """A log that cannot be used; the message lists what is wrong with it."""


def refuse(path, problems: Sequence[str]) -> None:
    """Raise a LogError with the problems, if there are any."""
    if problems:
        listed = "".join(f"\n- {text}" for text in few(problems))
        raise LogError(f"{path}: {len(problems)} problem(s){listed}")


def few(words: Sequence[str]) -> list[str]:
    """The first of them, and how many more there are."""
    more = [f"and {len(words) - LISTED} more"] if len(words) > LISTED else []
    return [*words[:LISTED], *more]


@dataclass
class Table:
    """What stands in a log, as far as it could be read.

    Attributes
    ----------
    metadata : dict of str
    header : list of str
        Titles of the columns.
    line : int
        Of the header, counted from 1.
    pieces : list of ndarray, shape (rows, columns)
    skipped : list of int
        Lines below the header that are no rows.
    """

    metadata: dict[str, str] = field(default_factory=dict)
    header: list[str] = field(default_factory=list)
    line: int = 0
    pieces: list[np.ndarray] = field(default_factory=list)
    skipped: list[int] = field(default_factory=list)

    def column(self, title: str) -> np.ndarray:
        """All numbers of a column."""
        index = self.header.index(title)
        return np.concatenate([piece[:, index] for piece in self.pieces])

    def line_of(self, row: int) -> int:
        """The line of the file where a row stands that is counted from 0."""
        line = self.line + 1 + int(row)
        for skipped in self.skipped:
            line += skipped <= line
        return line


def read_head(file, problems: list[str]) -> Table:
    """Metadata and header of a log; `file` then stands at its first row."""
    start = file.read(3)
    if start[:2] in (BOM_UTF16_LE, BOM_UTF16_BE):
        raise UnicodeError("it is UTF-16: save it as UTF-8")
    if start != BOM_UTF8:
        file.seek(0)
    table = Table()
    for table.line, line in enumerate(iter(file.readline, b""), 1):
        text = line.decode("utf-8").strip("\r\n")
        if not text.startswith("#"):
            if text.strip():
                table.header = _entries(text)
                break
        elif match := re.fullmatch(r"#\s*([^:]*[^:\s])\s*:\s*(.*?)\s*", text):
            key, value = match.groups()
            if key in table.metadata:
                problems.append(f"metadata: {key!r} is given twice, again in line {table.line}")
            table.metadata.setdefault(key, value)
    _check_header(table.header, problems)
    return table


def _entries(text):
    try:
        return next(csv.reader([text], skipinitialspace=True), [])
    except csv.Error:  # an entry of more than 100,000 characters
        return []


def _check_header(header, problems):
    if not header:
        problems.append("no table: there is no line with the names of the columns")
    elif len(header) == 1 and any(mark in header[0] for mark in SEPARATORS):
        word = next(word for mark, word in SEPARATORS.items() if mark in header[0])
        problems.append(f"no table: its columns are separated by {word}, but must be by commas")
    elif header[-1] == "":
        problems.append("the line with the names of the columns ends with a comma: remove it")
    else:
        for title in dict.fromkeys(title for title in header if header.count(title) > 1):
            problems.append(f"column {title!r} stands there {header.count(title)} times")


def read_rows(file, table: Table, known: set[str], problems: list[str]) -> None:
    """Read the rows below the header into `table`; what `known` does not name may be anything."""
    faults = {}
    line = table.line + 1
    for piece in _pieces(file):
        piece, lines, line = _rows_of(piece, line, table, problems)
        if not piece:
            continue
        numbers = _numbers(piece, table.header)
        if numbers is None:
            numbers = _by_hand(piece, lines, table.header, known, faults)
        table.pieces.append(numbers)
    problems += [
        text + (f" ({times} such entries)" if times > 1 else "") for text, times in faults.values()
    ]
    if not any(len(piece) for piece in table.pieces) and not faults:
        problems.append("the table has no rows")


def _pieces(file) -> Iterator[bytes]:
    """Whole lines, some at a time."""
    rest = b""
    while chunk := file.read(PIECE):
        chunk = rest + chunk
        end = chunk.rfind(b"\n") + 1
        rest = chunk[end:]
        if end:
            yield chunk[:end]
    if rest:
        yield rest


def _rows_of(piece, line, table, problems):
    """A piece without comments and empty lines, the line of each row, and the next line."""
    piece = piece.replace(b"\r\n", b"\n")
    following = line + piece.count(b"\n")
    marked = b"\n" + piece[:1], piece
    if not any(begin in part for begin in NO_ROW for part in marked):
        return piece, range(line, following + 1), following
    kept, lines = [], []
    for number, text in enumerate(piece.split(b"\n"), line):
        if text.strip() and not text.startswith(b"#"):
            kept.append(text + b"\n")
            lines.append(number)
        elif number < following:
            table.skipped.append(number)
            key = text[1:].partition(b":")[0].strip().decode(errors="replace")
            if text.startswith(b"#") and key in table.metadata:
                problems.append(f"metadata: {key!r} is given twice, again in line {number}")
    return b"".join(kept), lines, following


def _numbers(piece, header):
    """The numbers of a piece, or None if it holds anything else."""
    import pyarrow  # here, because it takes long to import
    from pyarrow import csv as arrow

    names = [str(index) for index in range(len(header))]
    try:
        columns = arrow.read_csv(
            pyarrow.BufferReader(piece),
            arrow.ReadOptions(column_names=names),
            arrow.ParseOptions(ignore_empty_lines=False),
            arrow.ConvertOptions(column_types=dict.fromkeys(names, pyarrow.float64())),
        ).columns
    except pyarrow.ArrowInvalid:
        return None
    numbers = np.empty((len(columns[0]), len(columns)))
    for index, column in enumerate(columns):
        numbers[:, index] = column.to_numpy()
    return numbers if np.isfinite(numbers).all() else None


def _by_hand(piece, lines, header, known, faults):
    """The numbers of a piece row by row, NaN where there is none; notes each kind of fault."""

    def fault(kind, text):
        first, times = faults.get(kind, (text, 0))
        faults[kind] = first, times + 1

    texts = piece.decode(errors="replace").removesuffix("\n").split("\n")
    numbers = np.full((len(texts), len(header)), np.nan)
    where = header.index("trial") if "trial" in header else None
    for values, text, line in zip(numbers, texts, lines, strict=False):
        row = _entries(text)
        if len(row) != len(header):
            fault(None, f"row {line} has {len(row)} entries, but the header has {len(header)}")
            continue
        for index, (title, entry) in enumerate(zip(header, row, strict=True)):
            if NUMBER.fullmatch(entry) and np.isfinite(float(entry)):
                values[index] = float(entry)
            elif title in known:
                what = f"is {entry[:40]!r}, not a finite number" if entry else "is missing"
                trial = "?" if where is None else row[where][:40]
                fault(title, f"{title}: entry {what}, in trial {trial}, row {line}")
    return numbers


def rows(counters: tuple, signals: list[np.ndarray]) -> bytes:
    """The rows of a table as text, each number by the digits that tell it from all others.

    Parameters
    ----------
    counters : tuple of ndarray, shape (rows,)
        Number of the trial, time.
    signals : list of ndarray, shape (rows, columns)
    """
    import pyarrow
    from pyarrow import csv as arrow

    columns = [*counters, *(column for signal in signals for column in signal.T)]
    sink = pyarrow.BufferOutputStream()
    arrow.write_csv(
        pyarrow.table(
            [pyarrow.array(column) for column in columns], [str(i) for i in range(len(columns))]
        ),
        sink,
        arrow.WriteOptions(include_header=False),
    )
    return sink.getvalue().to_pybytes()


def check_trials(table: Table, Ts: float, problems: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the trials, and the times of the first one, if they are what they must be.

    Each trial has a number of its own and stands in one piece, all are equally long and sampled
    every `Ts`, in the unit of the table, from zero on.
    """
    numbers, time = table.column("trial"), table.column("time")
    starts = np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])
    seen = numbers[starts]
    lengths = np.diff([*starts, len(numbers)])
    odd = np.flatnonzero((seen < 1) | (seen != np.round(seen)) | (seen > 2**31))
    if odd.size:
        problems.append(
            f"trial: {seen[odd[0]]:g} in row {table.line_of(starts[odd[0]])} is no whole number, "
            "1 or more"
        )
    known, first = np.unique(seen, return_index=True)
    if len(known) < len(seen):
        again = np.setdiff1d(np.arange(len(seen)), first)[0]
        problems.append(
            f"trial: {seen[again]:g} goes on in row {table.line_of(starts[again])}, after trial "
            f"{seen[again - 1]:g}: the rows of a trial must stand together ({len(seen)} pieces of "
            f"{len(known)} trials)"
        )
        return seen, time
    if len(set(lengths)) > 1:
        groups = []
        for length in np.unique(lengths):
            which = ", ".join(few([f"{k:g}" for k in seen[lengths == length]]))
            groups.append(f"{length} samples in trial {which}")
        problems.append(f"trials have different lengths: {'; '.join(few(groups))}")
    sample = np.arange(len(time)) - np.repeat(starts, lengths)
    with np.errstate(over="ignore"):
        off = np.flatnonzero(~(np.abs(time - sample * Ts) <= 1e-3 * Ts + 1e-12 * np.abs(time)))
    for row in off[
        np.unique(np.repeat(np.arange(len(starts)), lengths)[off], return_index=True)[1]
    ]:
        problems.append(_mistimed(table, numbers, time, sample, row, Ts))
    return seen, time[: lengths[0]]


def _mistimed(table, numbers, time, sample, row, Ts):
    """What is wrong with the first sample of a trial that is not where it should be."""
    where = f"trial {numbers[row]:g}, row {table.line_of(row)}"
    if sample[row] == 0:
        return f"time: {where}, the first of its trial, is at {time[row]:g}, not at 0"
    step = time[row] - time[row - 1]
    if abs(step - Ts) <= 1e-3 * Ts + 1e-12 * abs(time[row]):
        return (
            f"time: the clock is off, in {where}: sample {sample[row]} is at {time[row]:.9g}, but "
            f"due at {sample[row] * Ts:.9g}"
        )
    kind = "a gap" if step > 1.5 * Ts else "irregular sampling"
    return f"time: {kind} in {where}: a step of {step:g} where Ts = {Ts:g}"
