"""Check the encoding of text files; the error for other files says what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from ilctools.errors import LogError


@contextmanager
def text_in(encoding: str, remedy: str) -> Iterator[None]:
    """Raise a LogError if a text file that is read in this block has another encoding."""
    try:
        yield
    except (UnicodeError, LookupError) as error:  # LookupError: the encoding is unknown
        raise LogError(
            f"it is not {encoding.upper()} ({error}): {remedy}. From a workbook (.xlsx, .xls, "
            ".ods), export the sheet as CSV, or pass read_table the DataFrame of "
            "pandas.read_excel. Read a MATLAB file (.mat) by scipy.io.loadmat, and pass a "
            "DataFrame of its arrays. If the file is compressed, unpack it"
        ) from None
