"""What a file holds, by its bytes: text that is not UTF-8, and workbooks, which are no text."""

import codecs
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ilctools.errors import LogError

EXPORT = (
    "export the sheet as CSV and read that by read_table, or pass read_table the DataFrame that "
    "pandas.read_excel makes of it"
)
NO_TEXT = {  # by the first bytes
    bytes.fromhex("d0cf11e0a1b11ae1"): f"an Excel workbook of the old format (.xls): {EXPORT}",
    b"PK\x03\x04": f"a workbook (.xlsx, .ods), or compressed (.zip): {EXPORT}, or unpack it",
    b"\x1f\x8b": "compressed, as .gz files are: unpack it",
}
UNPACKED = (".zip", ".gz")  # by pandas
BYTE_ORDER_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# Every other byte of ASCII text in UTF-16 is zero. Letters beyond Latin-1, whose bytes are not, are
# few among numbers.
ZEROS = 0.4  # of the bytes


@contextmanager
def text_in(path: Path, encoding: str | None, remedy: str) -> Iterator[None]:
    """While a text file is read: a LogError if it holds something else.

    `encoding` is what the reader takes; None stands for UTF-8. The `remedy` is a sentence in which
    ``{encoding}`` stands for what the file is likely to be in.
    """
    content = path.read_bytes()
    for start, what in NO_TEXT.items():
        if content.startswith(start) and path.suffix not in UNPACKED:
            raise LogError(f"it is no text, but {what}")
    likely = "utf-8" if encoding else "cp1252"
    if content.count(0) > ZEROS * len(content):
        likely = "utf-16" if content.startswith(BYTE_ORDER_MARKS) else "utf-16-le"
        if encoding is None:
            raise LogError(f"it is not UTF-8, but UTF-16: {remedy.format(encoding=likely)}")
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
        raise LogError(
            f"it is not {(encoding or 'utf-8').upper()} (byte {error.object[error.start]:#04x} at "
            f"{error.start}), but perhaps {likely.upper()}: {remedy.format(encoding=likely)}"
        ) from None
