"""How files are read and written: as a whole or not at all, by one at a time.

Only the standard library, because `environment.py` needs this before anything is installed.
"""

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

try:
    import fcntl
except ImportError:  # on Windows
    import msvcrt

    fcntl = None


def folder(path: Path) -> Path:
    """Make a folder, unless it is there."""
    path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def alone(lock: Path, refusal: str) -> Iterator[None]:
    """Refuse other processes until this one has finished or is dead.

    The file stays, the lock on it ends with the process. Where a link or a pipe waits at its name,
    this is an error: who can write to the folder would decide what is created or waited for.
    """
    if lock.is_symlink() or (lock.exists() and not lock.is_file()):
        raise FileExistsError(f"{lock} is no regular file, or a link: remove it")
    with open(lock, "a", encoding="utf-8") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            else:
                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            raise RuntimeError(refusal) from None
        yield


def regular(path: Path) -> Path:
    """The path, or where its link leads; an error for a pipe, a device or a folder: no end."""
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} is no regular file: choose another name")
    return Path(os.path.realpath(path)) if path.is_symlink() else path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write beside `path`, in a folder that is there; it replaces `path` if all is well.

    Links are followed, permissions stay. A device or a pipe is refused: it is not written to by
    being replaced. The name is one that no other writer has, and no link can wait at; where
    it is killed, a hidden file `.*.part` is left, which may be removed.
    """
    path = regular(path)
    temporary = path.with_name(f".{uuid4().hex}.part")
    try:
        if path.exists():
            temporary.touch()
            shutil.copymode(path, temporary)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:  # of the name that was asked for
        error.filename = str(path) if error.filename == str(temporary) else error.filename
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Replace a text file, UTF-8 with line feeds, as a whole or not at all."""
    write_pieces(path, [text.encode()])


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Replace a file, as a whole or not at all, by pieces that need not fit into memory at once."""
    with replacing(path) as temporary:
        _write(temporary, pieces)


def append(path: Path, pieces: Iterable[bytes]) -> None:
    """Add to a file, to the disk; after an error it is as it was."""
    size = path.stat().st_size
    try:
        _write(path, pieces, "ab")
    except BaseException:
        os.truncate(path, size)
        raise


def keep_others(path: Path, head: str) -> None:
    """Refuse to write over a file, such as raw data, that is not empty and begins otherwise."""
    if regular(path).exists():
        with open(path, "rb") as file:
            start = file.read(len(head.encode()))
        if start and start != head.encode():
            raise ValueError(
                f"path = {str(path)!r} is a file of another kind: choose another name, or remove it"
            )


def _write(path, pieces, mode="wb"):
    with open(path, mode) as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())  # a full disk may show here only
