"""Write files as a whole or not at all, and lock them for one process at a time.

Only the standard library is used here, because `environment.py` needs this module before anything
is installed.
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
    """Make a folder, unless the folder exists."""
    path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def alone(lock: Path, refusal: str) -> Iterator[None]:
    """Hold the lock file `lock` in this block; raise `refusal` if another process holds it.

    The file stays afterwards, but its lock ends with the block or the process. If a link or a pipe
    has the name of the lock file, an error is raised. Otherwise anybody who can write to the folder
    could choose which file is created, or make the process wait.
    """
    if lock.is_symlink() or (lock.exists() and not lock.is_file()):
        raise FileExistsError(f"{lock} is not a regular file, or is a link: remove it")
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
    """Return the path, or the target of a link; refuse a pipe, a device or a folder."""
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} is not a regular file: choose another name")
    return Path(os.path.realpath(path)) if path.is_symlink() else path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide a temporary file next to `path`, which replaces `path` if no error occurs.

    The folder must exist. Links are followed, and permissions stay. A device or a pipe is refused,
    because the new file would take its place instead of being written to it. The name of the
    temporary file is random. Therefore no other writer uses this name, and nobody can place a link
    there. If the process is killed, a hidden file `.*.part` is left, which may be removed.
    """
    path = regular(path)
    temporary = path.with_name(f".{uuid4().hex}.part")
    try:
        if path.exists():
            temporary.touch()
            shutil.copymode(path, temporary)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:  # name the requested file in the error
        error.filename = str(path) if error.filename == str(temporary) else error.filename
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Replace a text file as a whole or not at all, in UTF-8 and with line feeds."""
    write_pieces(path, [text.encode()])


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Replace a file as a whole or not at all; the pieces need not fit into memory at once."""
    with replacing(path) as temporary:
        _write(temporary, pieces)


def append(path: Path, pieces: Iterable[bytes]) -> None:
    """Append to a file, and wait until the data are on the disk.

    If an error occurs, the file is restored.
    """
    size = path.stat().st_size
    try:
        _write(path, pieces, "ab")
    except BaseException:
        os.truncate(path, size)
        raise


def keep_others(path: Path, head: str) -> None:
    """Refuse to overwrite a file that is not empty and does not begin with `head`."""
    if regular(path).exists():
        with open(path, "rb") as file:
            start = file.read(len(head.encode()))
        if start and start != head.encode():
            raise ValueError(
                f"path = {str(path)!r} is a file of another kind: choose another name, or "
                "remove the file"
            )


def _write(path, pieces, mode="wb"):
    with open(path, mode) as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())  # a full disk may raise only here
