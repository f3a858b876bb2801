"""How files are read and written: as a whole or not at all, by one at a time.

Only the standard library, because `environment.py` needs this before anything is installed.
"""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # on Windows
    import msvcrt

    fcntl = None


def read_json(text: str):
    """What JSON says; a ValueError if it says anything twice, or what JSON has no word for."""
    return json.loads(text, object_pairs_hook=_once, parse_constant=_refuse_constant)


def _once(pairs):
    if len(pairs) > len(dict(pairs)):
        raise ValueError("a name stands there twice")
    return dict(pairs)


def _refuse_constant(word):
    raise ValueError(f"{word} is no number")


def folder(path: Path) -> Path:
    """Make a folder, unless it or a link to one is there; a file in the way is an error."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        ways = (path, *path.parents)
        file = next(way for way in ways if os.path.lexists(way) and not way.is_dir())
        raise NotADirectoryError(f"{file} must be a folder: remove what is there") from None
    return path


@contextmanager
def alone(lock: Path, refusal: str, wait: bool = False) -> Iterator[None]:
    """Refuse other processes, or let them wait, until this one has finished or is dead.

    The file stays, the lock on it ends with the process.
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
    """A file to write beside `path`, in a folder that is there; it replaces `path` if all is well.

    A device or a pipe is refused: it is not written to by being replaced.
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


def replace_all(new: dict[Path, bytes | None]) -> None:
    """Replace several files, one by one and in order, once all are written; None is for removed.

    An error while they are written leaves all as it was. What ends later, be it by a kill, leaves
    some replaced, none of them half; in either case another call mends it.
    """
    for path in new:
        folder(path.parent)
    try:
        for path, content in new.items():
            if content is not None:
                _write(_part(path), [content])
        for path, content in new.items():
            if content is None:
                path.unlink(missing_ok=True)
            else:
                os.replace(_part(path), path)
    finally:
        for path in new:
            _part(path).unlink(missing_ok=True)


def _part(path):
    return path.with_name(f".{path.name}.part")


def _write(path, pieces):
    with open(path, "wb") as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())  # a full disk may show here only
