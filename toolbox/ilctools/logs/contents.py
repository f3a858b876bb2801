"""What a file holds, by its bytes: text that is not UTF-8, and workbooks, which are no text."""

import codecs
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ilctools.errors import LogError

ZIP = b"PK\x03\x04"
WORKBOOKS = {  # the first bytes, and what else stands in the file
    "an Excel workbook of the old format (.xls)": (bytes.fromhex("d0cf11e0a1b11ae1"), b""),
    "an Excel workbook (.xlsx)": (ZIP, b"xl/workbook."),
    "an OpenDocument spreadsheet (.ods)": (ZIP, b"application/vnd.oasis.opendocument.spreadsheet"),
}
COMPRESSED = {ZIP: ".zip", b"\x1f\x8b": ".gz"}  # pandas unpacks these if their names say so
MARKS = {  # byte order marks; that of UTF-32 begins as that of UTF-16 does, and so is tried first
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# Without a mark, every other byte of ASCII text in UTF-16 is zero. Letters beyond Latin-1, whose
# bytes are not, are few among numbers.
ZEROS = 0.8


@contextmanager
def text_in(path: Path, encoding: str | None, remedy: str) -> Iterator[None]:
    """While a text file is read: a LogError if it holds something else.

    `encoding` is what the reader takes; None stands for UTF-8. The `remedy` is a sentence in which
    ``{encoding}`` stands for what the file is likely to be in.
    """
    content = path.read_bytes()
    for kind, (start, member) in WORKBOOKS.items():
        if content.startswith(start) and member in content:
            raise LogError(
                f"it is {kind}, and no text: export the sheet as CSV and read that by read_table, "
                "or pass read_table the DataFrame that pandas.read_excel makes of it"
            )
    likely = _wide_encoding(content)
    if likely and encoding is None:
        raise LogError(f"it is not UTF-8, but {likely.upper()}: {remedy.format(encoding=likely)}")
    try:
        codecs.lookup(encoding or "utf-8")
    except (LookupError, TypeError):
        raise ValueError(
            f"encoding = {reprlib.repr(encoding)} must be one that Python knows, such as 'utf-8', "
            "'cp1252' or 'utf-16'"
        ) from None
    try:
        yield
    except UnicodeDecodeError as error:
        for start, ending in COMPRESSED.items():
            if content.startswith(start):
                raise LogError(f"it is compressed, as {ending} files are: unpack it") from None
        likely = likely or ("utf-8" if encoding else "cp1252")
        raise LogError(
            f"it is not {(encoding or 'utf-8').upper()} (byte {error.object[error.start]:#04x} at "
            f"{error.start}), but perhaps {likely.upper()}: {remedy.format(encoding=likely)}"
        ) from None


def _wide_encoding(content):
    """The encoding of text whose letters have two or four bytes; None of other text."""
    for mark, encoding in MARKS.items():
        if content.startswith(mark):
            return encoding
    for first, encoding in (1, "utf-16-le"), (0, "utf-16-be"):
        if content[first::2].count(0) > ZEROS * len(content) / 2:
            return encoding
    return None
