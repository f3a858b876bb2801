"""Text in the encoding that a reader takes; the error for any other file says what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from ilctools.errors import LogError


@contextmanager
def text_in(encoding: str, remedy: str) -> Iterator[None]:
    """While a text file is read: a LogError if its bytes are none in this encoding."""
    try:
        yield
    except (UnicodeError, LookupError) as error:  # the latter of an encoding that is unknown
        raise LogError(
            f"it is not {encoding.upper()} ({error}): {remedy}. Of a workbook (.xlsx, .xls, .ods) "
            "export the sheet as CSV, or pass read_table the DataFrame that pandas.read_excel "
            "makes of it; unpack what is compressed"
        ) from None
