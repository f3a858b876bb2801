"""Text files in the encoding that a reader expects; the error for other files says what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from ilctools.errors import LogError


@contextmanager
def text_in(encoding: str, remedy: str) -> Iterator[None]:
    """Raise a LogError if the bytes of a text file, read within, do not fit this encoding."""
    try:
        yield
    except (UnicodeError, LookupError) as error:  # LookupError: the encoding is unknown
        raise LogError(
            f"it is not {encoding.upper()} ({error}): {remedy}. Of a workbook (.xlsx, .xls, .ods) "
            "export the sheet as CSV, or pass read_table the DataFrame that pandas.read_excel "
            "makes of it; unpack what is compressed"
        ) from None
