"""A table of numbers as text: lines of metadata, a header, rows, each known by its line.

pyarrow reads and writes the numbers: exactly, fast, and strict about what a number is and how many
a row has. What it refuses is read again row by row, to pass over comments and to say what is wrong.
"""

import csv
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

NUMBER = re.compile(
    r"\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*", re.ASCII | re.IGNORECASE
)
METADATA = re.compile(r"#\s*([^:]*[^:\s])\s*:\s*(.*?)\s*")
SEPARATORS = {";": "semicolons", "\t": "tabs"}
MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
LISTED = 18  # problems, and names in a message


def few(words: Sequence[str]) -> list[str]:
    """The first of them, and how many more there are."""
    more = [f"and {len(words) - LISTED} more"] if len(words) > LISTED else []
    return [*words[:LISTED], *more]


@dataclass
class Table:
    """What stands in a file, as far as it could be read."""

    metadata: dict[str, str] = field(default_factory=dict)
    header: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)  # of metadata and header
    columns: np.ndarray = field(
        default_factory=lambda: np.empty((0, 0))
    )  # NaN for what is none
    lines: Sequence[int] = ()  # of the file, from 1, where each row stands
    faults: dict[str | None, list] = field(
        default_factory=dict
    )  # by title; what, and how often
    places: Sequence[int] | None = (
        None  # of the columns in a row; None: a row has no others
    )
    width: int = 0  # of a row that has others
    delimiter: str = ","
    decimal: str = "."
    gaps: bool = False  # whether rows may be cut off, and entries missing

    def column(self, title: str) -> np.ndarray:
        """All numbers of a column."""
        return self.columns[self.header.index(title)]

    def add(self, title: str, values) -> None:
        """Put a further column behind the others."""
        self.header, self.columns = (
            [*self.header, title],
            np.vstack([self.columns, values]),
        )

    def problems_of(self, titles) -> list[str]:
        """The faults in some columns, and rows of another length."""
        return [
            text + (f" ({times} such entries)" if times > 1 else "")
            for title, (text, times) in self.faults.items()
            if title is None or title in titles
        ]

    def fault(self, title: str | None, text: str) -> None:
        """Note what is wrong, the first of its kind in words."""
        self.faults.setdefault(title, [text, 0])[1] += 1


def read(content: bytes) -> Table:
    """The table in a file; its rows, if nothing is wrong above them."""
    if content[:2] in (BOM_UTF16_LE, BOM_UTF16_BE):
        raise UnicodeError("it is UTF-16: save it as UTF-8")
    table, line = Table(), 0
    end = len(BOM_UTF8) if content.startswith(BOM_UTF8) else 0
    while not table.header and end < len(content):
        start, line = end, line + 1
        end = content.find(b"\n", start) + 1 or len(content)
        text = content[start:end].decode().strip("\r\n")
        if match := METADATA.fullmatch(text):
            key, value = match.groups()
            if key in table.metadata:
                table.problems.append(
                    f"metadata: {key!r} is given twice, again in line {line}"
                )
            table.metadata.setdefault(key, value)
        elif text.strip() and not text.startswith("#"):
            table.header = entries(text)
    table.problems += _problems_of_header(table.header)
    if not table.problems:
        read_rows(table, memoryview(content)[end:], line + 1)
    return table


def entries(text: str, delimiter: str = ",") -> list[str]:
    """What stands in a line."""
    try:
        return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # an entry of more than 100,000 characters
        return [""]


def number(entry: str, decimal: str = ".") -> float:
    """The number in an entry; one that is not finite if there is anything else."""
    entry = entry if decimal == "." else entry.replace(".", "x").replace(decimal, ".")
    return float(entry) if NUMBER.fullmatch(entry) else np.nan


def _problems_of_header(header):
    if not header:
        return ["no table: there is no line with the names of the columns"]
    if len(header) == 1 and any(mark in header[0] for mark in SEPARATORS):
        word = next(word for mark, word in SEPARATORS.items() if mark in header[0])
        return [f"no table: its columns are separated by {word}, but must be by commas"]
    if header[-1] == "":
        return ["the line with the names of the columns ends with a comma: remove it"]
    again = dict.fromkeys(title for title in header if header.count(title) > 1)
    return [
        f"column {title!r} stands there {header.count(title)} times" for title in again
    ]


def read_rows(table: Table, content, first: int) -> None:
    """Read the rows that stand in `content`, from the line `first` of the file on."""
    if table.places is None:
        table.places, table.width = range(len(table.header)), len(table.header)
    table.columns = _all_at_once(table, content)
    table.lines = range(first, first + table.columns.shape[1])
    if np.isfinite(table.columns).all():
        return
    rows, lines = [], []
    for line, text in enumerate(
        bytes(content).decode(errors="replace").split("\n"), first
    ):
        text = text.rstrip("\r")
        if (match := METADATA.fullmatch(text)) and match[1] in table.metadata:
            table.fault(
                None, f"metadata: {match[1]!r} is given twice, again in line {line}"
            )
        elif text.strip() and not text.startswith("#"):
            rows.append(_row(table, text, line))
            lines.append(line)
    table.columns, table.lines = np.array(rows).reshape(-1, len(table.header)).T, lines


def _all_at_once(table, content):
    """The numbers of all rows by column; one that is not finite if there is anything else."""
    import pyarrow  # here, because it takes long to import
    from pyarrow import csv as arrow

    if not len(content):
        return np.empty((len(table.header), 0))
    names = [str(index) for index in range(table.width)]
    wanted = [names[place] for place in table.places]
    try:
        read = arrow.read_csv(
            pyarrow.BufferReader(content),
            arrow.ReadOptions(column_names=names),
            arrow.ParseOptions(delimiter=table.delimiter, ignore_empty_lines=False),
            arrow.ConvertOptions(
                column_types=dict.fromkeys(wanted, pyarrow.float64()),
                include_columns=wanted,
                decimal_point=table.decimal,
            ),
        )
    except pyarrow.ArrowInvalid:
        return np.full((len(wanted), 1), np.nan)
    return np.array([column.to_numpy() for column in read.columns])


def _row(table, text, line):
    """The numbers of one row, NaN where there is none; notes what is wrong with it."""
    found, values = entries(text, table.delimiter), np.full(len(table.header), np.nan)
    if len(found) != table.width:
        what = f"row {line} has {len(found)} entries, but the header has {table.width}"
        if not table.gaps:
            table.fault(None, what)
        return values
    for index, (title, place) in enumerate(
        zip(table.header, table.places, strict=True)
    ):
        entry, values[index] = found[place], number(found[place], table.decimal)
        if not np.isfinite(values[index]) and not (
            table.gaps and entry.lower() in MISSING
        ):
            what = f"is {entry[:40]!r}, not a finite number" if entry else "is missing"
            table.fault(title, f"{title}: entry {what}, in row {line}")
    return values


def quoted(title: str) -> str:
    """A title as csv has it; # as well, which others take for the start of a comment."""
    return '"' + title.replace('"', '""') + '"' if re.search('[,"#]', title) else title


def rows(columns: Sequence[np.ndarray]) -> bytes:
    """The rows of a table as text, each number by the digits that tell it from all others."""
    import pyarrow
    from pyarrow import csv as arrow

    names = [str(index) for index in range(len(columns))]
    sink, options = (
        pyarrow.BufferOutputStream(),
        arrow.WriteOptions(include_header=False),
    )
    arrow.write_csv(
        pyarrow.table([pyarrow.array(c) for c in columns], names), sink, options
    )
    return sink.getvalue().to_pybytes()
