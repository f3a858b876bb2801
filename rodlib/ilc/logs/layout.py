"""How the text of a table is laid out: what divides columns, where they begin, and their titles."""

import difflib
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from dataclasses import dataclass

import numpy as np
import pandas as pd

from rodlib.ilc.logs.tables import entries, few, number
from rodlib.ilc.units import is_known

DELIMITERS = ("\t", ";", "|", ",", " ")
MARKS = "#%/!"  # with which comments begin
LOOKED_AT = 200  # rows, to see how a table is laid out
TIME = re.compile(
    r"(\d{4}-\d\d-\d\d([T ]|$))?(\d+:\d\d(:\d\d(\.\d*)?)?(Z|[+-]\d\d:?\d\d)?)?"
)
DAY = 86400.0  # s
UNIT = re.compile(r"(.*\S)\s*[(\[]([^()\[\]]*)[)\]]")  # "Heater 1 (%)", "Time [s]"


def text_of(content: bytes) -> str:
    """What stands in a file, in whatever encoding."""
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in content:
        raise ValueError(
            "is no text: let pandas read it, and pass what it gives as path"
        )
    else:
        encoding = "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeError:
        text = content.decode("latin-1")  # as spreadsheets write degC
    return text.replace("\r\n", "\n").replace("\r", "\n")


@dataclass(frozen=True)
class Layout:
    """How a table is laid out."""

    delimiter: str
    decimal: str
    first: int  # lines above the rows
    titles: list[str] | None
    dated: list[bool]  # which columns are dates or times, not numbers

    def place(self, column) -> int:
        """Where a column stands that is told by its title or number."""
        width = len(self.dated)
        if isinstance(column, int):
            if 0 <= column < width:
                return column
            raise ValueError(f"must be from 0 to {width - 1}, as the rows have {width}")
        if self.titles is None:
            raise ValueError(
                f"is no column: no line of {width} titles is there; number them"
            )
        for titles in (self.titles, [_parts(title)[0] for title in self.titles]):
            if titles.count(column) == 1:
                return titles.index(column)
            if column in titles:
                raise ValueError("is the title of several columns: give its number")
        close = difflib.get_close_matches(column, titles, n=1)
        hint = f"did you mean {close[0]!r}? It has" if close else "it has"
        raise ValueError(f"is no column: {hint} {few(self.titles)}")

    def name(self, place) -> str:
        """What a column is called in a message."""
        return self.titles[place] if self.titles else f"column {place}"

    def unit(self, place) -> str:
        """The unit in the title of a column."""
        return _parts(self.titles[place])[1] if self.titles else ""

    def body(self, lines, clock) -> str:
        """The rows without comments, and with seconds where dates or times stand in `clock`."""
        body = [
            "" if text.lstrip()[:1] in MARKS else text for text in lines[self.first :]
        ]
        if self.delimiter == " ":
            body = [" ".join(text.split()) for text in body]
        if clock is None or not self.dated[clock]:
            return "\n".join(body)
        rows = {k: entries(text, self.delimiter) for k, text in enumerate(body) if text}
        rows = {k: row for k, row in rows.items() if len(row) == len(self.dated)}
        passed = _seconds([row[clock].strip() for row in rows.values()])
        for (k, row), t in zip(rows.items(), passed, strict=True):
            if np.isfinite(t):
                row[clock] = repr(t).replace(".", self.decimal)
                marked = [
                    f'"{entry}"' if self.delimiter in entry else entry for entry in row
                ]
                body[k] = self.delimiter.join(marked)
        return "\n".join(body)


def _seconds(texts):
    """Seconds from the first of some dates, or from midnight; NaN for what is none of them."""
    series = pd.Series(texts, dtype=object)
    times = pd.to_datetime(series, format="ISO8601", errors="coerce", utc=True)
    if times.notna().any():
        return (times - times.min()).dt.total_seconds().tolist()
    passed = pd.to_timedelta(series, errors="coerce").dt.total_seconds()
    known = passed.notna()
    passed[known] = np.unwrap(passed[known], period=DAY)  # past midnight
    return passed.tolist()


def _parts(title):
    """The name and the unit in a title."""
    match = UNIT.fullmatch(title)
    return match.groups() if match else (title, "")


def _split(text, delimiter):
    """What stands in a line; a row of blanks is one delimiter."""
    text = " ".join(text.split()) if delimiter == " " else text
    return [entry.strip() for entry in entries(text, delimiter)]


def _counts(entry, decimal):
    """Whether an entry is a number or a time."""
    return bool(
        np.isfinite(number(entry, decimal)) or (entry and TIME.fullmatch(entry))
    )


def layout_of(lines: list[str]) -> Layout:
    """The layout in which most of what the first rows hold are numbers."""
    rows = [
        k
        for k, text in enumerate(lines)
        if text.strip() and text.lstrip()[0] not in MARKS
    ]
    some, best, found = rows[:LOOKED_AT], (0.0, False), None
    for delimiter in DELIMITERS:
        split = [
            _split(lines[k], delimiter) for k in some[len(some) // 2 :]
        ]  # below the titles
        width = Counter(map(len, split)).most_common(1)[0][0] if split else 0
        alike = [row for row in split if len(row) == width]
        for decimal in (".", ",")[: 1 + (delimiter != ",")]:
            numbers = np.array(
                [[_counts(entry, decimal) for entry in row] for row in alike]
            )
            filled = sum(entry != "" for row in alike for entry in row)
            share = numbers.sum() * len(alike) / max(filled * len(split), 1)
            if share and (share, width > 1) > best:
                best, found = (
                    (share, width > 1),
                    (delimiter, decimal, numbers.mean(0) >= 0.5),
                )
    if found is None:
        raise ValueError("no rows of numbers are found")
    delimiter, decimal, numeric = found
    width = len(numeric)

    def row(k):
        found = _split(lines[k].lstrip().lstrip(MARKS), delimiter)
        if (
            len(found) == width - 1
        ):  # a delimiter at the end of rows, or a row has a name
            return ["", *found] if numeric[-1] else [*found, ""]
        return found

    def holds(k):
        found = [
            _counts(entry, decimal)
            for entry, n in zip(row(k), numeric, strict=False)
            if n
        ]
        return len(row(k)) == width and any(found) and all(found)

    first = next((k for k in rows if holds(k)), rows[0])
    above = [k for k in range(first) if lines[k].strip() and len(row(k)) == width]
    plain = [k for k in above if not any(_counts(entry, decimal) for entry in row(k))]
    title = plain[-1] if plain else above[-1] if above else None
    dated = [bool(entry and TIME.fullmatch(entry)) for entry in row(first)]
    if title is None:
        return Layout(delimiter, decimal, first, None, dated)
    titles = row(title)
    if title - 1 in plain and all(map(is_known, titles)):  # their units
        titles = [f"{a} ({b})" for a, b in zip(row(title - 1), titles, strict=True)]
    return Layout(delimiter, decimal, title + 1, titles, dated)
