"""What a file holds, by its bytes: text that is not UTF-8, and workbooks, which are no text."""

import codecs
import reprlib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ilctools.errors import LogError

ZIP = b"PK\x03\x04"
OLD_WORKBOOK = bytes.fromhex("d0cf11e0a1b11ae1")  # the first bytes of Microsoft's compound files
MEMBERS = {  # of the zip archives that newer workbooks are: a file in it, and what it is then
    "xl/workbook.xml": "an Excel workbook (.xlsx)",
    "xl/workbook.bin": "an Excel workbook (.xlsb)",
    "Index/Tables/DataList.iwa": "a Numbers workbook",
}
# In the file `mimetype`, which stands first in the archive and is not compressed.
OPEN_DOCUMENT = b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet"
MARKS = {  # byte order marks; that of UTF-32 begins as that of UTF-16 does, and so is tried first
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
COMPRESSED = {  # the first bytes of archives, which pandas unpacks if their names say so
    ZIP: ".zip",
    b"\x1f\x8b": ".gz",
    b"BZh": ".bz2",
    b"\xfd7zXZ\x00": ".xz",
    b"\x28\xb5\x2f\xfd": ".zst",
}
SHOWN = 1000  # bytes of a file in which an encoding shows
# Every other byte of ASCII text in UTF-16 is zero; letters beyond Latin-1, which have none, are few
# among numbers.
ZEROS = 0.8


def refuse_workbook(path: Path) -> None:
    """Raise a LogError that says which kind of workbook a file is, if it is one."""
    if kind := _workbook(path):
        raise LogError(
            f"it is {kind}, and no text: export the sheet as CSV and read that by read_table, or "
            "pass read_table the DataFrame that pandas.read_excel makes of it"
        )


def _workbook(path):
    start = _start_of(path)
    if start.startswith(OLD_WORKBOOK):
        return "an Excel workbook of the old format (.xls)"
    if not start.startswith(ZIP):
        return None
    if OPEN_DOCUMENT in start:
        return "an OpenDocument spreadsheet (.ods)"
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError):  # whoever reads it says so
        return None
    return next((kind for member, kind in MEMBERS.items() if member in names), None)


def _start_of(path):
    with open(path, "rb") as file:
        return file.read(SHOWN)


def wide_encoding(start: bytes) -> str | None:
    """The encoding of text whose letters have two or four bytes, as its start shows; or None."""
    for mark, encoding in MARKS.items():
        if start.startswith(mark):
            return encoding
    for first, encoding in (1, "utf-16-le"), (0, "utf-16-be"):
        zeros, letters = start[first::2], start[1 - first :: 2]
        if zeros.count(0) > ZEROS * len(zeros) and letters.count(0) == 0:
            return encoding
    return None


def known_encoding(encoding) -> str:
    """An encoding that Python knows; a ValueError for any other."""
    try:
        codecs.lookup(encoding)
    except (LookupError, TypeError):
        raise ValueError(
            f"encoding = {reprlib.repr(encoding)} must be one that Python knows, such as 'utf-8', "
            "'cp1252' or 'utf-16'"
        ) from None
    return encoding


@contextmanager
def text_in(path: Path, encoding: str | None, remedy: str) -> Iterator[None]:
    """While a text file is read: a LogError if it holds something else.

    `encoding` is what the reader takes; None stands for UTF-8. The `remedy` is a sentence in which
    ``{encoding}`` stands for what the file is likely to be in.
    """
    refuse_workbook(path)
    start = _start_of(path)
    wide = wide_encoding(start)
    if wide and encoding is None:
        raise LogError(f"it is not UTF-8, but {wide.upper()}: {remedy.format(encoding=wide)}")
    try:
        yield
    except UnicodeDecodeError as error:
        for mark, ending in COMPRESSED.items():
            if start.startswith(mark):
                raise LogError(f"it is compressed, as {ending} files are: unpack it") from None
        likely = wide or ("cp1252" if encoding is None else "utf-8")
        raise LogError(
            f"it is not {(encoding or 'utf-8').upper()} (byte {error.object[error.start]:#04x} at "
            f"{error.start}), but perhaps {likely.upper()}: {remedy.format(encoding=likely)}"
        ) from None
