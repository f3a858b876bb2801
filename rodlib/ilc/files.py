"""Where the repository is, and how it is written to: as a whole or not at all, by one at a time.

Only the standard library, because `environment.py` needs this before anything is installed.
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # on Windows
    import msvcrt

    fcntl = None


def folder(path: Path) -> Path:
    """Make a folder, unless it or a link to one is there.

    Raises
    ------
    NotADirectoryError
        If a file is in the way.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        ways = (path, *path.parents)
        file = next(way for way in ways if os.path.lexists(way) and not way.is_dir())
        raise NotADirectoryError(f"{file} must be a folder: remove what is there") from None
    return path


@contextmanager
def alone(lock: Path, refusal: str, wait: bool = False) -> Iterator[None]:
    """Keep other processes from doing the same.

    Parameters
    ----------
    lock : Path
        A file in a folder that exists. The file stays, the lock ends with the process.
    refusal : str
        What to say to the second.
    wait : bool
        Let the second wait instead.

    Raises
    ------
    RuntimeError
        If another process is at it.
    """
    with open(lock, "a", encoding="utf-8") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            else:
                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        except OSError:
            raise RuntimeError(refusal) from None
        yield


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

    Raises
    ------
    FileExistsError
        If `path` is there and no regular file: a device is not written to by replacing it.
    """
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} is no regular file: choose another name")
    temporary = _part(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Replace a text file, UTF-8 with line feeds, as a whole or not at all."""
    write_pieces(path, [text.encode()])


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Replace a file, as a whole or not at all, by pieces that need not fit into memory at once."""
    with replacing(path) as temporary:
        _write(temporary, pieces)


def _part(path):
    return path.with_name(f".{path.name}.part")


def _write(path, pieces):
    with open(path, "wb") as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())  # a full disk may show here only
