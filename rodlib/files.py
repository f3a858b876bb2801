"""Files are replaced as a whole or not at all, so that nothing half-written is ever left."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write instead of `path`, which it replaces if nothing goes wrong.

    Parameters
    ----------
    path : Path
        In a folder that exists.

    Yields
    ------
    Path
        Beside `path`; removed in case of an error.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Replace a text file, UTF-8 with line feeds, as a whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
