"""Text in the encoding that a reader takes; the error for any other file says what to do."""

import codecs
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager

from ilctools.errors import LogError


@contextmanager
def text_in(encoding: str, remedy: str) -> Iterator[None]:
    """While a text file is read: a LogError if its bytes are none in this encoding."""
    try:
        codecs.lookup(encoding)
    except (LookupError, TypeError):
        raise ValueError(
            f"encoding = {reprlib.repr(encoding)} must be one that Python knows, such as 'utf-8', "
            "'cp1252' or 'utf-16'"
        ) from None
    try:
        yield
    except UnicodeError as error:
        raise LogError(
            f"it is not {encoding.upper()} ({error}): {remedy}. Of a workbook (.xlsx, .xls, .ods) "
            "export the sheet as CSV, or pass read_table the DataFrame that pandas.read_excel "
            "makes of it; unpack what is compressed"
        ) from None
